# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the results of evaluate() as a table for people, as JSON and as CSV."""
import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path

from ..util.errors import printable
from ..util.outputs import writing
from .evaluate import MEASURES

COLUMNS = {"psnr": ("PSNR dB", ".2f"), "psnr_right": ("right half", ".2f"), "psnr_foreground": ("fg PSNR", ".2f"),
           "dssim1": ("DSSIM1", ".4f"), "dssim1_skimage": ("DSSIM1 sk", ".4f"), "dssim2": ("DSSIM2", ".4f"),
           "lpips": ("LPIPS", ".4f"), "lpips_normalised": ("LPIPS +-1", ".4f"), "flip": ("FLIP", ".4f"),
           "flicker": ("flicker", ".4f")}
"""Heading and number format of each measure in the table."""


def table(result: dict) -> str:
    """Every frame, then the averages of each view and of all; measures that no frame has are left out."""
    names = [name for name in MEASURES if result["average"][name] is not None]
    rows = [(printable(row["view"]), str(row["frame"]), row) for row in result["rows"]]
    averages = [(printable(view), f"mean of {means['frames']}", means) for view, means in result["views"].items()]
    if len(averages) > 1:
        averages.append(("all", f"mean of {result['average']['frames']}", result["average"]))
    averages += [(name, f"mean of {result[name]['frames']}", result[name]) for name in ("unseen", "seen") if name in result]
    width = max(4, *(len(view) for view, _, _ in rows))
    second = max(len(text) for _, text, _ in rows + averages)

    def line(view: str, frame: str, cells: Sequence[str]) -> str:
        return f"{view:<{width}}  {frame:>{second}}" + "".join(
            f"{cell:>{max(len(COLUMNS[name][0]), 6) + 2}}" for name, cell in zip(names, cells, strict=True))

    def cells(values: dict) -> list[str]:
        return [f"{values[name]:{COLUMNS[name][1]}}" if values[name] is not None else "-" for name in names]

    head = line("view", "frame", [COLUMNS[name][0] for name in names])
    rule = "-" * len(head)
    remarks = ["the colours of each half of a picture are fitted on its other half:"] if result.get("fit_colours") else []
    return "\n".join([*remarks, head, *(line(view, frame, cells(values)) for view, frame, values in rows), rule,
                      *(line(view, frame, cells(values)) for view, frame, values in averages)])


def write(result: dict, folder: Path) -> list[Path]:
    """evaluation.json, all of it, and evaluation.csv, a line for each frame and each average; returns the two files."""
    targets = [folder / "evaluation.json", folder / "evaluation.csv"]
    with writing(targets, "choose another folder with --out") as (values, lines):
        values.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        lines.write_text(_csv(result), encoding="utf-8", newline="")
    return targets


def _csv(result: dict) -> str:
    """Columns: view, frame ("mean" in the averages, whose view is "all" for the last), t, trained_on, MEASURES, milliseconds."""
    text = io.StringIO()
    columns = ["view", "frame", "t", "trained_on", *MEASURES, "milliseconds"]
    writer = csv.DictWriter(text, columns, restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(result["rows"])
    writer.writerows({"view": view, "frame": "mean", **means} for view, means in (*result["views"].items(), ("all", result["average"])))
    return text.getvalue()
