# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a training process ended, in one sentence that says what to do."""
from __future__ import annotations

import signal

PREFIX = "fastgs: "
MEMORY = ("MemoryError", "can't allocate memory", "out of memory", "Unable to allocate", "bad_alloc", "not enough memory")
DISK = ("No space left on device", "the disk is full", "Disk quota exceeded", "not enough space on the disk")
MODULE = "No module named "


def sentence(reason: str | None, said: str, code: int | None, out: str) -> str:
    """One sentence.

    reason  what status.json says of a run that failed; said: the end of what the process printed; code: how it ended, None: unknown
    out     the run's folder
    """
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    told = reason or next((line.removeprefix(PREFIX) for line in reversed(lines[-3:]) if line.startswith(PREFIX)), "")
    everything = f"{reason or ''}\n{said}"
    if any(word in everything for word in MEMORY) or code in _killed():
        return ("Training ran out of memory, or the system ended it: close other programs, or train fewer Gaussians or smaller pictures; "
                "resuming goes on from the last checkpoint.")
    if any(word in everything for word in DISK):
        return f"Training ended because the disk is full: free some space for {out}, then resume{_because(told)}."
    if told:
        return told[:1].upper() + told[1:].rstrip(".") + "."
    if lines and MODULE in lines[-1]:
        name = lines[-1].rpartition(MODULE)[2].strip(" '")
        return f"The training Python lacks {name}; test it in the preferences."
    ended = f" with code {code}" if code else ""
    last = f": {lines[-1][:200].rstrip('.')}" if lines else ""
    return f"Training ended unexpectedly{ended}{last}; resuming goes on from the last checkpoint, and {out} has its log."


def _killed() -> tuple[int, ...]:
    return (-signal.SIGKILL,) if hasattr(signal, "SIGKILL") else ()


def _because(told: str) -> str:
    return f" ({told.rstrip('.')})" if told else ""
