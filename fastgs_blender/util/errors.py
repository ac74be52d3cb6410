# SPDX-License-Identifier: GPL-3.0-or-later
"""FastGSError, the one error that users see; LossWarning, the one warning; printable(), which both go through."""


def printable(text: object) -> str:
    """The text with control characters and lone surrogates written as escapes: safe for a terminal, a log and Blender's reports.

    Names of files and fields come from outside; an escape sequence in one must not reach the terminal, and UTF-8 has no surrogates.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode("ascii") for c in str(text))


class FastGSError(Exception):
    """Bad input.  The message is one sentence: which file, what is wrong, what to do.  It is printable().

    Example:
        try:
            fg.load("missing.ply")
        except fg.FastGSError as error:
            print(error)
    """

    def __init__(self, message: object = ""):
        super().__init__(printable(message))


class LossWarning(UserWarning):
    """Something is lost: a format that cannot hold all of a model, or unusable Gaussians in a file; the message says what.

    Example:
        with warnings.catch_warnings():
            warnings.simplefilter("error", fg.LossWarning)  # a lossy save now raises
    """

    def __init__(self, message: object = ""):
        super().__init__(printable(message))
