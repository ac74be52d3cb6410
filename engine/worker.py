# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs work in a thread of its own, so that the caller can cancel it at once, whatever it is doing."""
from concurrent.futures import CancelledError
from contextlib import closing

from ..scene.background import in_background


def run(work, stopped, report):
    """Run work(progress) in a thread of its own, which the calling thread watches and can cancel.

    work      gets a function progress(fraction), which raises InterruptedError after a stop; it must not touch Blender's data
    stopped   asked again and again; True ends the call with CancelledError, even while work reads a file or compiles; work then ends
              by itself at its next progress()
    report    called with the last fraction when it has changed
    Returns what work returns and raises what it raises.
    """
    told = None
    with closing(in_background(work, cancel=False)) as steps:
        while True:
            try:
                fraction = next(steps)
            except StopIteration as end:
                return end.value
            if stopped():
                raise CancelledError
            if fraction != told:
                told = fraction
                report(told)
