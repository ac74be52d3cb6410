# SPDX-License-Identifier: GPL-3.0-or-later
"""Device, one GPU: its buffers, its compiled shaders, and its queue of commands.

run(), zeros() and copy() record commands; reading, writing or submit() sends them to the GPU.  Buffers without references are used again.
Every error raises Failure with a sentence; the device cannot be used after that.
"""
from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from heapq import heappop, heappush
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from ..protocol import DeviceError
from .pipelines import Groups, Pipeline, compiled

GROUP = 256
"""Threads of a workgroup: the most that WebGPU promises."""
WIDEST = 32_768
"""Workgroups in x; more of them go on in y (WebGPU promises 65 535 of each)."""
SLOT = 256
"""Alignment of a stage's parameters in their buffer (WebGPU's largest)."""
PARAMETERS = 1 << 18
"""Bytes of parameters that are handed over with one piece of work."""
SUBGROUPS = "subgroup"
"""The feature's name."""
SPARE = 1 << 30
"""Bytes of buffers that are kept to be used again."""


class Failure(DeviceError):
    """A GPU cannot do what it was asked for."""


class TooLarge(Failure):
    """The work is too large for the device, which can draw a part of the picture instead."""


@dataclass(eq=False)
class Buffer:
    """Memory of a device; when nothing refers to it any more, it goes back to the device's store, or is freed if it is not to be reused."""

    device: Device
    native: Any
    size: int
    reused: bool = True

    def __del__(self) -> None:
        self.device.take_back(self)


@dataclass(frozen=True, eq=False)
class Array:
    """An array on a device.

    buffer   4 bytes for each number: float32, int32 or uint32
    shape, dtype   as NumPy would have it; float64 and int64 are float32 and int32 on the device
    columns  (first, last, width): the array is these columns of rows of `width` numbers; None: all there is
    begin    its first number in the buffer, a multiple of SLOT / 4: it may be a part of another array (rows.py)
    """

    buffer: Buffer
    shape: tuple[int, ...]
    dtype: np.dtype
    columns: tuple[int, int, int] | None = None
    begin: int = 0

    def numpy(self) -> np.ndarray:
        """The values."""
        count = math.prod(self.shape)
        if self.columns is None:
            return self.buffer.device.read(self.buffer, stored(self.dtype), count, self.begin).reshape(self.shape).astype(self.dtype)
        first, last, width = self.columns
        rows = count // (last - first)
        values = self.buffer.device.read(self.buffer, stored(self.dtype), rows * width).reshape(rows, width)[:, first:last]
        return values.reshape(self.shape).astype(self.dtype)


def stored(dtype: DTypeLike) -> np.dtype:
    """The type in which a device holds numbers of a type."""
    kind = np.dtype(dtype)
    return np.dtype({"f": np.float32, "i": np.int32, "u": np.uint32, "b": np.uint32}[kind.kind])


