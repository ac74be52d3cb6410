# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error that users see, and the one warning."""


class FastGSError(Exception):
    """Bad input.  The message is one sentence: which file, what is wrong, what to do."""


class LossWarning(UserWarning):
    """Something is lost: a format that cannot hold all of a model, or unusable Gaussians in a file; the message says what."""
