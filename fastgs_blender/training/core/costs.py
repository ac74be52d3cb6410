# SPDX-License-Identifier: GPL-3.0-or-later
"""What suits a capture and the length of a run, and the time and the memory of a run before it starts, on this machine's processor."""
import math
import time
from dataclasses import replace

from ...util.backends import load_backend
from ...util.remarks import remark
from ...util.threads import thread_count
from .presets import LENGTHS
from .settings import settings as make
from .spans import spans, steps_of

BASE_MEMORY, PICTURE_MEMORY, GAUSSIAN_BYTES, PIXEL_BYTES = 700 << 20, 768 << 20, 2600, 260
PIXEL, GAUSSIAN, WIDTH = 1.7e-7, 5.2e-7, 4.3e-7
"""Seconds of one thread that a step takes on a machine of 2026 for each pixel, for each Gaussian, and for each pixel of a Gaussian's width:
n Gaussians that cover p pixels are sqrt(p / n) wide (docs/notes/learning-rates.md)."""
START, DECODED, FEATURES, SWEPT = 3.0, 2.5e-8, 1.5e-6, 0.12
"""What comes before the first step there: seconds in all, for each pixel that is decoded, for each pixel of pictures whose features are
found and matched, and for each camera and moment of the plane sweep (12 and 20 frames of 10 and 14 cameras, 2026-11-30)."""
SWEEP_SIDE, FINE_SIDE, FINE_VIEWS = 128, 256, 8
"""Pictures are shrunk to a longer side of so many pixels for the plane sweep: of many cameras; of as many as the last, or fewer."""
SWEEP_LEAST, SWEEP_MORE = 0.2, 0.4
"""The share of that time that the smallest pictures take, and what each further SWEEP_SIDE x 3/4 SWEEP_SIDE pixels of larger ones add."""
FEATURE_MOMENTS, MOMENTS, MOST_VIEWS, FEATURE_PIXELS = 5, 16, 24, 1024 * 768
"""Moments of which features are found, those of refining cameras too, and at most compared; pictures of a moment at most; and of pixels."""
SMALL, FULL = 0.9, 0.87
"""Mean share of a picture's pixels, which are fewer first, and of the most Gaussians, over the steps of a run."""
MADE, MADE_PIXELS, MADE_SMALL = 20_000, 640 * 480, 1.5
"""Gaussians, pixels at most, and smallness of Gaussians of the steps that are timed; such steps take about as long as real ones."""
CORES = 2
ROOM, MOST_ROOMS = 2.5e6, 3.0
"""Pixels of one moment, of all training cameras together, for which the presets' numbers of Gaussians are; and how many times as many a
larger rig gets at most.  31 cameras of 640 x 360 around a hall show more than 18 of 480 x 360 around one room
(docs/notes/reconstruction.md)."""
DRAFT_PIXELS = 640 * 480
"""Pixels of a draft's pictures at most, where no scale is asked for: its few Gaussians show no more (docs/notes/learning-rates.md)."""
CALM = 7000 * 50_000
"""Steps times Gaussians from which on slopes have the whole floor."""
FRAMES = 100
"""Frames of a segment for which the presets' numbers of steps are; a longer one gets as many more."""


def rooms(pixels: float) -> float:
    """By how much a capture's cameras show more than those that the presets' numbers suit, 1 to MOST_ROOMS.

    pixels  of one moment, of all training cameras
    """
    return min(max(pixels / ROOM, 1.0), MOST_ROOMS)


def draft_scale(preset: str, pixels: float) -> float:
    """The factor on the sides of pictures of so many pixels in a run for which none was asked: 1, but for large pictures in a draft."""
    return 1.0 if preset.lower() != "draft" or pixels <= DRAFT_PIXELS else math.floor(100 * math.sqrt(DRAFT_PIXELS / pixels)) / 100


def trained_pixels(preset: str, pixels: float, scale: float = 0.0) -> int:
    """The pixels of a picture in a run; scale: the factor that was asked for, 0: none."""
    return round(pixels * (scale or draft_scale(preset, pixels)) ** 2)


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


def seconds_of_step(pixels: float, gaussians: float) -> float:
    """What a step takes on one thread of a machine of 2026."""
    return PIXEL * pixels + GAUSSIAN * gaussians + WIDTH * math.sqrt(pixels * gaussians)


def measured_pace(pixels: int) -> float:
    """How long this machine takes now, beside whatever else it does, for what takes one second on one thread of a machine of 2026.

    A few steps on a made scene are timed, half a second and more on slow machines.  The first time on a machine kernels are compiled, which
    training would have to do as well; a remark says so.

    pixels  of a picture: the made scene's are as many, but for very large ones
    """
    from ...kernels import made

    if not made.is_compiled():
        remark("FAST-GS: compiling training for this machine, to see how fast it is; this happens once and takes up to a minute.")
    width = max(math.isqrt(min(pixels, MADE_PIXELS) * 4 // 3), 16)
    camera = made.made_camera(width, width * 3 // 4)
    took = made.step_seconds(load_backend("cpu"), made.made_model(made.made_decoder(), MADE, MADE_SMALL), camera, time.perf_counter)
    return took / seconds_of_step(camera.width * camera.height, MADE)


def sweep_side(views: int) -> int:
    """Pixels of the longer side of the pictures in which the plane sweep compares so many cameras."""
    return FINE_SIDE if views <= FINE_VIEWS else SWEEP_SIDE


def estimate(pixels: int, iterations: int, gaussians: int, pictures: int = 0, views: int = 0,
             pace: float = 0.0) -> tuple[float, float]:
    """Seconds and bytes of memory that a run will take, roughly: it begins with fewer Gaussians and smaller pictures.

    pixels    of a picture; pictures: how many there are, 0: very many; views: cameras that are trained on
    pace      measured_pace of this machine; 0: that of a machine of 2026 with as many threads as are in use
    """
    pace = pace or 1 / thread_count()
    moments, alone = min(pictures // max(views, 1), MOMENTS), pace * thread_count()  # one thread finds features
    seconds = alone * (START + FEATURES * min(pixels, FEATURE_PIXELS) * views * min(moments + 1, FEATURE_MOMENTS))
    size = min(pixels, 0.75 * sweep_side(views)**2) / (0.75 * SWEEP_SIDE**2)
    swept = SWEPT * (SWEEP_LEAST + (1 - SWEEP_LEAST) * min(size, 1.0) + SWEEP_MORE * max(size - 1, 0.0))
    steps = iterations * seconds_of_step(SMALL * pixels, FULL * gaussians)
    seconds += pace * (DECODED * pixels * pictures + swept * min(views, MOST_VIEWS) * moments + steps)
    cached = min(PICTURE_MEMORY, 4 * pixels * pictures) if pictures else PICTURE_MEMORY
    return seconds, BASE_MEMORY + cached + GAUSSIAN_BYTES * gaussians + PIXEL_BYTES * pixels
