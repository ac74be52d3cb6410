# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts as SVG, and pictures with colours over them, for the page."""
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from .report import Picture

INK, SOFT, GRID = "#333", "#777", "#ddd"
GOOD, POOR, WRONG = "#3a7d5c", "#d98e04", "#c0392b"
COLOURS = ("#3a7d5c", "#3465a4", "#b5541c", "#8b5a9f", "#0f8a93", "#a08000", "#c0392b", "#4d4d4d")
COUNTS = ((0.62, 0.10, 0.10), (0.85, 0.25, 0.15), (0.95, 0.60, 0.15), (0.97, 0.85, 0.35), (0.62, 0.80, 0.45), (0.25, 0.60, 0.40))
"""Colours of places that 0, 1, 2, 3, 4, and 5 or more cameras see."""
WIDTH = 960


def svg(width: float, height: float, parts: Sequence[str]) -> str:
    """An SVG picture of that size, which shrinks with the page."""
    return (f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" xmlns="http://www.w3.org/2000/svg" '
            f'font-family="system-ui, sans-serif" font-size="12">{"".join(parts)}</svg>')


def text(x: float, y: float, words: str, anchor: str = "start", colour: str = SOFT, more: str = "") -> str:
    """SVG text at a position; anchor: start, middle or end."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}" {more}>{escape(words)}</text>'


def bars(caption: str, values: Mapping[str, float], unit: str, grades: Mapping[str, str] | None = None,
         line: tuple[float, str] | None = None, style: str = "{:.2f}") -> Picture:
    """A horizontal bar for each camera; NaN: "not measured".

    grades  severity of the cameras that have one; line: a value that is marked, and its words
    """
    known = [value for value in values.values() if np.isfinite(value)]
    top = max([*known, line[0] if line else 0, 1e-12]) * 1.1
    left, row, parts = 130, 20, []
    length = WIDTH - left - 90
    for k, (name, value) in enumerate(values.items()):
        y = 6 + row * k
        shown = name if len(name) <= 18 else f"{name[:8]}...{name[-7:]}"
        parts.append(text(left - 8, y + 13, shown, "end", INK))
        if not np.isfinite(value):
            parts.append(text(left + 4, y + 13, "not measured"))
            continue
        colour = {"wrong": WRONG, "poor": POOR}.get((grades or {}).get(name, ""), GOOD)
        wide = max(value, 0) / top * length
        parts.append(f'<rect x="{left}" y="{y + 2}" width="{wide:.1f}" height="{row - 5}" rx="2" fill="{colour}"/>')
        parts.append(text(left + wide + 6, y + 13, f"{style.format(value)} {unit}".strip(), colour=INK))
    height = 6 + row * len(values) + 4
    if line:
        x = left + line[0] / top * length
        parts.append(f'<line x1="{x:.1f}" y1="4" x2="{x:.1f}" y2="{height - 4}" stroke="{SOFT}" stroke-dasharray="4 3"/>')
        parts.append(text(x, height + 10, line[1], "middle"))
        height += 16
    return Picture(caption, svg(WIDTH, height, parts), wide=True)


def curves(caption: str, lines: Mapping[str, np.ndarray], across: str, up: str, first: int = 0) -> Picture:
    """A line for each camera over frames, and their names."""
    width, height, left, bottom = WIDTH, 240, 50, 30
    values = np.concatenate([line[np.isfinite(line)] for line in lines.values()] or [np.zeros(1)])
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    pad = max(0.05 * (high - low), 1e-3 * max(abs(high), 1e-3))
    low, high = low - pad, high + pad
    count = max(max((len(line) for line in lines.values()), default=1) - 1, 1)
    parts = [f'<rect x="{left}" y="8" width="{width - left - 10}" height="{height - bottom - 8}" fill="none" stroke="{GRID}"/>',
             text(left - 4, 18, f"{high:.3g}", "end"), text(left - 4, height - bottom, f"{low:.3g}", "end"),
             text(left, height - 14, str(first)), text(width - 10, height - 14, str(first + count), "end"),
             text((left + width) / 2, height - 14, across, "middle"), text(left + 6, 22, up)]
    for k, line in enumerate(lines.values()):
        x = left + np.arange(len(line)) / count * (width - left - 10)
        y = height - bottom - (line - low) / (high - low) * (height - bottom - 8)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y) if np.isfinite(b))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{COLOURS[k % len(COLOURS)]}" stroke-width="1.4"/>')
    along, down = float(left), height + 4.0
    for k, name in enumerate(lines):
        wide = 22 + 7 * len(name)
        if along + wide > width:
            along, down = float(left), down + 16
        parts.append(f'<rect x="{along}" y="{down - 8}" width="10" height="10" fill="{COLOURS[k % len(COLOURS)]}"/>')
        parts.append(text(along + 14, down + 1, name, colour=INK))
        along += wide
    return Picture(caption, svg(width, down + 8, parts), wide=True)


def counts_over(pixels: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """A picture [h, w, 3] uint8 under the colours of how many cameras see each of its cells, counts [rows, columns]; grey below them."""
    height, width = pixels.shape[:2]
    rows = np.minimum(np.arange(height) * counts.shape[0] // height, counts.shape[0] - 1)
    columns = np.minimum(np.arange(width) * counts.shape[1] // width, counts.shape[1] - 1)
    colour = np.array(COUNTS)[np.minimum(counts, len(COUNTS) - 1)][rows][:, columns]
    grey = pixels.astype(np.float32).mean(2, keepdims=True) / 255
    return (np.clip(0.55 * grey + 0.45 * colour * (0.35 + 0.65 * grey), 0, 1) * 255 + 0.5).astype(np.uint8)


def key_of_counts() -> str:
    """The legend of the colours of camera counts."""
    parts = []
    for k, colour in enumerate(COUNTS):
        parts.append(f'<rect x="{10 + 84 * k}" y="4" width="16" height="16" fill="{hexed(colour)}"/>')
        parts.append(text(32 + 84 * k, 17, f"{k}{' or more' if k == len(COUNTS) - 1 else ''}", colour=INK))
    return svg(560, 24, parts)


def hexed(colour: Sequence[float]) -> str:
    """#rrggbb of a colour 0..1."""
    return "#" + "".join(f"{round(255 * c):02x}" for c in colour)
