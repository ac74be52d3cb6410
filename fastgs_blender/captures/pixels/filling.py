# SPDX-License-Identifier: GPL-3.0-or-later
"""Decodes many shots in threads, and stops cleanly."""
import os
import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ...util.errors import FastGSError
from ..capture import Shot
from . import decoding

BATCH = 16
"""Pictures in a piece of work."""


def fill(shots: list[Shot], scale: float, is_there: Callable[[Shot], bool], keep: Callable[[Shot, np.ndarray], None],
         threads: int) -> Iterator[str | None]:
    """Decode shots and keep() their pixels: None, or a sentence on what is wrong, for each shot as it gets done.

    Shots that another process has kept meanwhile are not decoded again.  Closing the iterator stops the work.
    """
    tasks = _tasks(shots)
    results: queue.SimpleQueue = queue.SimpleQueue()
    stop = threading.Event()

    def work(task: list[Shot]) -> None:
        try:
            for shot, found in decoding.decode((s for s in task if not is_there(s)), scale):
                if stop.is_set():
                    return
                if isinstance(found, FastGSError):
                    results.put((shot, str(found)))
                else:
                    keep(shot, found)
                    results.put((shot, None))
        except BaseException as error:  # noqa: BLE001 (handed over: fill() raises it)
            stop.set()
            results.put(error)
        finally:
            results.put(task)

    with ThreadPoolExecutor(threads) as pool:
        try:
            for task in tasks:
                pool.submit(work, task)
            left = len(tasks)
            told: set[Shot] = set()
            while left:
                got = results.get()
                if isinstance(got, BaseException):
                    raise got
                if isinstance(got, list):  # a task has ended: those of its shots not told of yet were done by another process
                    left -= 1
                    yield from (None for shot in got if shot not in told)
                    told.difference_update(got)
                else:
                    told.add(got[0])
                    yield got[1]
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _tasks(shots: list[Shot]) -> list[list[Shot]]:
    """Pieces of work: all shots of a video, or a few pictures of one view; processes that start at once begin at different ones."""
    groups: dict = {}
    for shot in shots:
        groups.setdefault((shot.view, shot.image.path if shot.image.frame is not None else None), []).append(shot)
    tasks = [group[i:i + BATCH] if path is None else group for (_, path), group in groups.items()
             for i in (range(0, len(group), BATCH) if path is None else (0,))]
    first = (os.getpid() * 2654435761 % 2**32 * len(tasks)) >> 32
    return tasks[first:] + tasks[:first]
