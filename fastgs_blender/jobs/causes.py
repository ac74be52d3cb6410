# SPDX-License-Identifier: GPL-3.0-or-later
"""Says in one sentence why a process that was started for training, or for something else, ended, and what to do about it."""
import signal

PREFIX = "fastgs: "
FAILED = 2
"""Exit status of a fastgs that said in its last line why it failed; of other ends that line is a remark on something else."""
CRASHED = 0xC0000000
"""Windows gives processes that crash an exit status from here on."""
MEMORY = ("MemoryError", "can't allocate memory", "out of memory", "Unable to allocate", "bad_alloc", "not enough memory")
DISK = ("No space left on device", "the disk is full", "Disk quota exceeded", "not enough space on the disk")
MODULE = "No module named "
TRAINING = "training"


def sentence(reason: str | None, printed: str, code: int | None, out: str, what: str = TRAINING) -> str:
    """One sentence for the user: why the process ended, and what to do.

    reason   what status.json says of a run that failed
    printed  the end of what the process printed
    code     its exit status, None: unknown; negative: the signal that ended it
    out      the folder that it wrote to, or read
    what     it was doing, as a noun: "training", "the check"
    """
    subject = what[:1].upper() + what[1:]
    again = "resuming continues from the last checkpoint" if what == TRAINING else "then try again"
    fewer = ", or train fewer Gaussians or smaller pictures" if what == TRAINING else ""
    lines = [line.strip() for line in printed.splitlines() if line.strip()]
    if reason is None and code is not None and (code < 0 or code >= CRASHED):
        return _ended(subject, code, fewer, again, out)
    explained = lines and lines[-1].startswith(PREFIX) and code in (None, FAILED)
    known = reason or (lines[-1].removeprefix(PREFIX) if explained else "")
    everything = reason or printed
    if any(word in everything for word in MEMORY):
        return f"{subject} ran out of memory: close other programs{fewer}; {again}."
    if any(word in everything for word in DISK):
        repeat, because = "resume" if what == TRAINING else "try again", f" ({known.rstrip('.')})" if known else ""
        return f"{subject} ended because the disk is full: free some space for {out}, then {repeat}{because}."
    if known:
        return known[:1].upper() + known[1:].rstrip(".") + "."
    if lines and MODULE in lines[-1]:
        name = lines[-1].rpartition(MODULE)[2].strip(" '")
        return f"The training Python lacks {name}; test it in the preferences."
    ended = f" with code {code}" if code else ""
    last = f": {lines[-1][:200].rstrip('.')}" if lines else ""
    log = f"; {again}, and {out} has its log" if what == TRAINING else f"; test the training Python in the preferences, {again}"
    return f"{subject} ended unexpectedly{ended}{last}{log}."


def _ended(subject: str, code: int, fewer: str, again: str, out: str) -> str:
    """Of a process that a signal or a crash ended: it said nothing about that itself."""
    if code == -getattr(signal, "SIGKILL", 0):
        return f"{subject} was ended by the system, probably because memory ran out: close other programs{fewer}; {again}."
    try:
        name = signal.Signals(-code).name if code < 0 else f"{code:#x}"
    except ValueError:
        name = f"signal {-code}"
    if code == -signal.SIGTERM:
        return f"{subject} was ended by another program or the system ({name}); {again}."
    return f"{subject} crashed ({name}) at {out}; {again}, and report it if it happens again."
