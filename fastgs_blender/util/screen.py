# SPDX-License-Identifier: GPL-3.0-or-later
"""Prints names and values as a table that fits on one screen of a terminal."""
import contextlib
import os
import textwrap
from collections.abc import Sequence
from typing import TextIO

from .errors import printable

COLUMNS, LINES = 80, 24
"""A terminal's size, the line of the prompt included."""
MOST = 3
"""Lines of one value."""


def screen(rows: Sequence[tuple[str, object]], everything: bool = False, hidden: int = 0) -> str:
    """Names on the left, values on the right, wrapped to COLUMNS; words that are longer, such as paths, stay whole.

    everything  all lines of all values; else what fits on a screen, and a last line that says how much is left out
    hidden      rows that the caller has left out already
    """
    texts = [(printable(name), str(value)) for name, value in rows]
    width = max((len(name) for name, _ in texts), default=0)
    lines: list[str] = []
    left_out = hidden
    for name, value in texts:
        wrapped = textwrap.wrap(printable(value), max(COLUMNS - width - 2, 20), break_long_words=False, break_on_hyphens=False) or [""]
        if not everything:
            left_out += len(wrapped[MOST:])
            wrapped = wrapped[:MOST]
        lines += [f"{head:<{width}}  {text}".rstrip() for head, text in zip([name, *[""] * len(wrapped)], wrapped, strict=False)]
    if not everything and (left_out or len(lines) > LINES - 1):
        left_out += len(lines[LINES - 2:])
        lines = [*lines[:LINES - 2], f"{'more':<{width}}  {left_out} lines; --all shows them"]
    return "\n".join(lines)


def tell(text: str, stream: TextIO) -> None:
    """Print one printable() line on a terminal, cut between words where it is wider; a file or a log gets it whole.

    Letters that the stream's encoding lacks, as cp1252 on Windows does, are written as escapes.  $COLUMNS says how wide, else the
    terminal; words that are longer, such as paths, stay whole.
    """
    line, width = printable(text), _width(stream)
    if 0 < width < len(line):
        line = textwrap.fill(line, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
    encoding = getattr(stream, "encoding", None) or "utf-8"
    print(line.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)


def _width(stream: TextIO) -> int:
    """Columns of what a stream is shown on; 0 where nobody says."""
    if os.environ.get("COLUMNS", "").isdecimal():
        return int(os.environ["COLUMNS"])
    with contextlib.suppress(OSError, ValueError, AttributeError):
        return os.get_terminal_size(stream.fileno()).columns
    return 0
