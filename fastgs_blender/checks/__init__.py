# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks a capture for problems before training: check() measures a bounded part of it and returns a CheckReport.

A check is a module of this folder with run(inspection) -> Section, and its name in CHECKS.
"""
import importlib
import os
from collections.abc import Callable, Sequence

from ..captures import open_capture
from ..util.errors import FastGSError
from ..util.progress import staged
from .report import CheckReport, Section
from .samples import Inspection, sample

CHECKS = ("files", "calibration", "timing", "exposure", "sharpness", "coverage", "extrapolation", "cost")
"""Names of the checks, in the order in which they are made and shown."""
WEIGHTS = {"reading pictures": (0.0, 0.4), "comparing pictures": (0.4, 0.75), "comparing clocks": (0.75, 0.95),
           "measuring this machine": (0.95, 1.0)}
"""Begin and end of the long stages, as shares of the whole."""


def check(path: str | os.PathLike, *, scale: float | None = None, frames: slice | None = None, held_out: Sequence[str] | None = None,
          layout: str | None = None, progress: Callable[[str, float], None] | None = None) -> CheckReport:
    """Look at the capture in a folder or file, and say what will make a model of it poor.

    scale, frames, held_out, layout  as open_capture() has them; progress(stage, share) is called with shares from 0 to 1
    Pictures of at most a few moments are looked at: a minute for a usual capture.  Raises FastGSError where it is none, or no picture
    can be read.

    Example:
        report = fg.check("my-capture")
        print(report.verdict)
    """
    capture = open_capture(path, scale=scale, frames=frames, held_out=held_out, layout=layout)
    report = progress or (lambda *_: None)
    inspection = Inspection(capture, staged(WEIGHTS, report), scale is not None)
    sample(inspection)
    sections = {}
    for name in CHECKS:
        module = importlib.import_module(f".{name}", __name__)
        try:
            sections[name] = module.run(inspection)
        except FastGSError as error:  # what a check needs is not installed, or not there: the others go on
            sections[name] = Section(name.capitalize(), "This could not be looked at.")
            sections[name].add("note", f"{name.capitalize()} could not be checked: {error}", "The other checks were made.")
    report("done", 1.0)
    return CheckReport(str(path), capture.layout, inspection.words(), inspection.views, capture.held_out_views,
                       inspection.thumbnails, sections)
