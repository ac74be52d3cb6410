# SPDX-License-Identifier: GPL-3.0-or-later
"""Side-by-side pictures with titles, and errors as a heat map."""
from collections.abc import Sequence
from typing import Any

import numpy as np

HEAT_TOP = 0.25
"""The error that gets the brightest colour; larger ones get it too."""

HEAT = np.array([[0, 0, 0], [52, 10, 96], [150, 28, 98], [228, 72, 46], [250, 160, 30], [255, 255, 190]], np.float64) / 255
"""Colours of equally spaced errors from 0 to HEAT_TOP: dark to bright, also for eyes that see no red or green."""

STRIP, GAP = 20, 4
PAPER, INK = (24, 24, 24), (230, 230, 230)


def heat(error: np.ndarray) -> np.ndarray:
    """Colours [h, w, 3] of errors [h, w] between 0 and HEAT_TOP."""
    at = np.clip(error / HEAT_TOP, 0, 1)
    return np.stack([np.interp(at, np.linspace(0, 1, len(HEAT)), HEAT[:, channel]) for channel in range(3)], -1)


def comparison(truth: np.ndarray, picture: np.ndarray, label: str, error: bool) -> np.ndarray:
    """Truth beside picture, [h, w, 3] in 0..1 each, and where `error`, the mean absolute error of the channels as heat.

    Returns uint8 [h', w', 3] with even sides, as films need.
    """
    panels = [(f"truth  {label}", truth), ("render", picture)]
    if error:
        panels.append(("|render - truth|", heat(np.abs(np.clip(picture, 0, 1) - np.clip(truth, 0, 1)).mean(-1))))
    return _panels(panels, scale=error)


def _panels(panels: Sequence[tuple[str, np.ndarray]], scale: bool) -> np.ndarray:
    from PIL import Image, ImageDraw

    height, width = panels[0][1].shape[:2]
    whole = (len(panels) * (width + GAP) - GAP, height + STRIP)
    sheet = Image.new("RGB", tuple(side + side % 2 for side in whole), PAPER)
    draw = ImageDraw.Draw(sheet)
    for i, (title, picture) in enumerate(panels):
        left = i * (width + GAP)
        sheet.paste(Image.fromarray(_bytes(picture)), (left, STRIP))
        _write(sheet, title, left, width)
    if scale:
        ramp = np.tile(np.linspace(0, HEAT_TOP, 64)[None, :], (8, 1))
        text = f"0 .. {HEAT_TOP:g}"
        right = left + width - draw.textlength(text) - 4
        if right - 70 > left + draw.textlength(title):
            sheet.paste(Image.fromarray(_bytes(heat(ramp))), (int(right - 68), 6))
            draw.text((right, 4), text, fill=INK)
    return np.asarray(sheet)


def _write(sheet: Any, title: str, left: int, width: int) -> None:
    """A title that ends where its panel does."""
    from PIL import Image, ImageDraw

    strip = Image.new("RGB", (width, STRIP), PAPER)
    ImageDraw.Draw(strip).text((3, 4), title, fill=INK)
    sheet.paste(strip, (left, 0))


def _bytes(picture: np.ndarray) -> np.ndarray:
    return np.floor(np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
