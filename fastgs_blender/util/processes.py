# SPDX-License-Identifier: GPL-3.0-or-later
"""Other processes: how they are begun without a window, and ended."""
import subprocess
import sys


def end(process: subprocess.Popen, patience: float = 2.0) -> None:
    """End a process: it may clear up for so many seconds, and is then killed."""
    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def hidden() -> dict:
    """Arguments for Popen with which a process opens no window of its own."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW}
    return {}
