# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs work in another thread, so that the caller can cancel it at once, whatever it is doing."""
from __future__ import annotations

import threading
from concurrent.futures import CancelledError, ThreadPoolExecutor, wait


def _started() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix="fastgs-render")


_thread = _started()
"""The same for one frame after the other: what a frame needs for a while stays with the part of the heap (the arena) that its thread was
given, and a new thread may be given another one, so that an animation would hold several frames' memory."""


def run(work, stopped, report, interval: float = 0.1):
    """Run work(progress) in another thread, which the calling thread watches and can cancel.

    work      gets a function progress(fraction), which raises CancelledError after a stop; it must not touch Blender's data
    stopped   asked every `interval` seconds; True ends the call with CancelledError, even while work reads a file or
              compiles; work then ends by itself at its next progress()
    report    called with the last fraction when it has changed
    Returns what work returns and raises what it raises.
    """
    global _thread
    latest, told = 0.0, None
    cancel = threading.Event()

    def progress(fraction):
        nonlocal latest
        if cancel.is_set():
            raise CancelledError
        latest = fraction

    future = _thread.submit(work, progress)
    try:
        while not wait([future], interval).done:
            if stopped():
                raise CancelledError
            if latest != told:
                told = latest
                report(told)
    except BaseException:
        cancel.set()
        _thread.shutdown(wait=False)  # the next frame does not wait until this one's work has noticed
        _thread = _started()
        raise
    return future.result()
