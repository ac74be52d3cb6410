# SPDX-License-Identifier: GPL-3.0-or-later
"""FastGSError, the one error that users see; LossWarning, the one warning; printable(), which both go through."""
from collections.abc import Iterator
from contextlib import contextmanager

_shown: dict[str, str] = {}
"""What messages say instead of a text."""


@contextmanager
def shown_as(text: str, name: str) -> Iterator[None]:
    """Messages of every thread say `name` for `text`, such as a temporary folder that only this program knows."""
    _shown[text] = name
    try:
        yield
    finally:
        del _shown[text]


def printable(text: object) -> str:
    """The text as one line: line ends, other control characters and lone surrogates are written as escapes.

    It is safe for a terminal, a log and Blender's reports.  Names of files and fields come from outside: an escape sequence must not
    reach the terminal, a line end must not begin a sentence of its own, and UTF-8 has no surrogates.
    """
    text = str(text)
    for hidden, name in tuple(_shown.items()):
        text = text.replace(hidden, name)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def printable_lines(text: str) -> str:
    """A text of several lines, such as a log, each printable(); tabs become spaces."""
    return "\n".join(printable(line.expandtabs(4)) for line in text.split("\n"))


class FastGSError(Exception):
    """Bad input.  The message is one sentence: which file, what is wrong, what to do.  It is printable().

    Example:
        try:
            fg.load("missing.ply")
        except fg.FastGSError as error:
            print(error)
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(message))


class LossWarning(UserWarning):
    """Something is lost: a format that cannot hold all of a model, or unusable Gaussians in a file; the message says what.

    Example:
        with warnings.catch_warnings():
            warnings.simplefilter("error", fg.LossWarning)  # a lossy save now raises
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(message))