@dataclass(eq=False)
class Device:
    """An adapter that has been opened.

    adapter   wgpu's GPUAdapter; opened with all the room that it has
    broken    whether it has failed
    guessing  whether a training step has begun, which guesses numbers instead of reading them
    guesses   guesses.Guess by what it is of
    when_full functions that are called where its memory is full, and let go what can be made again

    Several threads may use it: each piece of work is recorded whole.
    """

    adapter: Any
    broken: bool = False
    guessing: bool = False
    guesses: dict = field(default_factory=dict)
    when_full: list[Callable[[], None]] = field(default_factory=list)
    _pipelines: dict[tuple, Pipeline] = field(default_factory=dict)
    _groups: Groups = field(default_factory=Groups)
    _recorded: set[int] = field(default_factory=set)  # ids of the buffers in commands that have not been sent
    _spare: dict[int, list] = field(default_factory=dict)  # heaps: in whatever order buffers come back, each step finds the same ones
    _spare_bytes: int = 0
    _encoder: Any = None
    _pass: Any = None
    _parameters: bytearray = field(default_factory=bytearray)
    _lock: Any = field(default_factory=threading.RLock)

    @cached_property
    def native(self) -> Any:
        """wgpu's GPUDevice."""
        raised = ("max-storage-buffer-binding-size", "max-buffer-size")
        return self._try(lambda: self.adapter.request_device_sync(
            required_limits={name: self.adapter.limits[name] for name in raised},
            required_features=[name for name in self.adapter.features if name == SUBGROUPS]))

    @cached_property
    def subgroups(self) -> bool:
        """Whether shaders may use subgroups, and these are as wgsl/subgroups.wgsl wants them."""
        if SUBGROUPS not in self.native.features:
            return False
        self.__dict__["subgroups"] = False  # for the shader that asks
        try:
            orderly = self.zeros((GROUP,), np.uint32)
            self.run("subgroups", 1, [[0, 0, 0, 0]], orderly)
            return bool(orderly.numpy().all())
        except Failure:  # a driver that refuses them can do without; one that is lost fails again
            self.broken = False
            return False

    @cached_property
    def binding(self) -> int:
        """Bytes of the largest buffer that a shader can see."""
        return min(self.native.limits["max-storage-buffer-binding-size"], self.native.limits["max-buffer-size"])

    @cached_property
    def spilled(self) -> Array:
        """[1]: 1 where a guess was too small; what a training step leaves behind then stays as it was (guesses.py)."""
        return self.zeros((1,), np.uint32)

    @cached_property
    def _arena(self) -> Any:
        import wgpu

        return self._try(lambda: self.native.create_buffer(size=PARAMETERS, usage=wgpu.BufferUsage.UNIFORM | wgpu.BufferUsage.COPY_DST))

    # memory

    @contextmanager
    def narrow(self, binding: int) -> Iterator[None]:
        """Within this, buffers hold at most so many bytes, as on a device that can do no more."""
        before = self.binding
        self.binding = min(binding, before)
        try:
            yield
        finally:
            self.binding = before

    def fits(self, numbers: int) -> int:
        """The bytes of so many numbers of 4 bytes; raises TooLarge where no shader can see them at once."""
        size = 4 * int(numbers)
        if size > self.binding:
            raise TooLarge(f"{size / 2**20:.0f} MiB in one piece are more than it can use at once ({self.binding / 2**20:.0f} MiB)")
        return size

    def buffer(self, numbers: int) -> Buffer:
        """A buffer for so many numbers of 4 bytes, not initialised."""
        size = self.fits(max(numbers, 4))
        size = min(_rounded(size), self.binding // 16 * 16)
        with self._lock:
            while self._spare.get(size):
                self._spare_bytes -= size
                native = heappop(self._spare[size])[1]
                if getattr(native, "_internal", True) is not None:  # wgpu frees what Python's collector of cycles has found
                    return Buffer(self, native, size)
        try:
            return Buffer(self, self._create(size), size)
        except TooLarge:
            self._let_go()
            return Buffer(self, self._create(size), size)

    def _create(self, size: int) -> Any:
        import wgpu

        usage = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_SRC | wgpu.BufferUsage.COPY_DST
        return self._try(lambda: self.native.create_buffer(size=size, usage=usage))

    def _mappable(self, size: int) -> Any:
        import wgpu

        return self.native.create_buffer(size=size, usage=wgpu.BufferUsage.MAP_READ | wgpu.BufferUsage.COPY_DST)

    def take_back(self, buffer: Buffer, most: int = SPARE, push: Callable[..., None] = heappush) -> None:
        """Keep what a buffer was made of, or let it go; most: bytes that are kept.  (Arguments, because buffers may outlive this module's
        names when Python ends.)"""
        with self._lock:
            if buffer.reused and not self.broken and self._spare_bytes + buffer.size <= most:
                push(self._spare.setdefault(buffer.size, []), (id(buffer.native), buffer.native))
                self._spare_bytes += buffer.size
            else:
                self._groups.forget(buffer.native)

    def _let_go(self) -> None:
        self.submit()
        for let_go in self.when_full:
            let_go()
        with self._lock:
            self._spare.clear()
            self._spare_bytes = 0
            self._groups.forget()

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Array:
        """An array that is not initialised."""
        return Array(self.buffer(math.prod(shape)), tuple(shape), np.dtype(dtype))

    def zeros(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Array:
        """An array of zeros."""
        array = self.empty(shape, dtype)
        self.clear(array.buffer)
        return array

    def clear(self, buffer: Buffer) -> None:
        """Fill a buffer with zeros."""
        self._recorded.add(id(buffer.native))
        self._try(lambda: self._commands().clear_buffer(buffer.native))

    def array(self, values: ArrayLike) -> Array:
        """The values as an array of the device."""
        values = np.asarray(values)
        return self.upload(self.empty(values.shape, values.dtype), values)

    def upload(self, array: Array, values: np.ndarray) -> Array:
        """Give a whole array its values; returns it."""
        self.write(array.buffer, np.ascontiguousarray(values, stored(values.dtype)))
        return array

    def write(self, buffer: Buffer, data: np.ndarray, at: int = 0) -> None:
        """Write numbers into a buffer from its number `at` on, after all work that was recorded with it."""
        if data.size:
            if id(buffer.native) in self._recorded:
                self.submit()
            self._try(lambda: self.native.queue.write_buffer(buffer.native, 4 * at, data))

    def copy(self, source: Buffer, target: Buffer, numbers: int, begin: int = 0, at: int = 0) -> None:
        """Copy so many numbers from `begin` on in one buffer to `at` in another."""
        if numbers:
            self._recorded.update((id(source.native), id(target.native)))
            self._try(lambda: self._commands().copy_buffer_to_buffer(source.native, 4 * begin, target.native, 4 * at, 4 * numbers))

    def read(self, buffer: Buffer, dtype: DTypeLike, count: int, begin: int = 0) -> np.ndarray:
        """`count` numbers of a buffer from `begin` on; waits for all work."""
        if not count:
            return np.empty(0, dtype)
        self.submit()
        data = self._try(lambda: self.native.queue.read_buffer(buffer.native, 4 * begin, 4 * count))
        return np.frombuffer(data, dtype, count)

    def read_later(self, arrays: Sequence[Array]) -> Callable[[], list[np.ndarray]]:
        """A function that gives the values that several small arrays, no columns of others, have now: it waits only as far as the GPU has
        not come to this place yet."""
        sizes = [math.prod(array.shape) for array in arrays]
        size = 4 * max(sum(sizes), 1)
        coming = Buffer(self, self._try(lambda: self._mappable(size)), size, reused=False)
        for array, at, size in zip(arrays, np.cumsum([0, *sizes]).tolist(), sizes):
            self.copy(array.buffer, coming, size, 0, at)
        self.submit()
        mapping = self._try(lambda: coming.native.map_async("READ"))

        def arrive() -> list[Any]:
            self._try(mapping.sync_wait)
            values = np.frombuffer(self._try(coming.native.read_mapped), np.uint32)
            parts = np.split(values[:sum(sizes)], np.cumsum(sizes)[:-1])
            return [part.view(stored(array.dtype)).reshape(array.shape).astype(array.dtype) for part, array in zip(parts, arrays)]

        return arrive

    def read_all(self, arrays: Sequence[Array]) -> list[np.ndarray]:
        """The values of several small arrays at once, which are no columns of others; waits for all work."""
        return self.read_later(arrays)()

    # work

    def wait(self) -> None:
        """Wait until all work is done, for measurements."""
        self.read(self.buffer(1), np.uint32, 1)

    def run(self, stage: str, threads: int, parameters: Iterable[Any], *buffers: Any, groups: bool = False, **constants: Any) -> None:
        """Give the GPU a stage to do (wgsl/<stage>.wgsl).

        threads     how many are needed, in workgroups of GROUP; with `groups` that many workgroups
        parameters  what the stage's uniform structure holds: numbers and arrays, one after the other (packed)
        buffers     Arrays or Buffers, as the stage's bindings name them from 1 on
        constants   filled into the shader: {NAME}
        """
        count = int(threads) if groups else -(-int(threads) // GROUP)
        if count == 0:
            return
        x = min(count, WIDEST)
        self._try(lambda: self._dispatch(self._pipeline(stage, constants), packed(parameters), buffers, (x, -(-count // x), 1)))

    def _dispatch(self, pipeline: Pipeline, parameters: bytes, buffers: Sequence[Any], size: Any) -> None:
        where = -(-len(self._parameters) // SLOT) * SLOT
        if where + len(parameters) > PARAMETERS:
            self.submit()
            where = 0
        self._parameters += bytes(where - len(self._parameters)) + parameters
        parts = [(each.buffer, 4 * each.begin) if isinstance(each, Array) else (each, 0) for each in buffers]
        self._recorded.update(id(buffer.native) for buffer, _ in parts)
        group = self._groups.get(self.native, pipeline, (self._arena, len(parameters)),
                                 [(buffer.native, first, buffer.size - first) for buffer, first in parts])
        if self._pass is None:
            self._pass = self._commands().begin_compute_pass()
        self._pass.set_pipeline(pipeline.native)
        self._pass.set_bind_group(0, group, [where])
        self._pass.dispatch_workgroups(*size)

    def _pipeline(self, stage: str, constants: dict) -> Pipeline:
        key = stage, *sorted(constants.items())
        if key not in self._pipelines:
            self._pipelines[key] = compiled(self.native, stage, self.subgroups, constants)
        return self._pipelines[key]

    def _commands(self) -> Any:
        """The encoder of the work that has not been handed over, outside of any pass."""
        if self._encoder is None:
            self._encoder = self.native.create_command_encoder()
        if self._pass is not None:
            self._pass.end()
            self._pass = None
        return self._encoder

    def submit(self) -> None:
        """Send all recorded commands to the GPU."""
        self._try(self._submit)

    def _submit(self) -> None:
        if self._encoder is None:
            return
        commands = self._commands()
        self._encoder = None
        self._recorded.clear()
        if self._parameters:
            self.native.queue.write_buffer(self._arena, 0, self._parameters)
            self._parameters = bytearray()
        self.native.queue.submit([commands.finish()])

    def _try(self, action: Callable[[], Any]) -> Any:
        """The action's result; what goes wrong in it becomes a Failure."""
        import wgpu

        if self.broken:
            raise Failure("it has failed before")
        try:
            with self._lock:
                return action()
        except wgpu.GPUOutOfMemoryError as error:
            raise TooLarge(f"its memory is full ({_first_line(error)})") from error
        except (wgpu.GPUError, RuntimeError, OSError, ValueError) as error:
            self.broken = True
            raise Failure(_first_line(error)) from error


def packed(values: Iterable[Any]) -> bytes:
    """Numbers and arrays one after the other, as a uniform structure of vec4 has them: whole numbers as u32, others as f32; each value
    begins a new vec4, and lists of numbers follow each other."""
    parts = []
    for value in values:
        array = np.asarray(value).ravel()
        array = array.astype(np.float32 if array.dtype.kind == "f" else np.uint32)
        parts.append(array.tobytes())
        parts.append(bytes(-len(parts[-1]) % 16))
    return b"".join(parts)


def _rounded(size: int) -> int:
    """The next larger size of those that buffers have: 2^n and 3 * 2^(n - 1)."""
    power = 1 << (size - 1).bit_length()
    return 3 * power // 4 if size <= 3 * power // 4 else power


def _first_line(error: Exception) -> str:
    """An error's message on one line, after the name of the stage in which it happened."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if not line.startswith(("Validation Error", "Caused by", "In wgpu"))]
    return (telling or lines or [type(error).__name__])[0].rstrip(".")[:200]
