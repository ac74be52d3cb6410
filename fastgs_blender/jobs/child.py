# SPDX-License-Identifier: GPL-3.0-or-later
"""The program of a training job's process: `fastgs` from the extension's folder, in the training Python and without Blender.

    python child.py EXTENSION LOCK STOP train CAPTURE --out DIR ...

It holds the file LOCK as long as it lives (util/locks.py), and treats a file STOP that appears as Ctrl-C: that works on every system,
and for a Blender that did not start it.  With two empty names it only runs the command.
"""
import os
import signal
import sys
from typing import Any, BinaryIO, NoReturn


def stop(number: int, frame: object) -> NoReturn:
    """End this process, which has begun nothing yet, as Ctrl-C ends fastgs."""
    os.write(2, b"fastgs: stopped.\n")
    os._exit(130)


if __name__ == "__main__":  # before anything that takes time
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, stop)

import _thread  # noqa: E402
import contextlib  # noqa: E402
import faulthandler  # noqa: E402
import importlib.util  # noqa: E402
import threading  # noqa: E402
import time  # noqa: E402

TAKEN = 3
"""Exit status where another process holds the lock."""
LOOK_EVERY = 0.25
"""Seconds between two looks for the file STOP."""
PATIENCE = 30.0
"""Seconds in which the starting Blender lets go of the lock, on Windows; only a guard."""


def load_library(extension: str) -> None:
    """Make the extension's library importable as fastgs_blender, and nothing else of it."""
    folder = os.path.join(extension, "fastgs_blender")
    spec = importlib.util.spec_from_file_location(
        "fastgs_blender", os.path.join(folder, "__init__.py"), submodule_search_locations=[folder])
    assert spec is not None and spec.loader is not None
    module = sys.modules["fastgs_blender"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)


def prefer_to_be_killed() -> None:
    """Make Linux end this process rather than Blender when memory runs out."""
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("800")


def watch(file: str) -> None:
    """Interrupt the main thread as Ctrl-C does, once for each time that the file appears."""
    while True:
        if os.path.exists(file):
            _thread.interrupt_main()
            while os.path.exists(file):
                with contextlib.suppress(OSError):
                    os.remove(file)
                time.sleep(0.01)
        time.sleep(LOOK_EVERY)


def acquire(locks: Any, path: str) -> BinaryIO | None:
    """The lock, kept open as long as the caller keeps it; None where another process holds it."""
    try:
        return locks.inherited() or locks.acquire(path, PATIENCE)
    except locks.NoLocks:
        return open(path, "ab")  # this file system has none


def main() -> int:
    extension, lock, stopping, *arguments = sys.argv[1:]
    sys.path.pop(0)  # this folder's modules are not for others to find
    load_library(extension)
    faulthandler.enable()
    if lock:
        taken = acquire(importlib.import_module("fastgs_blender.util.locks"), lock)
        if taken is None:
            return TAKEN
        prefer_to_be_killed()
        threading.Thread(target=watch, args=(stopping,), daemon=True).start()
    try:
        run = importlib.import_module("fastgs_blender.cli").main
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, signal.default_int_handler)
        return run(arguments)
    except KeyboardInterrupt:  # before the run began to listen
        return 130


if __name__ == "__main__":
    sys.exit(main())
