# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates each camera's exposure and clock offset during training, and compensates for them.

A camera's picture at time t is modelled as exp(fade * (2 t - 1)) * (gain * model(t + offset) + bias), for each channel.  Targets are
converted to the model's colours, and the model is rendered at the camera's own time, so that the model itself contains neither exposures
nor clock offsets.  Both are found in closed form, by least squares over the latest pictures of each camera: gain and bias by linear
regression of the picture on the render, the clock by one Gauss-Newton step along the model's derivative by time,
(model(t + d) - model(t - d)) / 2d.  Every backend can compute it.
Fades, exposures that change while a camera films, are known before training (initial/fades.py) and stay as they are.

A change that all cameras share cannot be told from the model, so medians are fixed: 1 for the gains, 0 for biases and clocks.

A model that is not exact is sure of wrong values.  With the setting auto, a camera's exposure and clock move only where pictures of two
cameras that see the same thing show that they differ (captures/evidence.py), and stay near what these show.
"""
from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...captures import gains as shared_colours
from ...captures.capture import Shot
from ...captures.clocks.find import LEAST as LEAST_CLOCK
from ...captures.evidence import differs, limits
from ...captures.pixels.store import Pixels
from ...training.core.settings import Settings

KEEP = 0.8
"""Decay: the factor on a camera's older sums when new ones are added."""
FIRST, LAST = 0.03, 0.95
"""The part of a run, by its share of steps, in which exposures and clocks are estimated.  Before it the model is too coarse; after it the
estimates stay constant."""
SETTLED = 0.5
"""Share of a run after which the estimation ends if cameras have not differed noticeably, where the settings say auto."""
CLOCKS_FIRST = 0.1
"""Share of a run after which clocks are estimated: the model must have motion."""
EVERY = 2
"""Steps between two estimates.  A clock needs two more renders."""
FARTHER = 1.7
"""Over-relaxation of a clock's correction: the model has already followed the camera's wrong clock a part of the way."""
APART = 0.25
"""Frames to either side at which the model's change in time is measured."""
OUTLIER = 0.1
"""Difference of colour (0..1) at which a pixel counts half."""
SOLID = 0.9
"""Pixels with a lower alpha of the model are not compared."""
CLIPPED = 0.99
"""Values above are taken for overexposed where a camera's pictures are made darker: the colour is at least so bright."""
NOTICED, NOTICED_CLOCK = 0.015, 0.12
"""Difference of middle grey (0..1), and of clocks in frames, below which cameras count as even when the settings say auto."""
PRIOR_GAIN, PRIOR_BIAS = 1e-4, 0.1
"""Pull towards gain 1 and bias 0, in mean squares of colour.  Exposures are gains: free biases take a part of them over (a model is never
exact, which makes slopes too small), and gains were off by 0.07 instead of 0.02 (benchmarks/uneven.py)."""
GAIN_PRIOR = 1.0
"""Pull towards the prior gains of starting points, in mean squares of colour.  These are right to 0.01 or so, while a model that is trained
with wrong gains partly believes them: its features see the direction, and with it the camera (benchmarks/uneven.py)."""
PRIOR_CLOCK, ALIKE_PIXELS = 0.5, 30.0
"""Standard deviation of clock offsets in frames, as a prior where the setting is on; number of pixels whose errors are correlated and
count as one."""
MOST_GAIN = 5.0
"""The largest gain that training corrects, and one over the smallest."""
TOGETHER = 0.6
"""Where the clocks of this share of the cameras seem to differ by less than NOTICED_CLOCK, they run together and stay equal.  A model
partly believes one wrong clock in all views near that camera, and a whole side of a rig would drift, by 0.1 frames and more
(benchmarks/uneven.py)."""
FARTHEST = 1.5
"""The largest clock offset in frames that training corrects; larger ones are found before training (captures/clocks)."""


SHAPES = {"gains": (3,), "biases": (3,), "offsets": (), "gain_priors": (2, 3), "offset_priors": (2,), "fades": (3,),
          "colour_sums": (3, 5), "clock_sums": (4,)}
"""Of one camera, the arrays that a checkpoint holds; all are float64."""


