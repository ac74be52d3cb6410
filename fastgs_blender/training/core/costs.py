# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates the time and the memory of a run before it starts, on this machine's processor."""
import os

from .presets import PRESETS
from .settings import Settings

BASE_MEMORY, PICTURE_MEMORY, GAUSSIAN_BYTES, PIXEL_BYTES = 700 << 20, 768 << 20, 2600, 260
STEP, PIXEL, GAUSSIAN = 0.015, 2.4e-7, 2.2e-6
"""Seconds for a step, and more for each pixel and Gaussian, on two cores: fitted to runs on a machine of 2026."""
CORES = 2


def size_of(preset: str, iterations: int = 0, max_gaussians: int = 0) -> tuple[int, int]:
    """Number of steps and maximum number of Gaussians of a run."""
    chosen = PRESETS[preset.lower()]
    return (iterations or chosen.get("iterations", Settings.iterations),
            max_gaussians or chosen.get("max_gaussians", Settings.max_gaussians))


def estimate(pixels: int, iterations: int, gaussians: int, pictures: int = 0) -> tuple[float, float]:
    """Seconds and bytes of memory that a run will take, roughly: it begins with fewer Gaussians and smaller pictures.

    pixels    of a picture; pictures: how many there are, 0: very many
    """
    cores = max(os.cpu_count() or 1, 1)
    seconds = iterations * (STEP + (0.85 * PIXEL * pixels + 0.7 * GAUSSIAN * gaussians) * CORES / cores)
    held = min(PICTURE_MEMORY, 4 * pixels * pictures) if pictures else PICTURE_MEMORY
    return seconds, BASE_MEMORY + held + GAUSSIAN_BYTES * gaussians + PIXEL_BYTES * pixels
