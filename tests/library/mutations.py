# SPDX-License-Identifier: GPL-3.0-or-later
"""Campaigns of mutated files: each reader must answer any damage with a correct result or one FastGSError, within bounds.

    def read(folder):                       # in a child process, once a mutation; asserts what must hold of a result
        load_cameras(folder / "cameras.json")

    def test_damaged_cameras(tmp_path):
        mutations.campaign("cameras.json", read, {"two cameras": {"cameras.json": b"..."}}, tmp_path)

A seed is a folder: {relative path: content}; one file of it is changed at a time.  Mutation number n of a seed is always the same, so
a failure is replayed with what its message says: FASTGS_MUTATION="reader/seed/n" runs that one alone, in the test's own process.
FASTGS_MUTATIONS=10000 sets the number a reader (300 unless told).
"""
from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import random
import select
import signal
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pytest
from damage import mutated

import fastgs_blender as fg
from fastgs_blender.model.sequence import ahead
from fastgs_blender.util.errors import FastGSError, LossWarning, printable

COUNT = 300
MEMORY = 1 << 30
"""Bytes of address space a reader may take beyond what the process had; the seeds are small."""
CPU = 60
"""Seconds of the processor's time for one file: a guard against endless work, far above what any machine needs."""
CPU_OF_ATTACKS = 10
BATCH = 2500
"""Mutations that one child reads: what a library keeps of every damaged file (OpenUSD some 100 KB) does not add up to MEMORY."""
UNCHANGED = -1
"""The number of the mutation that changes nothing."""
SILENCE = 300
"""Seconds of the clock for one file, for readers that wait instead of working."""
MOST = 12
"""Failures after which a campaign ends."""

Seed = Mapping[str, bytes]


