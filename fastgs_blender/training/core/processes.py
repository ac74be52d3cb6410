# SPDX-License-Identifier: GPL-3.0-or-later
"""The processes that take a step together.  A step is written against Processes, one that works alone; Several sums over torchrun's.

All processes hold the same Gaussians and take the same steps, each with its share of the views.  The first one runs training
(run/session.py); the others follow its trainer (run/follower.py).  gloo joins processors, NCCL joins GPUs.
"""
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any

import numpy as np

from ...util.errors import FastGSError
from .statistics import NAMES, Statistics


class Processes:
    """A process that trains alone: nothing is shared, summed or sent."""

    rank, count = 0, 1

    def begin_step(self, backend: Any) -> int:
        """Begin a step; returns how many further steps may begin before its end is asked for."""
        return backend.begin_step()

    def share(self, items: Sequence) -> Sequence:
        """This process' items of a list, of which all have equally many."""
        size = len(items) // self.count
        return items[self.rank * size:(self.rank + 1) * size]

    def statistics(self, backend: Any, statistics: Statistics) -> Statistics:
        """The statistics to which this process adds a step's views."""
        return statistics

    def sum_step(self, backend: Any, gradients: dict, seen: Any, values: list, statistics: Statistics) -> tuple:
        """The sums over all processes of gradients by name, seen [N], values [4] of each view, and statistics."""
        return gradients, seen, values, statistics

    def total(self, arrays: list[np.ndarray]) -> None:
        """Replace float arrays by their sums over all processes, in place."""

    def send(self, message: Any, arrays: dict[str, np.ndarray] | None = None) -> None:
        """Tell the processes that follow what to do: anything that JSON can hold, and arrays; None: the run has ended."""


class Several(Processes):
    """One of torchrun's processes; `device` is where their sums are made."""

    def __init__(self, rank: int, count: int, device: str) -> None:
        self.rank, self.count, self.device = rank, count, device
        self.in_step = False  # others wait for this one's sums

    def begin_step(self, backend: Any) -> int:
        """As above; values that others wait for have to be right at once, so no step is ahead."""
        if not self.rank:
            self.send("step")
        self.in_step = True
        return 0

    def statistics(self, backend: Any, statistics: Statistics) -> Statistics:
        """As above: those so far are counted once."""
        return Statistics.empty(backend, statistics.radius.shape[0]) if self.rank else statistics

    def sum_step(self, backend: Any, gradients: dict, seen: Any, values: list, statistics: Statistics) -> tuple:
        """As above; arrays of the backend go through the host."""
        host = {name: backend.numpy(gradient) for name, gradient in gradients.items()}
        seen, sums, new = backend.numpy(seen), np.sum(backend.read(*values), 0), statistics.state(backend)
        self.total([*host.values(), seen, sums, *(new[name] for name in NAMES if name != "radius")])
        self._reduce(new["radius"], "MAX")
        self.in_step = False
        return ({name: backend.array(gradient) for name, gradient in host.items()}, backend.array(seen), [backend.array(sums)],
                Statistics.restored(backend, new))

    def total(self, arrays: list[np.ndarray]) -> None:
        """As above; arrays of one type travel as one message."""
        for kind in dict.fromkeys(array.dtype for array in arrays):  # in one order: a set's differs from process to process
            same = [array for array in arrays if array.dtype == kind]
            flat = np.concatenate([array.reshape(-1) for array in same])
            self._reduce(flat, "SUM")
            for array, part in zip(same, np.split(flat, np.cumsum([array.size for array in same])[:-1]), strict=True):
                array[...] = part.reshape(array.shape)

    def _reduce(self, array: np.ndarray, how: str) -> None:
        import torch
        import torch.distributed as dist

        flat = torch.from_numpy(array).to(self.device)
        dist.all_reduce(flat, op=getattr(dist.ReduceOp, how))
        array[...] = flat.cpu().numpy()

    def send(self, message: Any, arrays: dict[str, np.ndarray] | None = None) -> None:
        """As above."""
        import safetensors.numpy

        self._broadcast(json.dumps(message).encode())
        if arrays is not None:
            self._broadcast(safetensors.numpy.save(arrays))

    def hear(self) -> Any:
        """What the first process sends next."""
        return json.loads(self._broadcast())

    def hear_arrays(self) -> dict[str, np.ndarray]:
        """The arrays that follow such a message."""
        import safetensors.numpy

        return safetensors.numpy.load(self._broadcast())

    def _broadcast(self, data: bytes = b"") -> bytes:
        import torch
        import torch.distributed as dist

        length = torch.tensor([len(data)], dtype=torch.int64, device=self.device)
        dist.broadcast(length, src=0)
        content = torch.frombuffer(bytearray(data or int(length)), dtype=torch.uint8).to(self.device)
        dist.broadcast(content, src=0)
        return content.cpu().numpy().tobytes()


@contextmanager
def joined() -> Iterator[Any]:
    """The processes that torchrun's environment describes; Processes without it."""
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count < 2 or "RANK" not in os.environ:
        yield Processes()
        return
    import torch
    import torch.distributed as dist

    local = int(os.environ.get("LOCAL_RANK", "0"))
    on_gpus = torch.cuda.is_available() and torch.cuda.device_count() >= int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    try:
        if on_gpus:
            torch.cuda.set_device(local)
        # others wait while the first decodes pictures and finds starting points, which may take far longer than torch's half hour
        dist.init_process_group("nccl" if on_gpus else "gloo", timeout=timedelta(days=7))
    except (RuntimeError, ValueError) as error:
        raise FastGSError(f"the processes of this training could not find each other ({error}); start them with torchrun.") from error
    processes = Several(dist.get_rank(), dist.get_world_size(), f"cuda:{local}" if on_gpus else "cpu")
    try:
        yield processes
    finally:
        if not processes.rank and not processes.in_step:  # else torchrun ends the others
            with suppress(RuntimeError):  # they have failed too
                processes.send(None)
        dist.destroy_process_group()
