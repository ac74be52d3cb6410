# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs work in a thread of its own, so that the caller can cancel it at once, whatever it is doing."""
from __future__ import annotations

import threading
from concurrent.futures import CancelledError, ThreadPoolExecutor, wait


def run(work, stopped, report, interval: float = 0.1):
    """Run work(progress) in a thread of its own, which the calling thread watches and can cancel.

    work      gets a function progress(fraction), which raises CancelledError after a stop; it must not touch Blender's data
    stopped   asked every `interval` seconds; True ends the call with CancelledError, even while work reads a file or
              compiles; work then ends by itself at its next progress()
    report    called with the last fraction when it has changed
    Returns what work returns and raises what it raises.
    """
    latest, told = 0.0, None
    cancel = threading.Event()

    def progress(fraction):
        nonlocal latest
        if cancel.is_set():
            raise CancelledError
        latest = fraction

    executor = ThreadPoolExecutor(1, thread_name_prefix="fastgs-render")
    try:
        future = executor.submit(work, progress)
        while not wait([future], interval).done:
            if stopped():
                cancel.set()
                raise CancelledError
            if latest != told:
                told = latest
                report(told)
        return future.result()
    finally:
        executor.shutdown(wait=False)
