# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a check: one HTML file with its pictures inside, and check.json beside it."""
import base64
import io
import json
from html import escape
from pathlib import Path

import numpy as np

from ..util.errors import FastGSError, printable
from ..util.outputs import replacing
from .report import SEVERITIES, CheckReport, Finding, Picture

PAGE, VALUES = "check.html", "check.json"
QUALITY = 82
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #2b2b2b; background: #fafafa; margin: 0 }
main { max-width: 1040px; margin: 0 auto; padding: 24px }
h1 { font-size: 26px; margin: 0 } h2 { font-size: 19px; margin: 40px 0 4px; border-bottom: 1px solid #ddd; padding-bottom: 4px }
p { margin: 6px 0 } .soft { color: #777 } .verdict { font-size: 18px; margin: 14px 0 22px }
.finding { background: #fff; border: 1px solid #e3e3e3; border-left: 5px solid #999; border-radius: 4px; padding: 10px 14px;
margin: 10px 0 }
.wrong { border-left-color: #c0392b } .poor { border-left-color: #d98e04 } .note { border-left-color: #8a97a3 }
.grade { font-size: 12px; text-transform: uppercase; letter-spacing: .06em; color: #777 }
.advice { color: #555 } .advice::before { content: "What to do: "; color: #888 }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(230px, 1fr)); gap: 14px; margin: 14px 0 }
figure { margin: 0; background: #fff; border: 1px solid #e3e3e3; border-radius: 4px; padding: 8px }
figure.wide { grid-column: 1 / -1 }
img, svg { max-width: 100%; height: auto; display: block; margin: auto }
figcaption { font-size: 13px; color: #666; margin-top: 6px }
table { border-collapse: collapse; background: #fff; width: 100%; font-size: 14px }
td, th { border: 1px solid #e3e3e3; padding: 6px 10px; text-align: left; vertical-align: middle }
th { background: #f3f3f3; font-weight: 600 } td img { max-width: 110px; max-height: 90px; margin: 0 }
td.wrong { background: #f8dcd8 } td.poor { background: #fbecc9 } .scroll { overflow-x: auto }
"""


def write(report: CheckReport, out: Path) -> list[Path]:
    """Write the page and its values into a folder, aside and renamed; returns their paths.  Raises FastGSError."""
    out = Path(out)
    paths = [out / PAGE, out / VALUES]
    try:
        out.mkdir(parents=True, exist_ok=True)
        with replacing(paths) as (page, values):
            page.write_text(html(report), encoding="utf-8")
            values.write_text(json.dumps(report.values(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise FastGSError(f"{out}: the page cannot be written there ({error.strerror or error}); choose another folder with "
                          "--out.") from error
    return paths


def html(report: CheckReport) -> str:
    """The whole page."""
    name = escape(printable(Path(report.capture).name or report.capture))
    about = f"{escape(printable(report.capture))}<br>{escape(report.layout)}, {len(report.views)} cameras"
    body = [f"<h1>{name}</h1>", f'<p class="soft">{about}</p>',
            f'<p class="verdict">{escape(report.verdict)}</p>', *(_finding(finding) for _, finding in report.findings),
            "<h2>Cameras</h2>", _table(report)]
    for section in report.sections.values():
        body.append(f"<h2>{escape(section.title)}</h2><p>{escape(section.summary)}</p>")
        if not section.findings:
            body.append('<p class="soft">Nothing to remark.</p>' if section.measures else "")
        body += [f"<p><b>{escape(finding.severity)}:</b> {escape(finding.sentence)}</p>" for finding in section.findings]
        if section.pictures:
            body.append('<div class="grid">' + "".join(map(_figure, section.pictures)) + "</div>")
    body.append(f'<p class="soft">{escape(report.looked)}</p>')
    return ('<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, '
            'initial-scale=1">'
            f"<title>Check of {name}</title><style>{STYLE}</style></head><body><main>\n" + "\n".join(body) + "\n</main></body></html>\n")


def _finding(finding: Finding) -> str:
    return (f'<div class="finding {finding.severity}"><div class="grade">{escape(SEVERITIES[finding.severity])}</div>'
            f'<p>{escape(finding.sentence)}</p><p class="advice">{escape(finding.advice)}</p></div>')


def _table(report: CheckReport) -> str:
    """A row for each camera: its picture, and each section's columns, coloured where a finding is about it."""
    columns = [(name, title, values) for name, section in report.sections.items() for title, values in section.columns.items()]
    head = "".join(f"<th>{escape(title)}</th>" for _, title, _ in columns)
    rows = []
    for view in report.views:
        cells = []
        for name, _, values in columns:
            told = (finding for finding in report.sections[name].findings if view in finding.views)
            grades = [finding.severity for finding in told if finding.severity != "note"]
            worst = min(grades, key=list(SEVERITIES).index, default="")
            cells.append(f'<td class="{worst}">{escape(values.get(view, ""))}</td>')
        role = '<br><span class="soft">held out</span>' if view in report.held_out else ""
        rows.append(f"<tr><td>{_image(report.thumbnails[view], view)}</td><td>{escape(view)}{role}</td>{''.join(cells)}</tr>")
    return f'<div class="scroll"><table><tr><th></th><th>Camera</th>{head}</tr>{"".join(rows)}</table></div>'


def _figure(picture: Picture) -> str:
    inside = picture.svg if picture.pixels is None else _image(picture.pixels, picture.caption)
    wide = ' class="wide"' if picture.wide else ""
    return f"<figure{wide}>{inside}<figcaption>{escape(picture.caption)}</figcaption></figure>"


def _image(pixels: np.ndarray, words: str) -> str:
    """Pixels [h, w, 3] uint8 as an image inside the page."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, "JPEG", quality=QUALITY)
    return f'<img alt="{escape(words)}" src="data:image/jpeg;base64,{base64.b64encode(stream.getvalue()).decode("ascii")}">'
