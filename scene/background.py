# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work in steps, and work that needs no Blender in a thread of its own, while Blender is asked for the next step."""
import threading
from contextlib import closing

WAIT = 0.1
"""Seconds between two looks at the thread that works."""
NAME = "FAST-GS work"
"""Of the thread."""


def in_background(work, cancel: bool = True):
    """Yields the share 0..1 that is done while work(progress) runs, and returns its result; what it raises passes through.

    Closing the generator cancels the work, at its next call of progress(share), and waits for it; without `cancel` the work is left to
    end by itself.
    """
    state = {"done": 0.0}
    cancelled = threading.Event()

    def progress(share):
        state["done"] = share
        if cancelled.is_set():
            raise InterruptedError

    def target():
        try:
            state["result"] = work(progress)
        except BaseException as error:  # noqa: BLE001 (handed over: the generator raises it)
            state["error"] = error

    thread = threading.Thread(target=target, name=NAME, daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(WAIT)
            yield state["done"]
    finally:
        cancelled.set()
        if cancel:
            thread.join()
    if "error" in state:
        raise state["error"]
    return state["result"]


def in_steps(work, apart: bool):
    """in_background() if the work is to be done `apart` from Blender, else at once: yields the share that is done, returns the result."""
    yield 0.0  # so that work is told that ends before it is looked at
    return (yield from in_background(work)) if apart else work(None)


def relayed(steps, shown):
    """Yields shown(step) for each step of a generator, which is closed with this one, and returns what that returns."""
    with closing(steps):
        while True:
            try:
                step = next(steps)
            except StopIteration as end:
                return end.value
            yield shown(step)
