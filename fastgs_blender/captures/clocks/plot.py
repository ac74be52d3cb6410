# SPDX-License-Identifier: GPL-3.0-or-later
"""Plots the curve of motion of each camera over time, before and after synchronisation, with Pillow."""
import colorsys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...util.outputs import replacing
from .curves import Curves, activity

SIZE = (1100, 620)
LEFT, RIGHT, TOP, GAP = 24, 170, 40, 60
MOST_NAMES = 26


def write_plot(path: Path, curves: Curves, offsets: Mapping[str, float]) -> None:
    """Write a PNG with the curves of all views above each other, as they are and moved by the offsets (frames); raises FastGSError."""
    image = draw(curves, offsets)
    with replacing([path]) as (part,), part.open("wb") as file:
        image.save(file, format="PNG")


def draw(curves: Curves, offsets: Mapping[str, float]) -> Any:
    """The picture."""
    from PIL import Image, ImageDraw

    image = Image.new("RGB", SIZE, "white")
    pen = ImageDraw.Draw(image)
    lines = {view: activity(change) for view, change in zip(curves.views, curves.change) if np.isfinite(change).any()}
    lines = {view: line / max(float(line.std()), 1e-6) for view, line in lines.items()}
    height = (SIZE[1] - TOP - GAP) // 2 - 14
    count = max((len(line) for line in lines.values()), default=2)
    late = [0.0, *(offsets.get(view, 0.0) for view in lines)]
    first, last = min(late), count - 1 + max(late)
    titles = "As filmed: how much changes from picture to picture", "With the clocks set right"
    for row, title in enumerate(titles):
        top = TOP + row * (height + GAP)
        box = (LEFT, top, SIZE[0] - RIGHT, top + height)
        pen.rectangle(box, outline=(190, 190, 190))
        pen.text((LEFT, top - 18), title, (40, 40, 40))
        for number, (view, line) in enumerate(lines.items()):
            places = np.arange(len(line)) + row * offsets.get(view, 0.0)
            x = box[0] + (places - first) / max(last - first, 1e-9) * (box[2] - box[0])
            y = (box[1] + box[3]) / 2 - np.clip(line / 3, -1, 1) * (height / 2 - 4)
            pen.line([(float(a), float(b)) for a, b in zip(x, y)], fill=_colour(number, len(lines)), width=2 if offsets.get(view) else 1)
        for share in (0, 0.25, 0.5, 0.75, 1):
            at = curves.first + first + share * (last - first)
            pen.text((box[0] + share * (box[2] - box[0]) - 10, box[3] + 4), f"{at:.0f}", (90, 90, 90))
    pen.text((SIZE[0] - RIGHT + 14, SIZE[1] - 24), "frame", (90, 90, 90))
    pen.text((SIZE[0] - RIGHT + 14, TOP - 18), "offset in frames", (40, 40, 40))
    for number, view in enumerate(list(lines)[:MOST_NAMES]):
        pen.text((SIZE[0] - RIGHT + 14, TOP + 20 * number), f"{view[:14]}  {offsets.get(view, 0.0):+.2f}", _colour(number, len(lines)))
    return image


def _colour(number: int, count: int) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in colorsys.hsv_to_rgb(number / max(count, 1), 0.85, 0.72))
