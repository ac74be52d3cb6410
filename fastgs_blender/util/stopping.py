# SPDX-License-Identifier: GPL-3.0-or-later
"""Stops the command line as Ctrl-C does, from its first moment on.

SIGTERM, which render farms and `kill` send, is Ctrl-C too, and so is SIGHUP: a terminal was closed.  Where `nohup` has SIGHUP ignored, it
stays ignored.
"""
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

STOPPED = 130
"""Exit code of what was stopped."""
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
PACKAGE = __name__.partition(".")[0]


def end(number: int, frame: FrameType | None) -> None:
    """End this process, which has begun nothing yet, in one sentence."""
    os.write(2, b"fastgs: stopped.\n")
    os._exit(STOPPED)


def _while_importing() -> None:
    """Let signals end() this process if it is the command line: importing all modules takes a second or two.  Others are left alone."""
    options = sys.orig_argv
    module = options[options.index("-m") + 1:][:1] if "-m" in options else []
    if threading.current_thread() is threading.main_thread() and (module == [PACKAGE] or Path(sys.argv[0] or ".").stem == "fastgs"):
        for number in SIGNALS:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                signal.signal(number, end)


@contextmanager
def as_interrupts() -> Iterator[None]:
    """Signals raise KeyboardInterrupt in the block, unless somebody else handles or ignores them."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in SIGNALS}
    changed = {number: old for number, old in before.items() if old in (signal.SIG_DFL, end)}
    for number in changed:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, old in changed.items():
            signal.signal(number, old)


_while_importing()
