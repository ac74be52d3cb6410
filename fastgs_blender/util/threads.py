# SPDX-License-Identifier: GPL-3.0-or-later
"""run() spreads work over several threads; thread_count() says how many.

Kernels release Python's lock, so plain Python threads run them side by side.  Numba's own parallel loops are not used: their
fallback layer aborts the process when two threads render at once.  What a piece of work computes never depends on how the
work is cut, so the result has the same bytes for any number of threads.
"""
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

_chosen = 0
Result = TypeVar("Result")


def set_threads(count: int) -> None:
    """Use this many threads from now on; 0: one for each processor the process may use."""
    global _chosen
    _chosen = max(0, int(count))


def thread_count() -> int:
    """Threads in use: set_threads(), else available()."""
    return _chosen or available()


@contextmanager
def all_threads() -> Iterator[None]:
    """Within this, available() threads are used, whatever set_threads() said."""
    before = _chosen
    set_threads(0)
    try:
        yield
    finally:
        set_threads(before)


def available() -> int:
    """Threads where nobody chose a number: $FASTGS_THREADS or $NUMBA_NUM_THREADS, else the processors of this process."""
    wanted = os.environ.get("FASTGS_THREADS") or os.environ.get("NUMBA_NUM_THREADS") or "0"
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="fastgs")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # threads do not survive a fork


def run(work: Callable[..., Any], pieces: Iterable[tuple], progress: Callable[[float], object] | None = None) -> list:
    """[work(*piece) for piece in pieces], side by side.

    progress is called with 0..1 from the calling thread as pieces end; what it, or a piece, raises stops the rest and passes on.
    """
    pieces = list(pieces)
    count = thread_count()
    if count == 1 or len(pieces) == 1:
        results = []
        for i, piece in enumerate(pieces):
            results.append(work(*piece))
            if progress:
                progress((i + 1) / len(pieces))
        return results
    futures = [_pool(count).submit(work, *piece) for piece in pieces]
    try:
        pending = set(futures)
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
            if progress:
                progress(1 - len(pending) / len(futures))
    except BaseException:
        for future in futures:
            future.cancel()
        wait(futures)
        raise
    return [future.result() for future in futures]


def gathered(works: Sequence[Callable[[], Result]], tick: Callable[[], None], most: int = 4) -> list[Result]:
    """The results of calls that run side by side in threads of their own, for calls that use run() themselves.

    tick() is called from this thread every quarter of a second and at the end; what it, or a call, raises stops the rest and passes on.
    """
    with ThreadPoolExecutor(min(available(), most)) as pool:
        tasks = [pool.submit(work) for work in works]
        try:
            while wait(tasks, 0.25, FIRST_EXCEPTION).not_done and not any(task.done() and task.exception() for task in tasks):
                tick()
            found = [task.result() for task in tasks]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    tick()
    return found


def ranges(total: int, size: int) -> list[tuple[int, int]]:
    """(start, stop) of pieces of at most `size` that cover range(total)."""
    return [(start, min(start + size, total)) for start in range(0, total, size)]
