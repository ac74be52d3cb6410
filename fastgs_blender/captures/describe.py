# SPDX-License-Identifier: GPL-3.0-or-later
"""The facts of a capture that `fastgs info` prints: as JSON values, and as lines for people."""
import contextlib
from collections import Counter
from dataclasses import asdict

from ..util.errors import FastGSError
from ..util.screen import screen
from .capture import Capture, Shot, by_view
from .pixels.checks import problems
from .pixels.probe import Facts, facts

MEANINGS = {"foreground": "mask files, white is the subject", "valid": "mask files, black is ignored", "alpha": "alpha channel"}


def describe(capture: Capture) -> dict:
    """Layout, cameras, time line, pictures, masks, points, remarks and problems, as JSON values; headers of all files are read."""
    shots = by_view(capture.shots)
    known = {view: _facts(each[0]) for view, each in shots.items()}
    return {
        "capture": str(capture.path),
        "layout": capture.layout,
        "posed": capture.posed,
        "views": [_view(each[0], len(each), known[view]) for view, each in shots.items()],
        "held_out": capture.held_out_views,
        "pictures": len(capture),
        "clip": {**asdict(capture.clip), "duration_seconds": capture.clip.duration},
        "scale": capture.scale,
        "axes": capture.axes,
        "extent": capture.extent if capture.posed else None,
        "masks": _masks(capture, known),
        "points": None if capture.points is None else len(capture.points),
        "timed_points": capture.points is not None and capture.points.t is not None,
        "notes": capture.notes,
        "problems": problems(capture),
    }


def _facts(shot: Shot) -> Facts | None:
    with contextlib.suppress(FastGSError):  # problems() tells
        return facts(shot.image)
    return None


def _view(shot: Shot, count: int, found: Facts | None) -> dict:
    size = (shot.camera.width, shot.camera.height) if shot.camera else (None, None)
    return {"name": shot.view, "pictures": count, "held_out": shot.held_out, "file_width": found and found.width,
            "file_height": found and found.height, "width": size[0], "height": size[1],
            "lens": shot.image.lens.model if shot.image.intrinsics else None}


def _masks(capture: Capture, known: dict) -> str | None:
    if any(shot.mask is not None for shot in capture.shots):
        return capture.mask_means
    return "alpha" if any(found is not None and found.alpha for found in known.values()) else None


def text(found: dict, everything: bool = True) -> str:
    """describe()'s facts for people; see util.screen."""
    clip, views = found["clip"], found["views"]
    sizes = Counter((v["file_width"], v["file_height"]) for v in views)
    scaled = Counter((v["width"], v["height"]) for v in views if v["width"])
    pictures = f"{found['pictures']}, {_sizes(sizes)}"
    if scaled and scaled != sizes:
        pictures += f"; used at {_sizes(scaled)}"
    names = [v["name"] for v in views]
    moving = "" if len(views) > 1 or found["pictures"] == 1 else " (moving)"
    points = "none" if found["points"] is None else f"{found['points']}{', with times' if found['timed_points'] else ''}"
    lenses = sorted({v["lens"] for v in views if v["lens"]} - {"pinhole"})
    return screen([
        ("capture", found["capture"]),
        ("layout", found["layout"]),
        ("cameras", f"{len(views)}{moving}: {_some(names)}" + (f"; lenses undone: {', '.join(lenses)}" if lenses else "")),
        ("held out", _some(found["held_out"]) if found["held_out"] else "none"),
        ("poses", f"known, axes {found['axes']}, extent {found['extent']:.4g}" if found["posed"] else "unknown; training finds them first"),
        ("clip", f"{clip['frame_count']} frames from {clip['start_frame']} at {clip['fps']:g} fps, {clip['duration_seconds']:.3g} s"),
        ("pictures", pictures),
        ("masks", MEANINGS.get(found["masks"], "none")),
        ("points", points),
        *(("problem", problem) for problem in found["problems"]),
        *(("note", note) for note in found["notes"]),
    ], everything)


def _sizes(counts: Counter) -> str:
    return ", ".join(f"{w} x {h}" if w else "of unknown size" for w, h in counts)


def _some(names: list[str], most: int = 8) -> str:
    return ", ".join(names) if len(names) <= most + 1 else f"{', '.join(names[:most])} ... {names[-1]}"
