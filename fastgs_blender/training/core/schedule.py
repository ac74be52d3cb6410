# SPDX-License-Identifier: GPL-3.0-or-later
"""The schedule of training: learning rates, views and picture size as functions of the step alone, so that nothing must be saved."""
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ...captures.capture import Shot
from ...model.motion import Basis
from .model import PLACE
from .settings import Settings

VIEWS, FRAMES, BACKGROUND, DENSITY, NOISE, POINTS, SCAN = range(10, 17)
"""What random numbers are drawn for: generator(seed, purpose, step) gives the same ones whenever it is asked."""

WARM = {"position": 1.0, "motion": 1.0, "scale": 0.5, "rotation": 0.5, "rotation_motion": 0.5}
"""What is slower after a warm start: the power of `warm_start_rate` by which its rate is multiplied."""


def generator(seed: int, purpose: int, *step: int) -> np.random.Generator:
    """A random generator seeded by these whole numbers alone."""
    return np.random.default_rng([seed, purpose, *step])


def learning_rates(settings: Settings, iteration: int, extent: float, depth: float, basis: Basis, warm: bool = False) -> dict:
    """The rate of every array at a step: a number, or a row of the array's columns.

    Lengths scale with the extent; positions begin with steps in proportion to the depth, how far away is what the cameras film, unless the
    settings say otherwise.  In the last part of the run all of them go down to nothing.  warm: the run began with a model, whose places
    and shapes want refining: steps by which they would be found would first destroy them.
    """
    done = min(iteration / max(settings.iterations, 1), 1.0)
    first, last = settings.position_rate * (depth if settings.rate_unit == "depth" else extent), settings.position_rate_end * extent
    position = first * (last / first) ** done if first > 0 else 0.0
    motion = settings.motion_rate * extent * settings.motion_decay**done
    features: Any = np.repeat([settings.base_rate, settings.direction_rate, settings.time_rate], 3)
    if settings.appearance != "features":
        features = settings.base_rate
        if settings.appearance != "rgb":  # 3DGS: higher bands at a twentieth
            bands = (int(settings.appearance[2:]) + 1) ** 2
            features = settings.base_rate * np.repeat(np.where(np.arange(bands) == 0, 1.0, 0.05), 3)
    decoder = np.full(12, settings.decoder_rate)  # by the columns of w1
    if not settings.decoder_place:
        decoder[PLACE] = 0
    others = {
        "rotation": settings.rotation_rate, "scale": settings.scale_rate,
        "opacity": settings.opacity_rate, "features": features,
        "rotation_motion": settings.turn_rate, "mu_tau": settings.centre_rate, "temporal": settings.duration_rate,
        "w1": decoder, "w2": settings.decoder_rate,
    }
    fade = settings.rate_decay**done
    rates = {"position": position, "motion": motion * np.repeat(1 / basis.frequency_index(), 3),
             **{name: rate * fade for name, rate in others.items()}}
    if warm:
        for name, power in WARM.items():
            rates[name] = rates[name] * settings.warm_start_rate**power
    rest = min((1 - done) / settings.cool_down, 1.0) if settings.cool_down else 1.0
    return {name: rate * rest for name, rate in rates.items()}


def slope_floors(settings: Settings, lens: float, depth: float) -> dict[str, float]:
    """Slopes of the loss by places and motion, from which on Adam's steps have about their full length.

    Adam goes as far for noise as for a clear slope.  On a plain wall, where no picture tells how far away a Gaussian is, it would go for a
    walk.  settings.slope_floor is the change of a picture's loss by one Gaussian that moves by the picture's width.

    lens  focal length in widths of a picture;  depth  how far away what is filmed is
    """
    return dict.fromkeys(("position", "motion"), settings.slope_floor * lens / depth)


def reduction(settings: Settings, iteration: int) -> int:
    """The factor by which pictures are reduced at this step: 4, 2, then 1 (more warm_up values begin smaller)."""
    ahead = sum(iteration < end * settings.iterations for end in settings.warm_up)
    return 2**ahead


class Views:
    """Chooses the shots of each step: of one moment each, every moment once per round, every shot of a moment equally often.

    scan_share  of the steps, evenly spread: they see shots of a scan, where there are some, each equally often
    """

    def __init__(self, shots: Sequence[Shot], seed: int, scan_share: float = 0.0) -> None:
        self.seed = seed
        moments: dict[int, list[int]] = {}
        self.scan = [i for i, shot in enumerate(shots) if shot.place]
        for i, shot in enumerate(shots):
            if not shot.place:
                moments.setdefault(shot.frame, []).append(i)
        self.moments = [moments[frame] for frame in sorted(moments)]
        self.scan_share = scan_share if self.scan else 0.0

    def at(self, iteration: int, count: int) -> list[int]:
        """Indices of `count` shots for a step.  If a moment has fewer shots, the rest come from the next moments."""
        before, after = (int(step * self.scan_share) for step in (iteration, iteration + 1))
        if after > before:
            turns = (divmod(before * count + k, len(self.scan)) for k in range(count))
            return [self.scan[int(_order(len(self.scan), self.seed, SCAN, cycle)[place])] for cycle, place in turns]
        iteration -= before
        chosen: list[int] = []
        slot = 0
        per_step = max(1, -(-count // max(len(m) for m in self.moments)))
        while len(chosen) < count:
            visit, place = divmod(iteration * per_step + slot, len(self.moments))
            moment = self.moments[int(_order(len(self.moments), self.seed, FRAMES, visit)[place])]
            for k in range(min(count - len(chosen), len(moment))):
                cycle, position = divmod(visit * count + k, len(moment))
                chosen.append(moment[int(_order(len(moment), self.seed, VIEWS, moment[0], cycle)[position])])
            slot += 1
        return chosen


def at_a_moment(shot: Shot, frames: int, *key: int) -> Shot:
    """A shot of a scan at a frame of the clip, drawn by the key: the place looks like this at all of them."""
    seed, *step = key
    frame = int(generator(seed, SCAN, *step).integers(frames))
    return replace(shot, frame=frame, t=frame / frames)


@lru_cache(maxsize=512)
def _order(length: int, *key: int) -> np.ndarray:
    return generator(*key).permutation(length)
