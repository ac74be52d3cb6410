# SPDX-License-Identifier: GPL-3.0-or-later
"""Quantises a model: every array becomes integers and the step sizes to multiply them by; compressed.py packs these.

The step size of a parameter depends on how much pictures change with it (sensitivity.py).  For a given file size the pictures' error is
smallest where each parameter adds the same error, so that a step size is proportional to 1 / sqrt(sensitivity).  Each Gaussian has three
integers, exponents of two by which its step sizes differ from those of the segment:

    shape   of position (relative to the Gaussian's size), scale, rotation, opacity, temporal centre and temporal opacity
    tint    of its colour's features
    life    -log2 of the length of its lifetime, in which motion and the temporal centre are measured

A number whose own sensitivity asks for less than these steps is rounded to one that costs fewer bits (rounding.py).

Everything that a reader computes is exact or rounded once in float64, so that all machines read the same model.

The error of a motion coefficient is the movement that it causes within the Gaussian's lifetime, each moment weighted by its opacity.  The
basis functions are orthogonalised under that weight (QR).  Coefficients are then rounded from the last to the first, and each corrects the
rounding errors of the later ones (Babai's nearest plane).  The step size of coefficient k is that of the position, divided by the norm of
the orthogonal part of function k; a table holds these norms as powers of two, by life and k.

Columns in `chained` hold differences from the previous Gaussian.  The writer takes them from the values that a reader has reconstructed, so
that errors do not add up.

24 pairs of a quaternion and an order of the axes describe the same Gaussian; the one nearest to no rotation is written.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import permutations, product

import numpy as np

from ..model.basis import Basis
from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from ..util import rotations
from .fitting import lifetimes
from .rounding import chained, ldexp, pulls, rounded
from .sensitivity import OPAQUE, UNSEEN, Sensitivity

SAMPLES = 16
"""Times in a lifetime at which its motion is looked at."""
LIVES = 10
"""Values of `life`."""
CLASSES = 12
"""`shape` and `tint` lie within +- CLASSES."""
LARGEST = 60
"""Exponents of steps, and those that a header tells, lie within +- LARGEST."""
SPREADS = 6
"""Rows of the table of rotations' steps, by how far a Gaussian is from round."""
SHAPE = ("position", "scale", "opacity")
"""Whose sensitivities decide a Gaussian's `shape`."""
ATTRIBUTES = ("position", "scale", "rotation", "opacity", "mu_tau", "temporal")
"""Those whose steps follow a Gaussian's `shape`."""
BOUNDS = {"position": 1.0, "scale": 2.0, "rotation": 0.5, "opacity": 0.25, "features": 0.5, "temporal": 4.0, "mu_tau": 1.0}
"""The largest steps: of a Gaussian's size, of ln, of a quaternion, of opacity 0..1, of colour, of ln, of a lifetime."""
FINEST = 2.0**-12
"""The smallest step, in the same units."""
GRID = 26
"""A position's step is at least the model's extent / 2^GRID: float32 holds no more."""
LEAST_OPACITY = 1e-3