def campaign(name: str, read: Callable[[Path], object], seeds: Mapping[str, Seed], folder: Path, *, fixed: Iterable[str] = (),
             memory: int = MEMORY) -> dict[str, int]:
    """Call read(folder) with mutated files; raises AssertionError with all failures, else returns how many were accepted and refused.

    name    of the reader, in messages and in the random numbers
    seeds   {name: {relative path: content}}, valid: read() must accept each as it is
    fixed   relative paths that are never changed
    memory  bytes that read() may take
    """
    cases = _cases(seeds, fixed)
    wanted = os.environ.get("FASTGS_MUTATION")
    for seed, files in seeds.items():
        _write(folder / seed, files)
        if not wanted:
            with _strict():
                read(folder / seed)  # also compiles and imports, once for all children
    if wanted:
        reader, seed, number = wanted.rsplit("/", 2)
        if reader != name:
            pytest.skip(f"{wanted} is of another reader")
        _one(name, read, seeds, folder, seed, int(number), fixed)
        return {}
    count = int(os.environ.get("FASTGS_MUTATIONS", COUNT))
    work = [(cases[i % len(cases)], i // len(cases)) for i in range(count)]
    told = {"accepted": 0, "refused": 0}
    failures: list[str] = []
    at = 0
    while at < len(work) and len(failures) < MOST:
        at = _child(name, read, seeds, folder, work, at, fixed, memory, told, failures)
    print(f"campaign of {name}: {told['accepted']} accepted, {told['refused']} refused, {len(failures)} failed")
    assert not failures, f"{len(failures)} failures of {name}:\n" + "\n".join(failures)
    return told


def shown(path: Path) -> None:
    """Open a model's file and show it at some times; all numbers of what comes of it must be finite."""
    source = fg.open_source(path)
    for t in (0.0, 0.4, 1.0):
        s = fg.slice_model(*source.moment(t), cull=False)
        assert all(np.isfinite(v).all() for v in (s.position, s.rotation, s.scale, s.opacity, s.features))


def shows(name: str) -> Callable[[Path], None]:
    """shown() of the file of that name, as campaign() takes it."""
    return lambda folder: shown(folder / name)


def attacks(name: str, read: Callable[[Path], object], seeds: Mapping[str, Seed], folder: Path, memory: int = MEMORY) -> dict[str, int]:
    """Call read(folder) with files that are known to have harmed a reader, as they are, within the limits; as campaign() otherwise.

    A small file may take CPU_OF_ATTACKS seconds at most.
    """
    for seed, files in seeds.items():
        _write(folder / seed, files)
    work = [(seed, UNCHANGED) for seed in seeds]
    told = {"accepted": 0, "refused": 0}
    failures: list[str] = []
    at = 0
    while at < len(work) and len(failures) < MOST:
        at = _child(name, read, seeds, folder, work, at, (), memory, told, failures)
    assert not failures, f"{len(failures)} failures of {name}:\n" + "\n".join(failures)
    return told


def _cases(seeds, fixed) -> list[str]:
    for seed, files in seeds.items():
        assert "/" not in seed and set(files) - set(fixed), f"a seed's name without a slash, and a file to change: {seed}"
    return list(seeds)


def _write(folder: Path, files: Seed) -> None:
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        _put(folder / path, content)


def _put(path: Path, content: bytes) -> None:
    """Write a file anew: the disk is waited for where one is emptied and filled again, which takes five times as long."""
    path.unlink(missing_ok=True)
    path.write_bytes(content)


@contextlib.contextmanager
def _strict():
    """Warnings are failures, but for those that say what a file could not give."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", LossWarning)
        warnings.simplefilter("ignore", ResourceWarning)
        yield


def _one(name, read, seeds, folder, seed, number, fixed) -> bool:
    """Whether the reader accepts one mutation; raises what is neither a result nor a good FastGSError."""
    draw = random.Random(f"{name}/{seed}/{number}")
    files = seeds[seed]
    path = draw.choice(sorted(set(files) - set(fixed)))
    others = [content for each in seeds.values() for content in each.values()]
    if number != UNCHANGED:
        _put(folder / seed / path, mutated(files[path], draw, others))
    try:
        with _strict():
            read(folder / seed)
    except FastGSError as error:
        said = str(error)
        assert said and said == printable(said) and "\n" not in said, f"not one printable sentence: {said!r}"
        cause = error
        while cause is not None:
            assert not isinstance(cause, MemoryError), f"more memory is asked for than {seed} may need: {said}"
            cause = cause.__cause__
        return False
    else:
        return True
    finally:
        if not hasattr(os, "fork"):
            ahead(bool).result()  # Windows keeps a file that the thread that reads ahead has open
        _put(folder / seed / path, files[path])


def _child(name, read, seeds, folder, work, begin, fixed, memory, told, failures, again=True) -> int:
    """Work from `begin` on in a forked process, BATCH mutations at most; returns where the next one goes on.

    Libraries such as USD have threads.  One that held a lock while the process was forked leaves it locked in the child, which then waits
    for ever: so a child that never told of anything is made once more.
    """
    if not hasattr(os, "fork"):
        return _batch(name, read, seeds, folder, work, begin, fixed, lambda number, text: _note(text, told, failures))
    out, into = os.pipe()
    log = folder / "child.log"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
        child = os.fork()
    if child == 0:
        try:
            os.close(out)
            with open(log, "w", encoding="utf-8") as stream, open(into, "w", encoding="utf-8") as pipe:
                _limit(memory, stream)

                def tell(number, text):
                    pipe.write(json.dumps([number, text]) + "\n")
                    pipe.flush()

                _batch(name, read, seeds, folder, work, begin, fixed, tell)
        except BaseException:  # noqa: BLE001 (a forked child must not run the parent's tests)
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    os.close(into)
    at, hung = begin, False
    with open(out, encoding="utf-8") as pipe:
        while True:
            if not select.select([pipe], [], [], SILENCE)[0]:
                hung = True
                os.kill(child, signal.SIGKILL)
            line = pipe.readline()
            if not line:
                break
            number, text = json.loads(line)
            at = number + 1
            _note(text, told, failures)
            if len(failures) >= MOST:
                os.kill(child, signal.SIGKILL)
                break
    status = os.waitpid(child, 0)[1]
    if hung and at == begin and again:
        _write(folder / work[at][0], seeds[work[at][0]])
        return _child(name, read, seeds, folder, work, begin, fixed, memory, told, failures, again=False)
    if status and len(failures) < MOST:
        seed, number = work[at]
        how = f"waited for {SILENCE} s" if hung else f"ended the process with {os.waitstatus_to_exitcode(status)}"
        text = " ".join(log.read_text("utf-8", "replace").split()[:60])
        failures.append(f'FASTGS_MUTATION="{name}/{seed}/{number}" {how}: {text}')
        _write(folder / seed, seeds[seed])
        at += 1
    return at


def _note(text: str, told, failures) -> None:
    if text in told:
        told[text] += 1
    else:
        failures.append(text)


def _limit(memory: int, log) -> None:
    faulthandler.enable(log)
    with contextlib.suppress(ImportError, OSError):
        import resource

        with open("/proc/self/statm", encoding="ascii") as stream:
            now = int(stream.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + memory, resource.RLIM_INFINITY))
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    faulthandler.register(signal.SIGPROF, log, chain=True)  # says where it was, then ends the process


def _batch(name, read, seeds, folder, work, begin, fixed, tell) -> int:
    """The next BATCH of the work from `begin` on, in this process; returns where the next one goes on."""
    end = min(begin + BATCH, len(work))
    for at in range(begin, end):
        seed, number = work[at]
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, CPU if number != UNCHANGED else CPU_OF_ATTACKS)
        try:
            text = "accepted" if _one(name, read, seeds, folder, seed, number, fixed) else "refused"
        except Exception as error:  # noqa: BLE001 (any other error than FastGSError is a failure to be told of)
            place = traceback.extract_tb(error.__traceback__)[-1]
            text = (f'FASTGS_MUTATION="{name}/{seed}/{number}" {type(error).__name__}: {printable(error)[:300]} '
                    f"({Path(place.filename).name}:{place.lineno})")
        tell(at, text)
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, 0)
    return end
