# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a run will take on this machine: a few steps of it are taken, on pictures of noise, and timed."""
import time
from dataclasses import replace

import numpy as np

from ...captures.capture import Capture, Points, Shot
from ...captures.pixels.store import Pixels
from ..core.settings import Settings
from ..core.start import Start
from ..core.trainer import Trainer
from ..initial.first_model import model_from_points
from .segments import spans

SHARE = 0.7
"""Of the largest number of Gaussians, what a run has in the mean."""
STEPS = 2
"""Timed steps, after one that compiles what is to be compiled."""


class _Noise:
    """A FrameStore of pictures that are not on disk."""

    def pixels(self, shot: Shot) -> Pixels:
        """Noise of the shot's size."""
        assert shot.camera is not None
        return Pixels(np.random.default_rng(1).random((shot.camera.height, shot.camera.width, 3), np.float32))


def steps_of(capture: Capture, settings: Settings) -> int:
    """Steps of a whole run, in all its segments."""
    cuts = spans(capture.clip.frame_count, settings.segment_frames, settings.segment_overlap)
    return sum(settings.of_segment(k).iterations for k in range(len(cuts)))


def gaussians_of(settings: Settings) -> int:
    """Gaussians with which its steps are timed."""
    return max(int(SHARE * settings.max_gaussians), 1)


def step_seconds(capture: Capture, settings: Settings, backend: str) -> float:
    """Seconds of a step: whole pictures, Gaussians around what the cameras film, no density control."""
    cut = spans(capture.clip.frame_count, settings.segment_frames, settings.segment_overlap)[0]
    first = capture.part(cut.first, cut.count)
    rng, count = np.random.default_rng(0), gaussians_of(settings)
    distance = float(np.linalg.norm(first.focus - first.centres(), axis=1).mean())
    points = Points(np.asarray(first.focus + 0.3 * distance * rng.normal(size=(count, 3)), np.float32), rng.random((count, 3)))
    plain = replace(settings, warm_up=(), densify_from=1.0, densify_until=1.0, reset_every=0, moving_weight=1.0, exposures="off",
                    clocks="off", poses="off")
    model = model_from_points(points, plain, first.clip, first.axes, first.extent)
    trainer = Trainer(first, _Noise(), plain, Start(model), backend=backend)
    times = []
    for _ in range(1 + STEPS):
        began = time.perf_counter()
        trainer.step()
        times.append(time.perf_counter() - began)
    return min(times[1:])
