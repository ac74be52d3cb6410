# SPDX-License-Identifier: GPL-3.0-or-later
"""run() spreads work over several threads; thread_count() says how many.

Kernels release Python's lock, so plain Python threads run them side by side.  Numba's own parallel loops are not used: their
fallback layer aborts the process when two threads render at once.  What a piece of work computes never depends on how the
work is cut, so the result has the same bytes for any number of threads.
"""
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

import numpy as np

PIECE = 2048
"""Columns of a product with a small matrix: OpenBLAS makes so few in the thread that asks for them."""
MOST, LEAST = 16_384, 1024
"""Rows of arrays, such as Gaussians, in one piece of work."""
AHEAD = 4
"""Pieces for each thread that several() works on before their results are asked for."""
_chosen = 0
_here = threading.local()
"""busy: whether all threads have pieces of the work that this one is a part of."""
Result = TypeVar("Result")
Other = TypeVar("Other")


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


@cache
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

    progress is called with 0..1 from the calling thread as pieces end; what it, or a piece, raises stops the rest and passes on.  Within
    a piece run() works in that piece's thread alone where all threads have pieces: waking others would only take time.
    """
    pieces, busy = list(pieces), getattr(_here, "busy", False)
    count = 1 if busy else min(thread_count(), len(pieces))
    if count <= 1 and not progress:  # small pictures are many
        return [work(*piece) for piece in pieces]
    results: list[Any] = [None] * len(pieces)
    numbers, failed = iter(range(len(pieces))), list[int]()

    def take(progress: Callable[[float], object] | None = None) -> None:
        _here.busy = busy or len(pieces) >= thread_count()
        try:
            for k in numbers:  # threads share it: each number comes once
                if failed:
                    return
                try:
                    results[k] = work(*pieces[k])
                    if progress:
                        progress((k + 1) / len(pieces))
                except BaseException:
                    failed.append(k)
                    raise
        finally:
            _here.busy = busy

    others = [_pool(thread_count()).submit(take) for _ in range(count - 1)]
    try:
        take(progress)
    finally:
        begun = [other for other in others if not other.cancel()]
        wait(begun)
    for other in begun:
        other.result()
    if progress and others:
        progress(1.0)
    return results


def several(work: Callable[..., Result], pieces: Sequence[tuple]) -> Iterator[Result]:
    """The results of work(*piece) one after the other; some pieces are worked on side by side before their results are asked for."""
    for first, last in ranges(len(pieces), AHEAD * thread_count()):
        yield from run(work, pieces[first:last])


def beside(work: Callable[[], Result], other: Callable[[], Other]) -> tuple[Result, Other]:
    """The results of two calls, either of which may use run(): the first has a thread of its own, where there are several."""
    if thread_count() == 1:
        return work(), other()
    with ThreadPoolExecutor(1) as pool:
        task = pool.submit(work)
        there = other()
        return task.result(), there


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


def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """left [k, m] or [m] @ right [m, N], piece by piece.

    For long ones OpenBLAS takes threads of its own.  These go on spinning, so that a frame takes up to twice the processors' time.
    """
    out = np.empty((*left.shape[:-1], right.shape[1]), np.result_type(left, right))

    def columns(begin: int, end: int) -> None:
        for first, last in ranges(end - begin, PIECE):
            np.matmul(left, right[:, begin + first:begin + last], out=out[..., begin + first:begin + last])

    run(columns, ranges(right.shape[1], 4 * PIECE))
    return out


def taken(arrays: Sequence[np.ndarray], index: np.ndarray, axis: int = 0) -> list[np.ndarray]:
    """np.take() of each of several arrays along their first (0) or their last (-1) axis, which has the same size in all."""
    size = arrays[0].shape[axis]
    if (axis and not all(array.flags.c_contiguous for array in arrays)) or (len(index) and not 0 <= index.min() <= index.max() < size):
        return [np.take(array, index, axis) for array in arrays]  # which says what is wrong
    out = [np.empty((*array.shape[:-1], len(index)) if axis else (len(index), *array.shape[1:]), array.dtype) for array in arrays]
    rows = [pair for array, into in zip(arrays, out, strict=True) if into.size for pair in (
        zip(array.reshape(-1, size), into.reshape(-1, len(index)), strict=True) if axis else [(array, into)])]

    def piece(first: int, last: int) -> None:
        for array, into in rows:
            np.take(array, index[first:last], 0, into[first:last], "clip")  # of all modes the one that writes there at once

    run(piece, ranges(len(index), 4 * PIECE))
    return out


def joined(work: Callable[[int, int], tuple[np.ndarray, ...]], total: int) -> list[np.ndarray]:
    """The arrays of work(first, last), of pieces of range(total) so small that they stay in the processor's cache, joined along the last
    axis."""
    return [np.concatenate(each, -1) for each in zip(*run(work, ranges(total, 4 * PIECE) or [(0, 0)]), strict=True)]


def portions(total: int, most: int = 0, least: int = 0) -> list[tuple[int, int]]:
    """ranges() of at most `most` and at least `least`, 0: MOST and LEAST; each thread has four, where run() has several threads."""
    count = 1 if getattr(_here, "busy", False) else thread_count()
    return ranges(total, min(most or MOST, max(least or LEAST, -(-total // (4 * count)) if count > 1 else total)))


def ranges(total: int, size: int) -> list[tuple[int, int]]:
    """(start, stop) of pieces of at most `size` that cover range(total)."""
    return [(start, min(start + size, total)) for start in range(0, total, size)]
