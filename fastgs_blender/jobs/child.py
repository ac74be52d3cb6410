# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training job's process runs, in the training Python and without Blender: `fastgs` from the extension's folder.

    python child.py EXTENSION LOCK STOP train CAPTURE --out DIR ...

It holds the file LOCK as long as it lives, and takes a file STOP for Ctrl-C: that works on every system, and for a Blender
that did not start it.  With two empty names it just runs the command.
"""
import _thread
import contextlib
import faulthandler
import importlib.util
import os
import sys
import threading
import time

TAKEN = 3
LOOK_EVERY = 0.25


def load_library(extension):
    """Make the extension's library importable as fastgs_blender, and nothing else of it."""
    folder = os.path.join(extension, "fastgs_blender")
    spec = importlib.util.spec_from_file_location(
        "fastgs_blender", os.path.join(folder, "__init__.py"), submodule_search_locations=[folder])
    module = sys.modules["fastgs_blender"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)


def go_first():
    """Be the one that goes, rather than Blender, when the system runs out of memory."""
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("800")


def watch(stop):
    """Ctrl-C, once for each time that the file appears."""
    while True:
        if os.path.exists(stop):
            with contextlib.suppress(OSError):
                os.remove(stop)
            _thread.interrupt_main()
        time.sleep(LOOK_EVERY)


def main():
    extension, lock, stop, *arguments = sys.argv[1:]
    sys.path.pop(0)  # this folder's modules are not for others to find
    load_library(extension)
    faulthandler.enable()
    if lock:
        held = importlib.import_module("fastgs_blender.util.locks").hold(lock, patience=2.0)
        if held is None:
            return TAKEN
        go_first()
        threading.Thread(target=watch, args=(stop,), daemon=True).start()
    try:
        return importlib.import_module("fastgs_blender.cli").main(arguments)
    except KeyboardInterrupt:  # before the run began to listen
        return 130


if __name__ == "__main__":
    sys.exit(main())
