# SPDX-License-Identifier: GPL-3.0-or-later
"""Says in one sentence why a training process ended, and what to do about it."""
from __future__ import annotations

import signal

PREFIX = "fastgs: "
MEMORY = ("MemoryError", "can't allocate memory", "out of memory", "Unable to allocate", "bad_alloc", "not enough memory")
DISK = ("No space left on device", "the disk is full", "Disk quota exceeded", "not enough space on the disk")
MODULE = "No module named "


def sentence(reason: str | None, printed: str, code: int | None, out: str) -> str:
    """One sentence for the user: why the process ended, and what to do.

    reason   what status.json says of a run that failed
    printed  the end of what the process printed
    code     its exit status, None: unknown
    out      the run's folder
    """
    lines = [line.strip() for line in printed.splitlines() if line.strip()]
    known = reason or next((line.removeprefix(PREFIX) for line in reversed(lines[-3:]) if line.startswith(PREFIX)), "")
    everything = f"{reason or ''}\n{printed}"
    if any(word in everything for word in MEMORY) or code in _killed():
        return ("Training ran out of memory, or the system ended it: close other programs, or train fewer Gaussians or smaller pictures; "
                "resuming continues from the last checkpoint.")
    if any(word in everything for word in DISK):
        return f"Training ended because the disk is full: free some space for {out}, then resume{_because(known)}."
    if known:
        return known[:1].upper() + known[1:].rstrip(".") + "."
    if lines and MODULE in lines[-1]:
        name = lines[-1].rpartition(MODULE)[2].strip(" '")
        return f"The training Python lacks {name}; test it in the preferences."
    ended = f" with code {code}" if code else ""
    last = f": {lines[-1][:200].rstrip('.')}" if lines else ""
    return f"Training ended unexpectedly{ended}{last}; resuming continues from the last checkpoint, and {out} has its log."


def _killed() -> tuple[int, ...]:
    return (-signal.SIGKILL,) if hasattr(signal, "SIGKILL") else ()


def _because(known: str) -> str:
    return f" ({known.rstrip('.')})" if known else ""