@dataclass(frozen=True)
class Steps:
    """The step sizes that a file stores beside the whole numbers.

    base      step by attribute at shape 0 (features: see tint)
    tint      [F] steps of the features at tint 0
    turn      [SPREADS] exponents of two on the rotation's step, by spread()
    motion    [LIVES, K] exponents on the position's step
    swing     [LIVES, R] exponents on the rotation's step, of the coefficients of its basis
    chained   names of columns, as "scale/0", that are differences from the Gaussian before
    paired    (column of the features, the column that it is a difference from); the latter is none itself
    least     exponent of the smallest step of a position
    """

    base: dict[str, float]
    tint: np.ndarray
    turn: np.ndarray
    motion: np.ndarray
    swing: np.ndarray
    chained: list[str] = field(default_factory=list)
    paired: list[tuple[int, int]] = field(default_factory=list)
    least: int = -60

    def of(self, name: str, shape: np.ndarray) -> np.ndarray:
        """Steps [N] of an attribute, float64."""
        return np.clip(ldexp(self.base[name], shape), FINEST, BOUNDS[name])

    def of_features(self, tint: np.ndarray) -> np.ndarray:
        """Steps [N, F] of the features, float64."""
        return np.clip(ldexp(self.tint, tint[:, None]), FINEST, BOUNDS["features"])

    def grain(self, scale: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """Exponents [N] of two that are the steps of positions, from ln of scale [N, 3] as a reader has it."""
        middle = np.rint(np.sort(scale, axis=1)[:, 1] * LOG2E)
        own = np.frexp(self.of("position", shape))[1]
        return np.clip(np.clip(middle, -200, 200).astype(np.int64) + own, self.least, 200)

    def turning(self, scale: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """Steps [N] of rotations: a Gaussian that is nearly round may be turned more."""
        return np.clip(ldexp(self.of("rotation", shape), self.turn[spread(scale)]), FINEST, BOUNDS["rotation"])


LOG2E = 1.4426950408889634


def spread(scale: np.ndarray) -> np.ndarray:
    """A row of Steps.turn for each ln of scale [N, 3]: by ln of the longest axis over the shortest."""
    return np.clip(np.rint((scale.max(1) - scale.min(1)) * 1.5), 0, SPREADS - 1).astype(int)


@dataclass(frozen=True, eq=False)
class Prepared:
    """A model to be quantised: in its canonical form, with the logarithms of the steps that its sensitivities ask for.

    shape, tint   [N] log2 of steps relative to `base` and `colour`, for an error of 1 by each number
    base          {attribute: log2 of its step at shape 0}
    colour        [F] log2 of the features' steps at tint 0
    turn          [SPREADS] exponents
    own           {attribute: log2 of the steps [N, D] that its own sensitivities ask for, for an error of 1 by each number}
    low, high     [N] begin and end of lifetimes
    """

    model: GaussianModel
    shape: np.ndarray
    tint: np.ndarray
    base: dict[str, float]
    colour: np.ndarray
    turn: np.ndarray
    own: dict[str, np.ndarray]
    low: np.ndarray
    high: np.ndarray

    def part(self, index: slice | np.ndarray) -> Prepared:
        """Some of its Gaussians."""
        own = {name: getattr(self, name)[index] for name in ("shape", "tint", "low", "high")}
        return replace(self, model=self.model.take(index), own={name: array[index] for name, array in self.own.items()}, **own)


def prepared(model: GaussianModel, found: Sensitivity) -> Prepared:
    """The model (canonical(), as its sensitivities were measured) and how finely its numbers must be kept."""
    low, high = lifetimes(model)
    life = _life(low, high)
    promise = np.maximum(found.promise, 1e-6 * max(float(np.median(found.promise)), 1e-30))
    rows = dict(found.rows)
    opacity = sigmoid(np.minimum(model.opacity, OPAQUE))
    rows["opacity"] = rows["opacity"] / np.maximum(opacity * (1 - opacity), 1e-4)[:, None] ** 2
    rows["position"], rows["rotation"] = rows["position"] / 3, rows["rotation"] / 3
    size = np.sort(np.exp(model.scale.astype(np.float64)), axis=1)[:, 1:2]
    rows["position"] = rows["position"] * size**2
    rows["mu_tau"] = rows["mu_tau"] * ldexp(1.0, -2 * life)[:, None]
    steps = {}
    for name, squares in rows.items():
        ratio = np.where(squares > 0, squares / promise[:, None], np.nan)
        with np.errstate(all="ignore"):
            usual = np.array([np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else 0.0 for column in ratio.T])
        whole = squares + UNSEEN * usual * promise[:, None]
        steps[name] = -0.5 * np.log2(np.maximum(whole, 1e-38))
    own = dict(steps)
    with np.errstate(all="ignore"):
        steps["scale"] = -0.5 * np.log2(np.mean(np.exp2(-2 * steps["scale"]), axis=1, keepdims=True))
    base = {name: float(np.median(steps[name])) for name in ("position", "scale", "rotation", "opacity", "mu_tau")}
    shape = np.mean([steps[name][:, 0] - base[name] for name in SHAPE], axis=0)
    for name in ("rotation", "mu_tau"):
        base[name] = float(np.median(steps[name][:, 0] - shape))
    base["temporal"] = float(np.median(steps["temporal"] - shape[:, None])) if steps["temporal"].size else 0.0
    kind = spread(model.scale.astype(np.float64))
    rest = steps["rotation"][:, 0] - shape - base["rotation"]
    turn = np.array([round(float(np.median(rest[kind == k]))) if (kind == k).any() else 0 for k in range(SPREADS)])
    turn = np.clip(turn, -LARGEST, LARGEST)
    colour = np.median(steps["features"], axis=0)
    tint = np.mean((steps["features"] - colour)[:, :3], axis=1)
    colour = np.median(steps["features"] - tint[:, None], axis=0)
    return Prepared(model, shape, tint, base, colour, turn, own, low, high)


def _exp2(exponent: np.ndarray | float) -> np.ndarray:
    """2^exponent, as far as a header may say it: where nothing is seen of a model, any step does."""
    return np.exp2(np.clip(exponent, -LARGEST, LARGEST))


def _life(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(-np.log2(np.clip(high - low, 1e-9, 1))), 0, LIVES - 1).astype(int)


def quantised(ready: Prepared, level: float) -> tuple[dict[str, np.ndarray], Steps]:
    """Whole numbers by column [N, ...], and their steps.

    level  log2 of the error that each number may add, root mean square: one more doubles every step
    """
    model, low, high = ready.model, ready.low, ready.high
    life = _life(low, high)
    whole = int(np.floor(level))
    shape, tint = (np.clip(np.rint(values + level) - whole, -CLASSES, CLASSES).astype(int) for values in (ready.shape, ready.tint))
    base = {name: float(_exp2(value + whole)) for name, value in ready.base.items()}
    extent = float(np.abs(model.position).max(initial=1e-9))
    steps = Steps(base, _exp2(ready.colour + whole), ready.turn, np.zeros((LIVES, model.basis.terms), int),
                  np.zeros((LIVES, model.rotation_basis.terms), int), least=int(np.ceil(np.log2(extent))) - GRID)

    def eased(name: str) -> np.ndarray:
        """The steps [N, D] that the sensitivities of an array, or of a column of `temporal`, ask for, in the units of BOUNDS."""
        first, _, k = name.partition(".")
        array = np.minimum(np.exp2(ready.own[first] + level), BOUNDS[first])
        return array[:, [int(k)]] if k else array * ldexp(1.0, -life)[:, None] if name == "mu_tau" else array

    columns = {"shape": shape, "tint": tint, "life": life}
    columns["scale"] = model.scale, steps.of("scale", shape)[:, None]
    columns["opacity"] = sigmoid(model.opacity), steps.of("opacity", shape)
    columns["features"] = model.features, steps.of_features(tint)
    for k, logarithm in enumerate(model.temporal_kind.logarithms):
        if logarithm:
            columns[f"temporal.{k}"] = model.temporal[:, k], steps.of("temporal", shape)
    columns["mu_tau"] = model.mu_tau, ldexp(steps.of("mu_tau", shape), -life)
    codes = {name: value for name, value in columns.items() if name in ("shape", "tint", "life")}
    values: dict[str, np.ndarray] = {}
    for name in columns:
        if name not in codes:
            _chain(name, columns, codes, values, steps, eased(name))
    grain = steps.grain(values["scale"], shape)
    t = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, max(SAMPLES, model.basis.terms + 1, model.rotation_basis.terms + 1))
    weight = np.stack([model.temporal_kind.factor(moments, model.mu_tau, model.temporal) for moments in t.T], 1)
    weight /= np.sqrt(np.maximum((weight**2).sum(1, keepdims=True), 1e-12))
    span = (t, weight)
    pulled = pulls(eased("position")[:, 0] * np.sort(np.exp(values["scale"]), axis=1)[:, 1], ldexp(1.0, grain))[:, None]
    position = _trajectory(codes, "motion", model.basis, model.position, model.motion, model.mu_tau, values["mu_tau"], span,
                           ldexp(1.0, grain), pulled, life, steps.motion)
    fine = steps.turning(values["scale"], shape)
    turned = pulls(eased("rotation")[:, 0], fine)[:, None]
    rotation = _trajectory(codes, "rotation_motion", model.rotation_basis, model.rotation, model.rotation_motion, model.mu_tau,
                           values["mu_tau"], span, fine, turned, life, steps.swing)
    whole = model.rotation_basis.terms and not model.rotation_basis.centred  # else the constant term is the unit quaternion of the middle
    codes["rotation"] = rounded((rotation if whole else rotation[:, 1:]) / fine[:, None], turned)
    codes["position"] = chained(position, ldexp(1.0, grain)[:, None], np.broadcast_to(pulled, position.shape))
    for k, logarithm in enumerate(model.temporal_kind.logarithms):
        if not logarithm:
            bits = model.temporal[:, k].view("<u4")
            codes[f"temporal.{k}.high"], codes[f"temporal.{k}.low"] = (bits >> 16).astype(np.int64), (bits & 0xFFFF).astype(np.int64)
    return codes, steps


def _chain(name: str, columns: dict, codes: dict, values: dict, steps: Steps, ease: np.ndarray) -> None:
    """Quantise an attribute, each of its columns as it is or as differences, whichever costs fewer bits; values: as a reader has it."""
    true, step = columns[name]
    true = true.astype(np.float64).reshape(len(true), -1)
    step = np.broadcast_to(step.reshape(len(true), -1), true.shape)
    pull = np.broadcast_to(pulls(ease, step), true.shape)
    out, known = np.zeros(true.shape, np.int64), np.zeros(true.shape)
    order = list(range(true.shape[1]))
    pairs = name == "features" and true.shape[1] % 3 == 0
    if pairs:
        order = [3 * j + k for j in range(true.shape[1] // 3) for k in (1, 0, 2)]
    for k in order:
        from_ = {0: k + 1, 2: k - 1}.get(k % 3) if pairs else None
        choices = [(False, None), (True, None)] + ([(False, from_), (True, from_)] if from_ is not None else [])
        best = min(choices, key=lambda c: _bits(true[:, k] - (known[:, c[1]] if c[1] is not None else 0), step[:, k], c[0]))
        target = true[:, k] - (known[:, best[1]] if best[1] is not None else 0)
        if best[0]:
            out[:, k] = chained(target[:, None], step[:, k:k + 1], pull[:, k:k + 1])[:, 0]
            steps.chained.append(f"{name}/{k}")
            known[:, k] = np.cumsum(out[:, k] * step[:, k])
        else:
            out[:, k] = rounded(target / step[:, k], pull[:, k])
            known[:, k] = out[:, k] * step[:, k]
        if best[1] is not None:
            steps.paired.append((k, best[1]))
            known[:, k] += known[:, best[1]]
    shape = columns[name][0].shape
    codes[name], values[name] = out.reshape(shape), known.reshape(shape)


def _bits(values: np.ndarray, step: np.ndarray, chain: bool) -> float:
    """Roughly what values [N] cost, as they are or as differences."""
    if not len(values):
        return 0.0
    part = np.diff(values, prepend=0) if chain else values
    codes = np.clip(np.rint(part / step), -1000, 1000).astype(np.int64)
    count = np.bincount(codes - codes.min())
    count = count[count > 0]
    return float(-(count * np.log2(count / len(codes))).sum())


def restored(codes: dict[str, np.ndarray], steps: Steps, template: GaussianModel) -> dict[str, np.ndarray]:
    """The arrays of a model, float32, of columns of whole numbers; template: a model of its kinds."""
    scale = scales(codes, steps)
    sizes = step_sizes(codes, steps, scale)

    def attribute(name: str, step: np.ndarray) -> np.ndarray:
        return values_of(name, codes, step, steps)

    rotation = codes["rotation"] * sizes["rotation"]
    if rotation.shape[1] == 3:
        real = np.sqrt(np.maximum(0.02, 1 - (rotation**2).sum(1)))
        rotation = np.concatenate([real[:, None], rotation], 1)
    opacity = np.clip(attribute("opacity", sizes["opacity"]), LEAST_OPACITY, 1 - LEAST_OPACITY)
    arrays = {
        "position": np.cumsum(codes["position"] * sizes["position"], axis=0),
        "motion": codes["motion"] * sizes["motion"],
        "scale": scale,
        "rotation": rotation,
        "rotation_motion": codes["rotation_motion"] * sizes["rotation_motion"],
        "opacity": np.log(opacity) - np.log1p(-opacity),
        "features": attribute("features", sizes["features"]),
        "mu_tau": attribute("mu_tau", sizes["mu_tau"]),
        "temporal": np.empty((len(scale), template.temporal_kind.width), np.float32),
    }
    for k, logarithm in enumerate(template.temporal_kind.logarithms):
        if logarithm:
            arrays["temporal"][:, k] = attribute(f"temporal.{k}", steps.of("temporal", codes["shape"]))
        else:
            bits = codes[f"temporal.{k}.high"].astype(np.uint32) << 16 | codes[f"temporal.{k}.low"].astype(np.uint32)
            arrays["temporal"][:, k] = bits.view(np.float32)
    return arrays


def step_sizes(codes: dict[str, np.ndarray], steps: Steps, scale: np.ndarray) -> dict[str, np.ndarray]:
    """The steps of all arrays but temporal, [N], or of a shape that fits their codes; scale: that of a reader (scales())."""
    shape, life = codes["shape"], np.clip(codes["life"], 0, LIVES - 1)
    grain = ldexp(1.0, steps.grain(scale, shape))[:, None]
    fine = steps.turning(scale, shape)[:, None]
    return {
        "position": grain, "motion": ldexp(grain, steps.motion[life])[..., None], "scale": steps.of("scale", shape)[:, None],
        "rotation": fine, "rotation_motion": ldexp(fine, steps.swing[life])[..., None], "opacity": steps.of("opacity", shape),
        "features": steps.of_features(codes["tint"]), "mu_tau": ldexp(steps.of("mu_tau", shape), -life)}


def values_of(name: str, codes: dict[str, np.ndarray], step: np.ndarray, steps: Steps) -> np.ndarray:
    """The values of an attribute from its codes [N, ...] and their steps [N] or [N, D], float64."""
    n = len(codes[name])
    flat = codes[name].reshape(n, -1) * step.reshape(n, -1)
    for k in range(flat.shape[1]):
        if f"{name}/{k}" in steps.chained:
            np.cumsum(flat[:, k], out=flat[:, k])
    for k, other in steps.paired if name == "features" else ():
        flat[:, k] += flat[:, other]
    return flat.reshape(codes[name].shape)


def scales(codes: dict[str, np.ndarray], steps: Steps) -> np.ndarray:
    """ln of scale [N, 3], float64: other steps depend on it."""
    return values_of("scale", codes, steps.of("scale", codes["shape"]), steps)


def canonical(model: GaussianModel) -> GaussianModel:
    """The same Gaussians with unit quaternions of constant term, and their axes in the order that is nearest to no rotation."""
    turns, orders = [], []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[order, range(3)] = signs
        if np.linalg.det(matrix) > 0:
            turns.append(rotations.from_matrices(matrix))
            orders.append(order)
    constant = model.rotation.astype(np.float64)
    length = np.maximum(np.linalg.norm(constant, axis=1), 1e-12)[:, None]
    constant, motion = rotations.unit(constant), model.rotation_motion / length[:, None]
    choices = rotations.multiply(constant[:, None], np.array(turns)[None])
    best = np.abs(choices[..., 0]).argmax(1)
    sign = np.where(choices[np.arange(len(best)), best, :1] < 0, -1.0, 1.0)
    return replace(
        model, rotation=sign * choices[np.arange(len(best)), best],
        rotation_motion=sign[:, None] * rotations.multiply(motion, np.array(turns)[best][:, None]),
        scale=np.take_along_axis(model.scale, np.array(orders)[best], 1))


def _trajectory(codes: dict, name: str, basis: Basis, constant: np.ndarray, coefficients: np.ndarray, mu_true: np.ndarray, mu: np.ndarray,
                span: tuple[np.ndarray, np.ndarray], fine: np.ndarray, pull: np.ndarray, life: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Fills codes[name] with coefficients as whole numbers [N, K, D] and the table of steps; returns the constant [N, D] that fits.

    mu_true, mu  temporal centres before and after rounding; span: times [N, T] and their weights; fine: the steps [N]
    """
    n, terms = len(constant), basis.terms
    found_codes = np.zeros((n, terms, constant.shape[1]), np.int64)
    codes[name] = found_codes
    if not terms:
        return constant.astype(np.float64)
    t, weight = span[0], span[1][..., None]
    if not basis.centred and all((rows == rows[:1]).all() for rows in (t, weight)):
        t, weight = t[:1], weight[:1]  # one decomposition serves all Gaussians that live equally long
    def design(centre: np.ndarray) -> np.ndarray:
        return basis.weights(t - centre[:, None].astype(np.float64) if basis.centred else t)

    true = (constant[:, None] + design(mu_true) @ coefficients.astype(np.float64)) * weight
    functions = np.concatenate([np.ones((len(t), t.shape[1], 1)), design(mu)], 2) * weight
    q, r = np.linalg.qr(functions)
    wanted = q.transpose(0, 2, 1) @ true
    r = np.broadcast_to(r, (n, *r.shape[1:]))
    own = np.abs(np.einsum("nii->ni", r))
    for j in np.unique(life):
        usual = np.sqrt(np.mean(own[life == j, 1:] ** 2, axis=0))
        table[j] = np.clip(-np.rint(np.log2(np.maximum(usual, 2.0**-30))), -30, 30)
    found = np.zeros((n, terms + 1, constant.shape[1]))
    for k in range(terms, 0, -1):
        usable = own[:, k] > 1e-9
        rest = wanted[:, k] - np.einsum("nj,njd->nd", r[:, k, k + 1:], found[:, k + 1:])
        x = np.where(usable[:, None], rest / np.where(usable, r[:, k, k], 1)[:, None], 0)
        step = ldexp(fine, table[life, k - 1])[:, None]
        found_codes[:, k - 1] = rounded(np.clip(x / step, -2.0**30, 2.0**30), pull)
        found[:, k] = found_codes[:, k - 1] * step
    return (wanted[:, 0] - np.einsum("nj,njd->nd", r[:, 0, 1:], found[:, 1:])) / r[:, 0, 0, None]
