# SPDX-License-Identifier: GPL-3.0-or-later
"""Lays pictures out in a grid, each with its name above it."""
from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from PIL import Image, ImageDraw

GAP = 6
LINE = 18
"""Pixels between pictures, and of the line with their names."""
LIGHT, DARK = ((255, 255, 255), (40, 40, 40)), ((24, 24, 26), (230, 230, 230))
"""Colours of the ground and of the names."""


def grid(pictures: Iterable[tuple[str, np.ndarray]], columns: int, colours=LIGHT) -> Image.Image:
    """Pictures of one size and their names, so many a row.

    pictures  (name, [h, w, 3]): uint8, or floats in 0..1
    """
    pictures = [(name, pixels if pixels.dtype == np.uint8 else np.uint8(np.clip(np.nan_to_num(pixels), 0, 1) * 255 + 0.5))
                for name, pixels in pictures]
    height, width = pictures[0][1].shape[:2]
    ground, ink = colours
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * (width + GAP) + GAP, rows * (height + GAP + LINE) + GAP), ground)
    draw = ImageDraw.Draw(sheet)
    for number, (name, pixels) in enumerate(pictures):
        left, top = GAP + number % columns * (width + GAP), GAP + number // columns * (height + GAP + LINE)
        draw.text((left + 2, top + 3), name, fill=ink)
        sheet.paste(Image.fromarray(pixels), (left, top + LINE))
    return sheet
