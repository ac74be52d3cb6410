# SPDX-License-Identifier: GPL-3.0-or-later
"""PyTorch's zip files (torch.save since 1.6) without torch, and without executing a pickle.

A file holds `<root>/data.pkl`, a pickle that says which tensors there are, and their numbers raw in `<root>/data/<key>`.
The pickle is interpreted here by a small machine that knows only the instructions which describe nested tables of
tensors; whatever else a pickle can do is refused.  Numbers are read when asked for, and never more than the file has.
"""
from __future__ import annotations

import pickletools
import struct
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import damaged_if
from ..util.zip_files import opened_zip, read_member

MAX_PICKLE = 1 << 20
"""Bytes; a table of a thousand tensors has 200 KB."""
MOST_VALUES = 1 << 21
"""Of what a pickle describes, where a value that is named twice counts twice: one that doubles a table thirty times is short."""
STORAGES = {
    "FloatStorage": "f4", "DoubleStorage": "f8", "HalfStorage": "f2", "BFloat16Storage": "bf2", "LongStorage": "i8", "IntStorage": "i4",
    "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1", "BoolStorage": "b1",
}
"""PyTorch's kinds of storage and their numpy codes; bf2 is bfloat16, which numpy lacks."""
NUMPY = ("numpy.dtype", "numpy.core.multiarray.scalar", "numpy._core.multiarray.scalar", "_codecs.encode")
"""What a single number of numpy, such as the size of the scene in checkpoints of INRIA's family, is made of."""
TABLES = (dict, list, tuple)
REFUSED = "it is not a table of tensors alone, and a pickle with anything else in it is never executed"


@dataclass(frozen=True)
class _Global:
    """A name that the pickle mentions: inert."""

    name: str


@dataclass(frozen=True)
class _Type:
    """numpy's type of a number."""

    code: str


@dataclass(frozen=True)
class _Storage:
    key: str
    code: str


@dataclass(frozen=True)
class Tensor:
    """A tensor in the file: known by shape, not yet read."""

    file: TorchFile
    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]

    def read(self) -> np.ndarray:
        """Its numbers, as the file has them (bfloat16 as float32)."""
        flat = self.file.storage(self.storage)
        strides = tuple(s * flat.itemsize for s in self.stride)
        return np.lib.stride_tricks.as_strided(flat[self.offset:], self.shape, strides).copy()


class TorchFile:
    """One file: `content` is what was saved, dicts and lists with Tensors as leaves.  Raises FastGSError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with _opened(path) as archive:
            self.length = path.stat().st_size
            names = [n for n in archive.namelist() if n == "data.pkl" or n.endswith("/data.pkl")]
            if len(names) != 1:
                raise FastGSError("it is a zip file, but none that PyTorch saved.")
            self.root = names[0].removesuffix("data.pkl")
            self.sizes = {i.filename: i.file_size for i in archive.infolist()}
            order = self._member(archive, "byteorder", 16) if self.root + "byteorder" in self.sizes else b"little"
            damaged_if(order not in (b"little", b"big"), "its byte order is unknown")
            self.order = "<" if order == b"little" else ">"
            program = self._member(archive, "data.pkl", MAX_PICKLE)
        self.content = _Machine(self).run(program)

    def _member(self, archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
        info = archive.getinfo(self.root + name)
        if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
            raise FastGSError("its parts are compressed or encrypted, which PyTorch never does.")
        damaged_if(info.file_size > min(limit, self.length), f"its part {name!r} is too large")
        return read_member(archive, info)

    def storage(self, storage: _Storage) -> np.ndarray:
        """The numbers of one storage, flat."""
        with _opened(self.path) as archive:
            data = self._member(archive, f"data/{storage.key}", 1 << 62)
        if storage.code == "bf2":
            return (np.frombuffer(data, self.order + "u2", len(data) // 2).astype(np.uint32) << 16).view(np.float32)
        dtype = np.dtype(self.order + storage.code)
        return np.frombuffer(data, dtype, len(data) // dtype.itemsize)

    def tensor(self, storage: Any, offset: Any, shape: Any, stride: Any) -> Tensor:
        """A tensor, checked against its storage's true size."""
        dims = (shape, stride)
        _expect(isinstance(storage, _Storage) and all(isinstance(d, tuple) and len(d) <= 16 for d in dims) and len(shape) == len(stride))
        _expect(all(type(v) is int and 0 <= v < 2**48 for v in (offset, *shape, *stride)))
        count = self.sizes.get(f"{self.root}data/{storage.key}", 0) // int(storage.code[-1])
        elements = last = 1
        for n, step in zip(shape, stride, strict=True):
            elements *= n
            last += (n - 1) * step
        if elements and (offset + last > count or elements > max(count, 1 << 16)):  # expanded tensors repeat few numbers
            raise FastGSError("a tensor in it is larger than its numbers; the file is damaged.")
        return Tensor(self, storage, offset if elements else 0, shape, stride)


