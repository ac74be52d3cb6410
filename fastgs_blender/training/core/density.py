# SPDX-License-Identifier: GPL-3.0-or-later
"""Density control adds, moves and removes Gaussians during training.  Each strategy is a class here, listed in STRATEGIES.

It runs once after every step, works on the rows of the optimiser, and its random numbers depend on the step alone, so that a
resumed run and every process of a distributed one decide the same.
"""
from typing import Any

import numpy as np

from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...model.slicing import sigmoid
from ...util import rotations
from .anchor import ANCHOR
from .optimiser import SHARED, Rows
from .schedule import DENSITY, NOISE, generator
from .settings import Settings
from .statistics import Statistics

NOISE_STRENGTH, WEIGHTS = 0.1, (0.01, 0.01)
"""MCMC: share of the authors' noise, and weights of its penalties on opacity and on scale."""


class Strategy:
    """Base class of the strategies: at which steps they act, and how many Gaussians they may add.

    settings, extent (of the capture), template (a model of the kinds that are trained), centres [C, 3] of the cameras
    frozen  how many Gaussians, the first ones, stay as they are
    """

    name = ""

    def __init__(self, settings: Settings, extent: float, template: GaussianModel, centres: np.ndarray | None = None) -> None:
        self.settings, self.extent, self.template = settings, extent, template
        self.centres = np.zeros((0, 3)) if centres is None else centres
        self.frozen = 0
        self.first = int(settings.densify_from * settings.iterations)
        self.last = int(settings.densify_until * settings.iterations)
        every = settings.densify_every
        self.growing = min(self.last, (self.first // every + settings.densify_rounds) * every) if settings.densify_rounds else self.last

    def due(self, iteration: int) -> bool:
        """Whether density changes after this step (counted from 1)."""
        return self.first < iteration <= self.last and iteration % self.settings.densify_every == 0

    def _room(self, iteration: int, count: int) -> int:
        """How many Gaussians may be added now: what is left is shared equally among the remaining calls.

        If all were added at once, the blurred beginning of training would use them up, and none would be left for detail.
        """
        s = self.settings
        if iteration > self.growing:
            return 0
        times = (self.growing - iteration) // s.densify_every + 1
        return min(-(-(s.max_gaussians - count) // times), int(s.densify_share * count) + 1)

    acts = due
    """Whether after_step() must be called after this step."""

    def after_step(self, iteration: int, optimiser: Rows, statistics: Statistics, rates: dict) -> bool:
        """Change the optimiser's Rows; returns whether statistics must be begun anew.

        statistics: Statistics in NumPy arrays; rates: the step's learning rates.
        """
        raise NotImplementedError

    def penalise(self, backend: Any, arrays: dict, gradients: dict) -> None:
        """Add the gradients of penalties that depend on no view; called at every step, with arrays and gradients of the backend."""

    def add_noise(self, backend: Any, iteration: int, arrays: dict, rates: dict) -> None:
        """Move the backend's arrays at random after every step (counted from 1)."""


class Default(Strategy):
    """The rules of 3DGS: Gaussians with large screen gradients are cloned if small and split if large; faint ones are removed.

    Where more qualify than may be added, those with the largest gradients come first.
    """

    name = "default"

    def acts(self, iteration: int) -> bool:
        return self.due(iteration) or self._resets(iteration)

    def _resets(self, iteration: int) -> bool:
        every = self.settings.reset_every
        return bool(every) and self.first < iteration < self.last and iteration % every == 0

    def after_step(self, iteration: int, optimiser: Rows, statistics: Statistics, rates: dict) -> bool:
        changed = False
        if self.due(iteration):
            self._prune(optimiser, statistics)
            self._grow(iteration, optimiser, statistics)
            changed = True
        if self._resets(iteration):
            opacity = optimiser.arrays["opacity"]
            rows = self.frozen + np.flatnonzero(opacity[self.frozen:] > _logit(0.01))
            opacity[rows] = _logit(0.01)
            optimiser.reset("opacity", rows)
        return changed

    def _prune(self, optimiser: Rows, statistics: Statistics) -> None:
        arrays = optimiser.arrays
        largest = np.minimum(self.extent, self.settings.prune_size * self._distance(optimiser))
        if ANCHOR in arrays:  # a hole in the backdrop makes its neighbours grow until they are removed too
            anchored = np.flatnonzero(np.isfinite(arrays[ANCHOR]).all(1))
            arrays["scale"][anchored] = np.minimum(arrays["scale"][anchored], np.log(largest[anchored])[:, None] - 1e-3)
        keep = sigmoid(arrays["opacity"]) >= self.settings.prune_opacity
        keep &= np.exp(arrays["scale"].max(1)) <= largest
        keep[:self.frozen] = True
        if keep.all() or not keep.any():
            return
        rows = np.flatnonzero(keep)
        optimiser.take(rows)
        statistics.take(rows)

    def _distance(self, optimiser: Rows) -> np.ndarray:
        """Distance to the nearest camera [N] that draws it.  Large Gaussians close to a camera are fog, which opposite cameras see as sky.

        A camera does not draw what its near plane cuts off, such as its own housing in a wall, which others see.
        """
        position = optimiser.arrays["position"].astype(np.float64)
        nearest = np.full(len(position), np.inf)
        for centre in self.centres:
            distance = np.linalg.norm(position - centre, axis=1)
            nearest = np.where(distance > self.template.raster.near, np.minimum(nearest, distance), nearest)
        return nearest

    def _grow(self, iteration: int, optimiser: Rows, statistics: Statistics) -> None:
        s, arrays = self.settings, optimiser.arrays
        total = statistics.gradient if s.densify_gradient == "plain" else statistics.absolute
        score = total / np.maximum(statistics.seen, 1)
        score[:self.frozen] = 0
        n = len(score)
        room = self._room(iteration, n)
        wanting = np.flatnonzero(score > s.densify_threshold)
        if room <= 0 or not len(wanting):
            return
        chosen = np.sort(wanting[np.argsort(-score[wanting], kind="stable")[:room]])
        large = np.exp(arrays["scale"][chosen].max(1)) > s.densify_size * self.extent
        rng = generator(s.seed, DENSITY, iteration)
        born = {name: array[chosen].copy() for name, array in arrays.items() if _per_gaussian(name)}
        split = chosen[large]
        if len(split):
            step = _inside(arrays, split, rng)
            arrays["position"][split] += step
            arrays["scale"][split] -= np.float32(np.log(1.6))
            born["position"][large] = born["position"][large] - step  # a mirror pair keeps the centre of gravity
            born["scale"][large] -= np.float32(np.log(1.6))
            for name in ("position", "scale"):
                optimiser.reset(name, split)
        if s.densify_time == "random":
            shift(born, rng.uniform(0, 1, len(born["mu_tau"])).astype(np.float32), self.template)
        optimiser.append(born)


class MCMC(Strategy):
    """3DGS as Markov chain Monte Carlo (Kheradmand et al. 2024): transparent Gaussians move to opaque ones; noise explores.

    A Gaussian shares its opacity with those that move to it, so that together they look as it did: o' = 1 - (1 - o)^(1/n),
    and the scale shrinks accordingly.
    """

    name = "mcmc"
    most = 51

    def penalise(self, backend: Any, arrays: dict, gradients: dict) -> None:
        backend.mcmc_penalty(arrays, gradients, *WEIGHTS, self.extent)

    def after_step(self, iteration: int, optimiser: Rows, statistics: Statistics, rates: dict) -> bool:
        if not self.due(iteration):
            return False
        rng, opacity = generator(self.settings.seed, DENSITY, iteration), sigmoid(optimiser.arrays["opacity"][self.frozen:])
        dead, alive = (self.frozen + np.flatnonzero((opacity <= self.settings.prune_opacity) == gone) for gone in (True, False))
        if len(alive):
            self._relocate(optimiser, dead, alive, rng)
            self._add(iteration, optimiser, rng)
        return True

    def _relocate(self, optimiser: Rows, dead: np.ndarray, alive: np.ndarray, rng: np.random.Generator) -> None:
        arrays = optimiser.arrays
        if not len(dead):
            return
        weight = sigmoid(arrays["opacity"][alive])
        source = rng.choice(alive, len(dead), p=weight / weight.sum())
        self._share(optimiser, source)
        for name, array in arrays.items():
            if _per_gaussian(name):
                array[dead] = array[source]
                optimiser.reset(name, dead)

    def _add(self, iteration: int, optimiser: Rows, rng: np.random.Generator) -> None:
        arrays = optimiser.arrays
        room = self._room(iteration, len(arrays["opacity"]))
        if room <= 0:
            return
        weight = sigmoid(arrays["opacity"][self.frozen:])
        source = self.frozen + rng.choice(len(weight), room, p=weight / weight.sum())
        self._share(optimiser, source)
        optimiser.append({name: array[source].copy() for name, array in arrays.items() if _per_gaussian(name)})

    def _share(self, optimiser: Rows, source: np.ndarray) -> None:
        """Opacity and scale of Gaussians of which n + 1 copies replace one."""
        arrays = optimiser.arrays
        rows, copies = np.unique(source, return_counts=True)
        count = np.minimum(copies + 1, self.most)
        old = np.clip(sigmoid(arrays["opacity"][rows]), 0, 1 - 1e-6)
        new = 1 - (1 - old) ** (1 / count)
        arrays["scale"][rows] += np.log(old / _spread(new, count))[:, None].astype(np.float32)
        arrays["opacity"][rows] = _logit(np.clip(new, self.settings.prune_opacity, 1 - 1e-6))
        for name in arrays:
            if _per_gaussian(name):
                optimiser.reset(name, rows)

    def add_noise(self, backend: Any, iteration: int, arrays: dict, rates: dict) -> None:
        if iteration <= self.last:
            strength = NOISE_STRENGTH * 5e5 * rates["position"] / self.extent**2  # the authors' factor, where the extent is 1
            backend.mcmc_noise(arrays, strength, (self.settings.seed, NOISE, iteration), self.frozen)


STRATEGIES = {cls.name: cls for cls in (Default, MCMC)}


def shift(arrays: dict[str, np.ndarray], centre: np.ndarray, template: GaussianModel) -> None:
    """Move the temporal centre of rows without changing their trajectories: polynomials are expanded about the new centre.

    Features that depend on time are set to zero: far from the old centre they have no meaning.
    """
    delta = (centre - arrays["mu_tau"]).astype(np.float64)
    for basis, constant, name in ((template.basis, "position", "motion"), (template.rotation_basis, "rotation", "rotation_motion")):
        arrays[constant][...], arrays[name][...] = basis.recentred(arrays[constant], arrays[name], delta)
    arrays["mu_tau"][...] = centre
    if isinstance(template.appearance, Features):
        arrays["features"][:, 6:9] = 0


def _inside(arrays: dict[str, np.ndarray], rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random steps [M, 3] float32 with the distribution of each Gaussian."""
    local = rng.standard_normal((len(rows), 3)) * np.exp(arrays["scale"][rows].astype(np.float64))
    axes = rotations.to_matrices(rotations.unit(arrays["rotation"][rows].astype(np.float64)))
    return np.einsum("nij,nj->ni", axes, local).astype(np.float32)


def _spread(opacity: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Sum of the powers of the opacity by which count equal Gaussians are together wider than one (eq. 9 of the paper)."""
    total = np.zeros(len(opacity))
    for i in range(1, int(count.max()) + 1):
        inner = np.zeros(len(opacity))
        binomial = 1.0
        for k in range(i):
            inner += binomial * (-1) ** k / np.sqrt(k + 1) * opacity ** (k + 1)
            binomial *= (i - 1 - k) / (k + 1)
        total += np.where(i <= count, inner, 0)
    return np.maximum(total, 1e-12)


def _logit(p: Any) -> Any:
    return np.log(p / (1 - p))


def _per_gaussian(name: str) -> bool:
    return name not in SHARED