@dataclass(eq=False)
class CameraResponse:
    """The exposures and clock offsets of V cameras, and the sums that they are estimated from.

    views    their names;  frame: a frame in the model's time;  exposures, clocks: the settings of these names
    gains    [V, 3], biases [V, 3], offsets [V] of clocks in frames: as estimated
    gain_priors    [V, 2, 3] logarithms of gains that points show which cameras share (captures/gains.py), and their standard
                   deviations; 0, 0: none is known
    offset_priors  [V, 2] clock offsets that two cameras' pictures show (captures.clocks.epipolar), and their standard deviations, in
                   frames; 0, 0: none is known
    fades    [V, 3] logarithm of the exposure's change from the middle of the clip to its end
    colour_sums  [V, 3, 5] sums over pixels of w, w p, w q, w p^2, w p q; p the model's colour, q the picture's
    clock_sums   [V, 4] sums of w J^2, w J (r + J offset), w r^2, w; J the change of the render in a frame, r the target minus the render
    independent  [V] whether a camera is known not to run together with the others; its pictures are placed at their moments then
    """

    views: tuple[str, ...]
    frame: float
    exposures: str
    clocks: str
    gains: np.ndarray
    biases: np.ndarray
    offsets: np.ndarray
    gain_priors: np.ndarray
    offset_priors: np.ndarray
    fades: np.ndarray
    colour_sums: np.ndarray
    clock_sums: np.ndarray
    independent: np.ndarray | None = None

    @classmethod
    def initial(cls, views: Sequence[str], frame_count: int, settings: Settings, gains: np.ndarray | None = None,
                fades: np.ndarray | None = None, offsets: np.ndarray | None = None) -> CameraResponse:
        """The state at the first step: no sums; equal exposures and clocks, but for these priors (None: none are known)."""
        v = len(views)
        exposures, clocks = (value if v > 1 else "off" for value in (settings.exposures, settings.clocks))
        gains = np.zeros((v, 2, 3)) if gains is None or exposures == "off" else np.array(gains, np.float64)
        fades = np.zeros((v, 3)) if fades is None or exposures == "off" else np.array(fades, np.float64)
        offsets = np.zeros((v, 2)) if offsets is None else np.array(offsets, np.float64)
        if clocks == "on":
            offsets[offsets[:, 1] == 0] = 0.0, PRIOR_CLOCK
        made = cls(tuple(views), 1 / frame_count, exposures, clocks if frame_count > 1 else "off", np.exp(gains[:, 0]),
                   np.zeros((v, 3)), np.zeros(v), gains, offsets, fades, np.zeros((v, 3, 5)), np.zeros((v, 4)))
        return replace(made, offsets=made._clock_range().mean(0), gains=np.clip(made.gains, *made._gain_range()))

    # what it does to pictures

    @property
    def colours_differ(self) -> bool:
        """Whether colours are corrected: always, never, or (auto) where a camera's middle grey differs by more than NOTICED,
        or changes."""
        off = np.abs(0.5 * self.gains + self.biases - 0.5).max()
        return self.exposures == "on" or (self.exposures == "auto" and bool(off > NOTICED or self.fades.any()))

    @property
    def clocks_differ(self) -> bool:
        """Whether times are corrected: always, never, or (auto) where a clock differs by more than NOTICED_CLOCK."""
        return self.clocks == "on" or (self.clocks == "auto" and bool(np.abs(self.offsets).max() > NOTICED_CLOCK))

    def moment(self, shot: Shot) -> float:
        """The model's time t at which a shot was taken, with the camera's clock offset."""
        offset = self.offsets[self.views.index(shot.view)] if self.clocks_differ and shot.view in self.views else 0.0
        return shot.t + float(offset) * self.frame

    def pixels(self, shot: Shot, pixels: Pixels) -> Pixels:
        """A shot's pixels (captures.pixels.store.Pixels) in the model's colours; overexposed ones only say how bright it is at least."""
        if not self.colours_differ or shot.view not in self.views:
            return pixels
        rgb = self.in_model_colours(shot.view, self._steady(shot, pixels.rgb))
        least = (pixels.rgb > CLIPPED) & (rgb < pixels.rgb)
        return replace(pixels, rgb=rgb, stored=None, least=least if least.any() else None)

    def _steady(self, shot: Shot, rgb: np.ndarray) -> np.ndarray:
        """A picture's colours [h, w, 3] with the exposure that the camera had in the middle of the clip."""
        fade = self.fades[self.views.index(shot.view)]
        return rgb * np.exp(fade * (1 - 2 * shot.t)).astype(rgb.dtype) if fade.any() else rgb

    def in_model_colours(self, view: str, rgb: np.ndarray) -> np.ndarray:
        """Colours [..., 3] of a view's pictures, without fades, as the model has them."""
        if not self.colours_differ or view not in self.views:
            return rgb
        k = self.views.index(view)
        return (rgb - self.biases[k].astype(rgb.dtype)) / self.gains[k].astype(rgb.dtype)

    # how it is found

    def is_due(self, iteration: int, iterations: int) -> bool:
        """Whether this step's pictures are used to estimate exposures or clocks."""
        if iteration % EVERY or not FIRST * iterations <= iteration < LAST * iterations:
            return False
        return self.are_clocks_due(iteration, iterations) or (
            self._open(self.exposures, self.colours_differ, iteration, iterations) and _may_move(self._gain_range()))

    def are_clocks_due(self, iteration: int, iterations: int, views: Sequence[str] = ()) -> bool:
        """Whether this step's pictures are used to estimate clocks: where the clock of one of these views may move (none: of any)."""
        rows = [self.views.index(view) for view in views or self.views]
        return (iteration >= CLOCKS_FIRST * iterations and self._open(self.clocks, self.clocks_differ, iteration, iterations)
                and _may_move(self._clock_range()[:, rows]))

    @staticmethod
    def _open(setting: str, differ: bool, iteration: int, iterations: int) -> bool:
        """Whether the estimation continues; with auto it ends at SETTLED if cameras have not differed noticeably until then."""
        return setting == "on" or (setting == "auto" and (differ or iteration < SETTLED * iterations))

    def measure(self, backend: Any, shot: Shot, picture: Any, target: Any, weight: Any, least: Any, background: np.ndarray | None,
                sides: Sequence | None) -> Any:
        """The sums [19] over a shot's pixels that accumulate() takes, as an array of the backend (TrainingBackend.agreement).

        picture   the model's;  target, weight, least: of the Target, in the model's colours, on the backend
        sides     the model's pictures APART frames later and earlier, or None
        """
        k = self.views.index(shot.view)
        gain, bias = (self.gains[k], self.biases[k]) if self.colours_differ else (np.ones(3), np.zeros(3))
        return backend.agreement(picture, target, weight, least, background, gain, bias, sides, 2 * APART, SOLID, OUTLIER)

    def accumulate(self, measured: Iterable[tuple[Shot, np.ndarray]]) -> dict[str, np.ndarray]:
        """A step's sums for update(), by name; measured: (shot, measure() of it) of each of its pictures."""
        colour, clock = np.zeros_like(self.colour_sums), np.zeros_like(self.clock_sums)
        for shot, sums in measured:
            k = self.views.index(shot.view)
            if self.exposures != "off":
                colour[k] += sums[:15].reshape(3, 5)
            square, missing, error, count = sums[15:]
            clock[k] += square, missing + square * (self.offsets[k] if self.clocks_differ else 0.0), error, count
        return {"colour_sums": colour, "clock_sums": clock}

    def update(self, colour_sums: np.ndarray, clock_sums: np.ndarray) -> None:
        """Add the sums of a step's pictures, over all processes, and estimate anew."""
        for sums, new in ((self.colour_sums, colour_sums), (self.clock_sums, clock_sums)):
            fresh = np.abs(new).reshape(len(new), -1).sum(1) > 0
            sums[fresh] = KEEP * sums[fresh] + new[fresh]
        if self.exposures != "off" and colour_sums.any():
            self._fit_colours()
        if clock_sums.any():
            self._fit_clocks()

    def _fit_colours(self) -> None:
        n, p, q, pp, pq = np.moveaxis(self.colour_sums, -1, 0)
        known = n[:, 0] > 0
        n = np.maximum(n, 1e-9)
        expected, deviation = np.moveaxis(self.gain_priors, 1, 0)
        pull, towards = np.where(deviation > 0, GAIN_PRIOR, PRIOR_GAIN), np.exp(expected)
        a, b, c = pp / n + pull, p / n, 1 + PRIOR_BIAS
        right, above = pq / n + pull * towards, q / n
        det = a * c - b * b
        gains, biases = (right * c - b * above) / det, (a * above - b * right) / det
        gains = np.clip(np.where(known[:, None], gains, 1), 1 / MOST_GAIN, MOST_GAIN)
        biases = np.clip(np.where(known[:, None], biases, 0), -0.5, 0.5)
        self.gains = gains / np.exp(np.median(np.log(gains[known]), axis=0))
        self.biases = biases - np.median(biases[known], axis=0)
        self.gains[~known], self.biases[~known] = 1, 0
        low, high = self._gain_range()
        self.gains, self.biases = np.clip(self.gains, low, high), np.where(high > low, self.biases, 0.0)

    def _gain_range(self) -> np.ndarray:
        """Between which gains each camera's may move [2, V, 3]; equal ones: it stays."""
        if self.exposures != "auto":
            return np.stack([np.full_like(self.gains, value) for value in (1 / MOST_GAIN, MOST_GAIN)])
        expected, deviation = np.moveaxis(self.gain_priors, 1, 0)
        moves = shared_colours.brighter(self.gain_priors)[:, None]
        return np.clip(np.exp(limits(expected, deviation, moves)), 1 / MOST_GAIN, MOST_GAIN)

    def _fit_clocks(self) -> None:
        square, missing, error, n = self.clock_sums.T
        expected, deviation = self.offset_priors.T
        low, high = self._clock_range()
        pull = ALIKE_PIXELS * error / np.maximum(n, 1e-9) / np.maximum(deviation, 1e-6)**2
        known = (square > 0) & (high > low)
        if not known.any():
            return
        found = (missing + pull * expected) / np.maximum(square + pull, 1e-12)
        offsets = np.clip(self.offsets + FARTHER * (found - self.offsets), low, high)
        if self.clocks == "auto":
            self.offsets = np.where(known, offsets, self.offsets)
            return
        together = known & (np.abs(offsets - np.median(offsets[known])) < NOTICED_CLOCK)
        if self.independent is not None:
            together &= ~self.independent
        if together.sum() >= TOGETHER * known.sum():
            self.offsets = np.where(known & ~together, offsets, 0.0)
        else:
            self.offsets = np.where(known, offsets - np.median(offsets[known]), 0.0)

    def _clock_range(self) -> np.ndarray:
        """Between which offsets each clock may move [2, V]; equal ones: it stays."""
        expected, deviation = self.offset_priors.T
        if self.clocks != "auto":
            return np.stack([np.full_like(expected, -FARTHEST), np.full_like(expected, FARTHEST)])
        return np.clip(limits(expected, deviation, differs(expected, deviation, LEAST_CLOCK)), -FARTHEST, FARTHEST)

    def uncertainty(self) -> np.ndarray:
        """Standard deviations [V] of the clocks, in frames; inf where nothing is known of one."""
        square, _, error, n = self.clock_sums.T
        with np.errstate(divide="ignore", invalid="ignore"):
            own = np.where(square > 0, np.sqrt(ALIKE_PIXELS * error / np.maximum(n, 1e-9) / square), np.inf)
            return np.where(self.offset_priors[:, 1] > 0, 1 / np.hypot(1 / own, 1 / self.offset_priors[:, 1]), np.inf)

    def facts(self) -> dict:
        """JSON values of what was found, empty where cameras are even."""
        found: dict = {}
        if self.clocks_differ:
            found["clocks"] = {view: round(float(offset), 4) for view, offset in zip(self.views, self.offsets)}
        if self.colours_differ:
            found["exposures"] = {view: {"gain": np.round(gain, 4).tolist(), "bias": np.round(bias, 4).tolist()}
                                  | ({"fade": np.round(fade, 4).tolist()} if fade.any() else {})
                                  for view, gain, bias, fade in zip(self.views, self.gains, self.biases, self.fades)}
        return found


def _may_move(low_high: np.ndarray) -> bool:
    """Whether anything may move between these limits [2, ...]."""
    return bool((low_high[1] > low_high[0]).any())


@dataclass(frozen=True, eq=False)
class CorrectedStore:
    """A store of pictures whose pixels are in the model's colours."""

    store: Any
    response: CameraResponse

    def pixels(self, shot: Shot) -> Pixels:
        return self.response.pixels(shot, self.store.pixels(shot))