def content_or_none(head: bytes, path: Path) -> Any:
    """What PyTorch saved in a file; None for any other file and for a damaged one.  head: the file's first bytes."""
    if not head.startswith(b"PK\x03\x04"):
        return None
    try:
        return TorchFile(path).content
    except FastGSError:
        return None


def of_pipeline(content: object, prefix: str) -> dict[str, Tensor]:
    """The tensors of a nerfstudio checkpoint's pipeline whose names begin so, by the rest of their names."""
    pipeline = content.get("pipeline") if isinstance(content, dict) else None
    return {name.removeprefix(prefix): value for name, value in (pipeline.items() if isinstance(pipeline, dict) else ())
            if isinstance(name, str) and name.startswith(prefix) and isinstance(value, Tensor)}


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The zip file; its many ways to fail become one."""
    try:
        with opened_zip(path) as archive:
            yield archive
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError, KeyError, EOFError, OverflowError, struct.error) as error:
        raise FastGSError("it is no intact zip file; copy it again (files of PyTorch before 1.6 must be saved anew).") from error


def _expect(good: bool) -> None:
    if not good:
        raise FastGSError(f"{REFUSED}.")


def _check_size(value: object) -> None:
    """Raises FastGSError for tables that contain themselves, or one another so often that nobody could walk through them."""
    sizes: dict[int, int] = {}  # by id(): all tables live as long as `value`
    around: set[int] = set()
    stack = [value] if isinstance(value, TABLES) else []
    while stack:
        table = stack[-1]
        inside = [v for v in (table.values() if isinstance(table, dict) else table) if isinstance(v, TABLES)]
        unknown = [each for each in inside if id(each) not in sizes]
        if unknown:
            around.add(id(table))
            _expect(around.isdisjoint(map(id, unknown)))
            stack += unknown
        else:
            stack.pop()
            around.discard(id(table))
            sizes[id(table)] = 1 + len(table) + sum(sizes[id(each)] for each in inside)
            _expect(sizes[id(table)] <= MOST_VALUES)


def _numpy(name: str, arguments: tuple) -> Any:
    """A type, the bytes of a number, or the number."""
    if name == "numpy.dtype":
        _expect(bool(arguments) and arguments[0] in ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "b1"))
        return _Type(arguments[0])
    if name == "_codecs.encode":
        _expect(len(arguments) == 2 and type(arguments[0]) is str and len(arguments[0]) <= 64 and arguments[1] == "latin1")
        return arguments[0].encode("latin1", "replace")
    _expect(len(arguments) == 2 and isinstance(arguments[0], _Type) and type(arguments[1]) is bytes)
    _expect(len(arguments[1]) == int(arguments[0].code[1]))
    return np.frombuffer(arguments[1], "<" + arguments[0].code)[0].item()


class _Machine:
    """Runs the instructions of a pickle that build dicts, lists, tuples, numbers, texts and tensors."""

    MARK = object()
    VALUES = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
    LITERALS = ("BINUNICODE", "SHORT_BINUNICODE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT")

    def __init__(self, file: TorchFile) -> None:
        self.file, self.stack, self.memo = file, list[Any](), dict[int, Any]()

    def run(self, program: bytes) -> Any:
        """What the pickle describes; raises FastGSError for any other instruction.  Instructions are taken apart, never executed."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # of escapes in names, which are refused anyway
                for opcode, argument, _ in pickletools.genops(program):
                    self._step(opcode.name, argument)
            _expect(len(self.stack) == 1)
            _check_size(self.stack[0])
            return self.stack[0]
        except (ValueError, IndexError, KeyError, TypeError, OverflowError) as error:
            raise FastGSError("the pickle in it is damaged; copy the file again.") from error

    def _step(self, name: str, argument: Any) -> None:
        stack, push = self.stack, self.stack.append
        if name in self.LITERALS:
            push(argument)
        elif name in self.VALUES:
            push(self.VALUES[name])
        elif name == "MARK":
            push(self.MARK)
        elif name in ("BINPUT", "LONG_BINPUT"):
            self.memo[argument] = stack[-1]
        elif name == "MEMOIZE":
            self.memo[len(self.memo)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            push(self.memo[argument])
        elif name in ("EMPTY_DICT", "EMPTY_LIST", "EMPTY_TUPLE"):
            push({"EMPTY_DICT": {}, "EMPTY_LIST": [], "EMPTY_TUPLE": ()}[name])
        elif name == "TUPLE":
            push(tuple(self._marked()))
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            push(tuple(self._pop(int(name[-1]))))
        elif name in ("APPEND", "APPENDS"):
            items = self._pop(1) if name == "APPEND" else self._marked()
            _expect(type(stack[-1]) is list)
            stack[-1].extend(items)
        elif name in ("SETITEM", "SETITEMS"):
            self._set(self._pop(2) if name == "SETITEM" else self._marked())
        elif name in ("GLOBAL", "STACK_GLOBAL"):
            push(_Global(argument.replace(" ", ".") if name == "GLOBAL" else ".".join(self._pop(2))))
        elif name == "BINPERSID":
            push(self._storage(*self._pop(1)))
        elif name == "REDUCE":
            push(self._call(*self._pop(2)))
        elif name == "BUILD":
            state = self._pop(1)[0]  # attributes of a state dict: versions of modules
            _expect(type(stack[-1]) is dict or (isinstance(stack[-1], _Type) and type(state) is tuple and state[1:2] in (("<",), ("|",))))
        else:
            _expect(name in ("PROTO", "FRAME", "STOP"))

    def _pop(self, count: int) -> list:
        items = self.stack[-count:]
        if len(items) < count:
            raise IndexError
        del self.stack[-count:]
        return items

    def _marked(self) -> list:
        """Pop what lies above the last mark, and the mark."""
        at = len(self.stack) - 1
        while self.stack[at] is not self.MARK:
            at -= 1
            if at < 0:
                raise IndexError
        items = self.stack[at + 1:]
        del self.stack[at:]
        return items

    def _set(self, items: list) -> None:
        _expect(type(self.stack[-1]) is dict and len(items) % 2 == 0 and all(type(key) in (str, int) for key in items[::2]))
        self.stack[-1].update(zip(items[::2], items[1::2], strict=True))

    def _storage(self, identity: Any) -> _Storage:
        _expect(type(identity) is tuple and len(identity) == 5 and identity[0] == "storage")
        _, kind, key, _, _ = identity
        name = kind.name.removeprefix("torch.") if isinstance(kind, _Global) else ""
        _expect(name in STORAGES and type(key) is str and f"{self.file.root}data/{key}" in self.file.sizes)
        return _Storage(key, STORAGES[name])

    def _call(self, function: Any, arguments: Any) -> Any:
        _expect(isinstance(function, _Global) and type(arguments) is tuple)
        if function.name == "collections.OrderedDict" and not arguments:
            return {}
        if function.name in ("torch._utils._rebuild_tensor", "torch._utils._rebuild_tensor_v2") and len(arguments) >= 4:
            return self.file.tensor(*arguments[:4])
        if function.name in NUMPY:
            return _numpy(function.name, arguments)
        _expect(function.name == "torch._utils._rebuild_parameter" and arguments and isinstance(arguments[0], Tensor))
        return arguments[0]


def write(path: Path, tensors: Mapping[str, np.ndarray]) -> None:
    """Write a state dict of float32 tensors that torch.load(path, weights_only=True) reads."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        def add(name: str, data: bytes) -> None:
            info = zipfile.ZipInfo(f"archive/{name}")  # dated 1980: the same tensors give the same bytes
            info.create_system = 0
            archive.writestr(info, data)

        add("data.pkl", _program(tensors))
        add("byteorder", b"little")
        for key, tensor in enumerate(tensors.values()):
            add(f"data/{key}", np.ascontiguousarray(tensor, "<f4").tobytes())
        add("version", b"3\n")


def _program(tensors: Mapping[str, np.ndarray]) -> bytes:
    """The pickle of OrderedDict(name=_rebuild_tensor_v2(storage, 0, shape, stride, False, OrderedDict()), ...)."""
    def text(value: str) -> bytes:
        data = value.encode()
        return b"X" + struct.pack("<I", len(data)) + data

    def numbers(values: Iterable[int]) -> bytes:
        return b"(" + b"".join(b"J" + struct.pack("<i", v) for v in values) + b"t"

    empty = b"ccollections\nOrderedDict\n)R"
    program = b"\x80\x02" + empty + b"("
    for key, (name, tensor) in enumerate(tensors.items()):
        stride = np.cumprod([1, *tensor.shape[:0:-1]])[::-1][:tensor.ndim]
        size = b"J" + struct.pack("<i", tensor.size)
        storage = b"(" + text("storage") + b"ctorch\nFloatStorage\n" + text(str(key)) + text("cpu") + size + b"tQ"
        program += (text(name) + b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + b"K\0" + numbers(tensor.shape) + numbers(stride)
                    + b"\x89" + empty + b"tR")
    return program + b"u."
