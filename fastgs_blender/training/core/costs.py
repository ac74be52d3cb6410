# SPDX-License-Identifier: GPL-3.0-or-later
"""What suits a capture and the length of a run, and the time and the memory of a run before it starts, on this machine's processor."""
import os
from dataclasses import replace

from .presets import LENGTHS
from .settings import settings as make
from .spans import spans, steps_of

BASE_MEMORY, PICTURE_MEMORY, GAUSSIAN_BYTES, PIXEL_BYTES = 700 << 20, 768 << 20, 2600, 260
START, STEP, PIXEL, GAUSSIAN = 50.0, 0.003, 4.8e-7, 6.8e-7
"""Seconds for cameras and starting points, for a step, and more for each pixel and Gaussian, on two cores: fitted to runs on a machine of
2026 (the kitchen, the room and the basketball) beside other programs."""
CORES = 2
ROOM, MOST_ROOMS = 2.5e6, 3.0
"""Pixels of one moment, of all training cameras together, for which the presets' numbers of Gaussians are; and how many times as many a
larger rig gets at most.  31 cameras of 640 x 360 around a hall show more than 18 of 480 x 360 around one room
(docs/notes/reconstruction.md)."""
CALM = 7000 * 50_000
"""Steps times Gaussians from which on slopes have the whole floor."""
FRAMES = 100
"""Frames of a segment for which the presets' numbers of steps are; a longer one gets as many more."""


def rooms(pixels: float) -> float:
    """By how much a capture's cameras show more than those that the presets' numbers suit, 1 to MOST_ROOMS.

    pixels  of one moment, of all training cameras
    """
    return min(max(pixels / ROOM, 1.0), MOST_ROOMS)


def longer(frames: int) -> float:
    """By how much a segment of so many frames is longer than those that the presets' steps suit; at least 1."""
    return max(frames / FRAMES, 1.0)


def calm(iterations: int, max_gaussians: int) -> float:
    """The share of the usual floor under slopes (schedule.slope_floors) that a run asks for, 0 to 1.

    The floor shortens walks at random, and what has a clear slope goes more slowly by it too.  A walk goes as far as the root of the steps,
    and Gaussians are as small as the root of their number: so a draft, of fewer steps and larger Gaussians, needs less of it.
    """
    return min(iterations * max_gaussians / CALM, 1.0)


def size_of(preset: str, iterations: int = 0, max_gaussians: int = 0, pixels: float = 0, frames: int = 0) -> tuple[int, int]:
    """Number of steps of a run in all its segments, and maximum number of Gaussians of one; pixels as in rooms(), frames of the clip."""
    settings = make(preset=preset.lower())
    cuts = spans(frames, settings.segment_frames, settings.segment_overlap)
    times, steps = (rooms(pixels), longer(cuts[0].count)) if preset.lower() in LENGTHS else (1.0, 1.0)
    first = replace(settings, iterations=iterations or round(steps * settings.iterations))
    return steps_of(frames, first), max_gaussians or round(times * settings.max_gaussians)


def estimate(pixels: int, iterations: int, gaussians: int, pictures: int = 0) -> tuple[float, float]:
    """Seconds and bytes of memory that a run will take, roughly: it begins with fewer Gaussians and smaller pictures.

    pixels    of a picture; pictures: how many there are, 0: very many
    """
    cores = max(os.cpu_count() or 1, 1)
    seconds = START * CORES / cores + iterations * (STEP + (0.85 * PIXEL * pixels + 0.7 * GAUSSIAN * gaussians) * CORES / cores)
    cached = min(PICTURE_MEMORY, 4 * pixels * pictures) if pictures else PICTURE_MEMORY
    return seconds, BASE_MEMORY + cached + GAUSSIAN_BYTES * gaussians + PIXEL_BYTES * pixels
