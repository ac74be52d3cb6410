# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error that users see, and the one warning."""


class FastGSError(Exception):
    """Bad input.  The message is one sentence: which file, what is wrong, what to do."""


class LossWarning(UserWarning):
    """A file was written in a format that cannot hold everything the model has; the message says what is lost."""
