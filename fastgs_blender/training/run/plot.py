# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws loss and PSNR of a run over its steps, with Pillow."""
from pathlib import Path
from typing import Any

import numpy as np

from ...util.outputs import writing
from ...util.reading import parse_json, read_text, reading
from ..core.state import is_number

SIZE = (900, 420)
MARGINS = (64, 64, 30, 40)
"""Left, right, top, bottom, in pixels."""
COLOURS = {"loss": (200, 70, 40), "PSNR": (40, 90, 180), "held-out PSNR": (30, 140, 70)}


def write_plot(path: Path, log: Path) -> None:
    """Write a PNG of the values in a log; raises FastGSError or OSError."""
    with reading(log):
        rows = [parse_json(line) for line in read_text(log).splitlines() if line.endswith("}")]
    image = draw(series(rows, "smooth_loss"), {"PSNR": series(rows, "smooth_psnr"), "held-out PSNR": series(rows, "held_out_psnr")})
    with writing([path]) as (part,), part.open("wb") as file:
        image.save(file, format="PNG")


def series(rows: list[dict], name: str) -> np.ndarray:
    """[M, 2] steps and finite values of one column; None stands in the log where there was no finite one."""
    points = [(row.get("iteration"), row.get(name)) for row in rows if isinstance(row, dict)]
    found = np.array([point for point in points if all(is_number(value, -1e300, 1e300) for value in point)], np.float64).reshape(-1, 2)
    return found[np.isfinite(found).all(1)]


def draw(loss: np.ndarray, decibels: dict[str, np.ndarray]) -> Any:
    """The picture: loss on the left axis (logarithmic), decibels on the right."""
    from PIL import Image, ImageDraw

    image = Image.new("RGB", SIZE, "white")
    pen = ImageDraw.Draw(image)
    left, right, top, bottom = MARGINS
    box = (left, top, SIZE[0] - right, SIZE[1] - bottom)
    pen.rectangle(box, outline=(160, 160, 160))
    every = [points for points in (loss, *decibels.values()) if len(points)]
    if not every:
        return image
    end = max(points[:, 0].max() for points in every) or 1
    if len(loss):
        low, high = _span(np.log10(np.maximum(loss[:, 1], 1e-9)), 0.05)
        _line(pen, box, loss[:, 0] / end, (np.log10(np.maximum(loss[:, 1], 1e-9)) - low) / (high - low), COLOURS["loss"])
        for share in (0, 0.25, 0.5, 0.75, 1):
            text = f"{10 ** (low + share * (high - low)):.3g}"
            pen.text((6, box[3] - share * (box[3] - box[1]) - 6), text, COLOURS["loss"])
    values = np.concatenate([points[:, 1] for points in decibels.values() if len(points)] or [np.zeros(0)])
    if len(values):
        low, high = _span(values, 1.0)
        for name, points in decibels.items():
            _line(pen, box, points[:, 0] / end, (points[:, 1] - low) / (high - low), COLOURS[name])
        for share in (0, 0.25, 0.5, 0.75, 1):
            text = f"{low + share * (high - low):.1f} dB"
            pen.text((box[2] + 6, box[3] - share * (box[3] - box[1]) - 6), text, COLOURS["PSNR"])
    for share in (0, 0.25, 0.5, 0.75, 1):
        pen.text((box[0] + share * (box[2] - box[0]) - 12, box[3] + 8), f"{share * end:.0f}", (90, 90, 90))
    x = box[0]
    for name in ("loss", *(n for n, points in decibels.items() if len(points))):
        pen.text((x, 10), name, COLOURS[name])
        x += 24 + 7 * len(name)
    return image


def _span(values: np.ndarray, least: float) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    spare = max(least - (high - low), 0) / 2 + 0.04 * (high - low)
    return low - spare, high + spare


def _line(pen: Any, box: tuple, x: np.ndarray, y: np.ndarray, colour: Any) -> None:
    if len(x) > 1:
        across, down = box[0] + x * (box[2] - box[0]), box[3] - y * (box[3] - box[1])
        pen.line([(float(a), float(b)) for a, b in zip(across, down)], fill=colour, width=2)
