# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates the disk space, memory and time that training will need."""
import math
from contextlib import suppress

from ..captures.capture import by_view
from ..captures.pixels import decoding
from ..captures.pixels.bounds import most_bytes
from ..captures.pixels.framefiles import default_folder
from ..captures.pixels.store import RESERVE
from ..jobs import checks
from ..training.core import costs
from ..training.core.presets import LENGTHS
from ..training.core.settings import Settings
from ..training.core.spans import spans
from ..util.errors import FastGSError
from .report import Section
from .samples import Inspection


def run(inspection: Inspection) -> Section:
    """Bytes of the cache of decoded pictures against what is free, and the presets' time and memory on this machine's processor."""
    capture = inspection.capture
    section = Section("Disk and time", "Training decodes each picture once, into a cache on disk; times are of this machine's processor, "
                                       "without a GPU, as fast as it is now beside other programs, roughly.")
    size, pixels, moment = 0, 0, 0
    for shots in by_view(capture.shots).values():
        try:
            height, width, channels = decoding.shape(shots[0], capture.scale)
        except FastGSError:  # told with the files
            continue
        size += height * width * channels * len(shots)
        pixels = max(pixels, height * width)
        moment += height * width * (not shots[0].held_out)
    cut = spans(capture.clip.frame_count, Settings.segment_frames, Settings.segment_overlap)[0]
    size = size * cut.count // capture.clip.frame_count  # a long capture is decoded segment by segment
    free, most = None, most_bytes()
    with suppress(OSError):
        free = checks.free_bytes(default_folder(capture))
    if free is not None and min(size, most) + RESERVE > free:
        section.add("wrong", f"The cache of decoded pictures needs {min(size, most) / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free.",
                    "Free some space, use --scale or --frames, or set FASTGS_CACHE_DIR to a folder on another disk.", (),
                    ("cache", round(size / 1e9, 2), "GB"))
    elif size > most:
        section.add("note", f"All decoded pictures need {size / 1e9:.1f} GB, and their cache takes at most {most / 1e9:g} GB: the others "
                            "are decoded each time, which is slower.",
                    "Use --scale or --frames, or set FASTGS_CACHE_GB to more.", (), ("cache", round(size / 1e9, 2), "GB"))
    memory = checks.available_memory()
    rows = {}
    inspection.progress("measuring this machine", 0.0)
    pace, views = costs.measured_pace(pixels), len(inspection.capture.training_views)
    for preset in LENGTHS:
        used = costs.trained_pixels(preset, pixels, float(inspection.scaled))
        length = costs.size_of(preset, pixels=moment * used / max(pixels, 1), frames=capture.clip.frame_count)
        seconds, needed = costs.estimate(used, *length, len(capture), views, pace)
        rows[preset] = {"minutes": round(seconds / 60, 1), "memory_gb": round(needed / 1e9, 2)}
        if memory is not None and preset == "standard" and needed > memory:
            section.add("poor", f"Training with the preset {preset} takes about {needed / 1e9:.1f} GB of memory, and {memory / 1e9:.1f} "
                                "GB are free.",
                        "Close other programs, or train smaller pictures or fewer Gaussians.", (), ("memory", round(needed / 1e9, 2), "GB"))
        if used < pixels:
            rows[preset]["scale"] = round(math.sqrt(used / pixels), 2)
    times = "; ".join(f"{preset}{_smaller(row)} {_minutes(row['minutes'])} and {row['memory_gb']:.1f} GB of memory"
                      for preset, row in rows.items())
    section.summary += f" Cache: {size / 1e9:.2f} GB{f' of {free / 1e9:.0f} GB free' if free is not None else ''}. Training: {times}."
    section.measures = {"cache_gb": round(size / 1e9, 4), "free_gb": None if free is None else round(free / 1e9, 2), "presets": rows}
    return section


def _smaller(row: dict) -> str:
    return f" (pictures at {row['scale']:.0%} of their size)" if "scale" in row else ""


def _minutes(value: float) -> str:
    if value < 1.5:
        return "a minute" if value >= 0.75 else "less than a minute"
    return f"{value:.0f} minutes" if value < 100 else f"{value / 60:.1f} hours"
