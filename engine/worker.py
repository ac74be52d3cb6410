# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that can be cancelled at once, whatever it is doing."""
from __future__ import annotations

import threading


class Cancelled(Exception):
    """The user stopped the render."""


def run(work, stopped, report, interval: float = 0.1):
    """work(progress) in a thread of its own, watched from this one.

    work      gets a function progress(fraction), which raises Cancelled after a stop; it must not touch Blender's data
    stopped   asked every `interval` seconds; True ends the call with Cancelled, even while work reads a file or compiles;
              work then ends by itself at its next progress()
    report    called with the last fraction when it has changed
    Returns what work returns and raises what it raises.
    """
    state = {"fraction": 0.0}
    cancel = threading.Event()

    def progress(fraction):
        if cancel.is_set():
            raise Cancelled
        state["fraction"] = fraction

    def body():
        try:
            state["result"] = work(progress)
        except BaseException as error:
            state["error"] = error

    thread = threading.Thread(target=body, name="fastgs-render")
    thread.start()
    told = None
    while thread.is_alive():
        thread.join(interval)
        if stopped():
            cancel.set()
            raise Cancelled
        if state["fraction"] != told:
            told = state["fraction"]
            report(told)
    if "error" in state:
        raise state["error"]
    return state["result"]
