# SPDX-License-Identifier: GPL-3.0-or-later
"""CheckReport, the result of checking a capture: the findings, worst first, and a section of measures and pictures for each check."""
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..util.errors import printable
from ..util.screen import COLUMNS

SEVERITIES = {"wrong": "put this right before training", "poor": "the model will be poorer for it", "note": "good to know"}
"""Grades of findings, the worst first, and what they mean."""


@dataclass(frozen=True)
class Finding:
    """One thing that a user should know.

    severity  of SEVERITIES
    sentence  what is so, with its figure
    advice    what to do about it
    views     the cameras that it is about, none: the capture as a whole
    figure    its number: a name, the value, the unit
    """

    severity: str
    sentence: str
    advice: str
    views: tuple[str, ...] = ()
    figure: tuple[str, float, str] | None = None


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a section: SVG, or pixels [h, w, 3] uint8, with a caption."""

    caption: str
    svg: str = ""
    pixels: np.ndarray | None = None
    wide: bool = False


@dataclass(eq=False)
class Section:
    """What one check found.

    summary   a sentence on what was measured, and how
    columns   by title: a text for each camera, for the page's table
    measures  JSON values
    """

    title: str
    summary: str
    findings: list[Finding] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    columns: dict[str, dict[str, str]] = field(default_factory=dict)
    measures: dict[str, Any] = field(default_factory=dict)

    def add(self, severity: str, sentence: str, advice: str, views: Iterable[str] = (),
            figure: tuple[str, float, str] | None = None) -> None:
        """Add a finding."""
        self.findings.append(Finding(severity, printable(sentence), printable(advice), tuple(views), figure))


@dataclass(eq=False)
class CheckReport:
    """The check of a capture, as check() gives it.

    capture, layout  its folder or file, and its layout's name
    looked           what was looked at, in words
    views, held_out  names of all cameras, and of those that are not trained on
    thumbnails       small pictures [h, w, 3] uint8 of the cameras, by name
    sections         by the check's name: its summary, findings, measures and pictures

    Example:
        report = fg.check("my-capture")
        for name, finding in report.findings:
            print(name, finding.severity, finding.sentence, finding.advice)
    """

    capture: str
    layout: str
    looked: str
    views: list[str]
    held_out: list[str]
    thumbnails: dict[str, np.ndarray]
    sections: dict[str, Section]

    @property
    def findings(self) -> list[tuple[str, Finding]]:
        """(name of its section, finding), the worst first."""
        order = list(SEVERITIES)
        rows = [(name, finding) for name, section in self.sections.items() for finding in section.findings]
        return sorted(rows, key=lambda row: order.index(row[1].severity))

    @property
    def verdict(self) -> str:
        """One sentence on the whole."""
        counts = {grade: sum(finding.severity == grade for _, finding in self.findings) for grade in SEVERITIES}
        if counts["wrong"]:
            return f"{_things(counts['wrong']).capitalize()} should be put right before training" + (
                f", and {_things(counts['poor'])} will make the model poorer." if counts["poor"] else ".")
        if counts["poor"]:
            return f"It can be trained on; {_things(counts['poor'])} will make the model poorer."
        return "It can be trained on; nothing was found that would spoil the model."

    @property
    def bad(self) -> bool:
        """Whether something should be put right before training."""
        return any(finding.severity == "wrong" for _, finding in self.findings)

    def values(self) -> dict[str, Any]:
        """All of it as JSON values, pictures apart."""
        return {"capture": self.capture, "layout": self.layout, "looked_at": self.looked, "views": self.views, "held_out": self.held_out,
                "verdict": self.verdict,
                "findings": [{"check": name, "severity": f.severity, "sentence": f.sentence, "advice": f.advice, "views": list(f.views),
                              "figure": None if f.figure is None else dict(zip(("name", "value", "unit"), f.figure))}
                             for name, f in self.findings],
                "measures": {name: section.measures for name, section in self.sections.items()}}

    def text(self) -> str:
        """All findings for a terminal or a text of Blender's, worst first; then what was looked at, and what training will need."""
        lines = [printable(self.capture), *_wrapped(self.verdict), ""]
        for _, finding in self.findings:
            lines += [*_wrapped(finding.sentence, f"{finding.severity:<6}"), *_wrapped(finding.advice, " " * 6), ""]
        cost = [self.sections["cost"].summary] if "cost" in self.sections else []
        return "\n".join([*lines, *_wrapped(self.looked), *(line for text in cost for line in ["", *_wrapped(text)])])


def _things(count: int) -> str:
    return "one thing" if count == 1 else f"{count} things"


def _wrapped(text: str, head: str = "") -> list[str]:
    indent = " " * (len(head) + 1) if head else ""
    return textwrap.wrap(printable(text), COLUMNS, initial_indent=f"{head} "
                                                                  "" if head else "", subsequent_indent=indent, break_long_words=False,
                         break_on_hyphens=False) or [""]


def rounded(value: float) -> float | None:
    """A measure as a JSON value; None where it could not be measured."""
    return round(float(value), 4) if np.isfinite(value) else None


def listed(names: Iterable[str], most: int = 4) -> str:
    """cam00, cam01 and cam02; of many, the first and how many more."""
    names = [printable(name) for name in names]
    if len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1] if names else ""]))
