# SPDX-License-Identifier: GPL-3.0-or-later
"""Distributed training: torchrun starts the processes, each renders its share of a step's views, and gradients are summed.

All hold the same Gaussians and take the same steps; only the first writes.  gloo joins processors, NCCL joins GPUs.
"""
from __future__ import annotations

import json
import os
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ...util.errors import FastGSError


@dataclass(frozen=True)
class Group:
    """The processes of this run: this one's `rank`, their number `size`, and the device of their sums (None: one process)."""

    rank: int = 0
    size: int = 1
    device: str | None = None

    @property
    def first(self) -> bool:
        return self.rank == 0

    def total(self, arrays: list[np.ndarray]) -> None:
        """Replace float arrays (of equal shapes in all processes) by their sums over the processes, in place; sent as one message."""
        if self.device is None:
            return
        import torch
        import torch.distributed as dist

        for kind in dict.fromkeys(array.dtype for array in arrays):  # in one order: a set's differs from process to process
            same = [array for array in arrays if array.dtype == kind]
            flat = torch.from_numpy(np.concatenate([array.reshape(-1) for array in same])).to(self.device)
            dist.all_reduce(flat)
            parts = np.split(flat.cpu().numpy(), np.cumsum([array.size for array in same])[:-1])
            for array, part in zip(same, parts, strict=True):
                array[...] = part.reshape(array.shape)

    def largest(self, array: np.ndarray) -> None:
        """Replace an array by its element-wise maximum over the processes, in place."""
        if self.device is None:
            return
        import torch
        import torch.distributed as dist

        flat = torch.from_numpy(np.ascontiguousarray(array)).to(self.device)
        dist.all_reduce(flat, op=dist.ReduceOp.MAX)
        array[...] = flat.cpu().numpy()

    def share(self, value):
        """Send the first process' value (anything that JSON can hold) to all processes; returns it."""
        return json.loads(self._share_bytes(json.dumps(value).encode() if self.first else b""))

    def share_arrays(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Send the first process' arrays to all processes; returns them."""
        if self.device is None:
            return arrays
        import safetensors.numpy

        return safetensors.numpy.load(self._share_bytes(safetensors.numpy.save(arrays) if self.first else b""))

    def _share_bytes(self, data: bytes) -> bytes:
        if self.device is None:
            return data
        import torch
        import torch.distributed as dist

        length = torch.tensor([len(data)], dtype=torch.int64, device=self.device)
        dist.broadcast(length, src=0)
        content = torch.frombuffer(bytearray(data) if self.first else bytearray(int(length)), dtype=torch.uint8).to(self.device)
        dist.broadcast(content, src=0)
        return content.cpu().numpy().tobytes()

    def first_does(self, work):
        """Run work() in the first process; returns its result there, None in the others.  Its error is raised in all processes."""
        if self.device is None:
            return work()
        result = error = None
        if self.first:
            try:
                result = work()
            except (Exception, KeyboardInterrupt) as raised:  # noqa: BLE001 (raised below, once all processes know of it)
                error = raised
        text = self.share(None if error is None else str(error) or type(error).__name__)
        if error is not None:
            raise error
        if text is not None:
            raise FastGSError(text)
        return result


@contextmanager
def joined():
    """The group that torchrun's environment describes; a group of one without it."""
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or "RANK" not in os.environ:
        yield Group()
        return
    import torch
    import torch.distributed as dist

    local = int(os.environ.get("LOCAL_RANK", "0"))
    on_gpus = torch.cuda.is_available() and torch.cuda.device_count() >= int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    try:
        if on_gpus:
            torch.cuda.set_device(local)
        dist.init_process_group("nccl" if on_gpus else "gloo")
    except (RuntimeError, ValueError) as error:
        raise FastGSError(f"the processes of this training could not find each other ({error}); start them with torchrun.") from error
    try:
        yield Group(dist.get_rank(), dist.get_world_size(), f"cuda:{local}" if on_gpus else "cpu")
    finally:
        dist.destroy_process_group()
