# SPDX-License-Identifier: GPL-3.0-or-later
"""A bounded reader of PLY files (ascii, binary of both byte orders) and a writer of binary ones.

Nothing is allocated on the word of a header: counts are checked against the file's length first.
"""
from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import BinaryIO

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import open_file
from ..util.threads import ranges, run

MAX_HEADER = 1 << 20
"""Bytes.  The longest header we write has some 70 KB."""
MAX_ELEMENTS = 1000
MAX_WALKED = 10_000_000
"""Values and lists, in all elements together, that are walked one by one to find the vertices behind them."""
BLOCK = 1 << 22
"""Bytes read at a time."""

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}
FOREIGN = ("scalar_scal_", "scalar_", "scal_")
"""What CloudCompare, and the converter 3dgsconverter for it, put before the names of columns that no plain point cloud has."""
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """A column: its numpy type code, and that of the count in front of it where it is a list."""

    name: str
    code: str
    count_code: str = ""


@dataclass(frozen=True)
class Element:
    """A table of `count` rows."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The columns' names, in order."""
        return tuple(p.name for p in self.properties)

    @property
    def has_lists(self) -> bool:
        """Whether the rows differ in length."""
        return any(p.count_code for p in self.properties)

    def row(self, order: str) -> np.dtype:
        """One row, of an element without lists."""
        return np.dtype([(p.name, order + p.code) for p in self.properties])


@dataclass(frozen=True)
class Header:
    """order '' (ascii), '<' or '>'; size in bytes, up to where the first row begins."""

    order: str
    comments: tuple[str, ...]
    elements: tuple[Element, ...]
    size: int

    @property
    def vertex(self) -> Element:
        """The element named vertex, or an empty one."""
        return next((e for e in self.elements if e.name == "vertex"), Element("vertex", 0, ()))

    @property
    def names(self) -> frozenset[str]:
        """The names of the vertices' columns."""
        return frozenset(self.vertex.names)


def read_header(path: Path) -> Header:
    """The header of a PLY file; raises FastGSError for a broken one."""
    with open_file(path) as stream:
        head = stream.read(MAX_HEADER)
    lines, size = [], 0
    while size < len(head):
        end = head.find(b"\n", size)
        if end < 0:
            break
        line = head[size:end].decode("utf-8", "replace").strip()
        size = end + 1
        if line == "end_header":
            return _parse(lines, size)
        lines.append(line)
    if len(head) == MAX_HEADER:
        raise FastGSError("its PLY header does not end within 1 MB; the file is damaged.")
    raise FastGSError("its PLY header is cut short; copy or export the file again.")


def _parse(lines: list[str], size: int) -> Header:
    order, comments, elements, columns = None, [], {}, None
    for number, line in enumerate(lines):
        key, *words = line.split() or [""]
        try:
            if number == 0:
                _expect(line == "ply")
            elif key == "comment":
                comments.append(line.removeprefix("comment").strip())
            elif key == "format":
                _expect(order is None)
                order = ORDERS[words[0]]
            elif key == "element":
                name, count = words
                _expect(count.isascii() and count.isdigit() and len(count) < 19 and name not in elements)
                columns = {}
                elements[name] = (int(count), columns)
                if len(elements) > MAX_ELEMENTS:
                    raise FastGSError(f"its PLY header names more than {MAX_ELEMENTS} elements; the file is damaged.")
            elif key == "property":
                prop = _property(words)
                _expect(columns is not None and prop.name not in columns)
                columns[prop.name] = prop
            else:
                _expect(key in ("obj_info", ""))
        except (KeyError, IndexError, ValueError) as error:
            raise FastGSError(f"line {number + 1} of its PLY header makes no sense: {line[:60]!r}.") from error
    if order is None:
        raise FastGSError("its PLY header names no format.")
    return Header(order, tuple(comments), tuple(Element(n, c, _named(p.values())) for n, (c, p) in elements.items()), size)


def _expect(good: bool) -> None:
    if not good:
        raise ValueError


def _property(words: list[str]) -> Property:
    if words[0] == "list":
        _, count, item, name = words
        _expect(TYPES[count][0] in "iu")
        return Property(name, TYPES[item], TYPES[count])
    kind, name = words
    return Property(name, TYPES[kind])


def _named(properties: Iterable[Property]) -> tuple[Property, ...]:
    """The columns under the names that they had before another program put something in front of them, where these are free."""
    properties = tuple(properties)
    names = {p.name for p in properties}
    found = []
    for prop in properties:
        prefix = next((each for each in FOREIGN if prop.name.startswith(each)), "")
        own = prop.name.removeprefix(prefix)
        taken = not prefix or not own or own in names
        names.add(own)
        found.append(prop if taken else replace(prop, name=own))
    return tuple(found)


def read_vertices(path: Path, header: Header, groups: Mapping[str, Sequence[str]]) -> dict[str, np.ndarray]:
    """Columns of the vertices, in one pass over the file: for each group of names an array [N, len(names)] float32.

    Raises FastGSError where the file is shorter or longer than its header says, or holds lists among the vertices.
    """
    vertex, place = header.vertex, {name: i for i, name in enumerate(header.vertex.names)}
    columns = {key: np.array([place[name] for name in names], np.intp) for key, names in groups.items()}
    if vertex.has_lists:
        raise FastGSError("its vertices have list properties, which Gaussians never have.")
    with open_file(path) as stream:
        length = stream.seek(0, 2)
        stream.seek(header.size)
        if header.order:
            begin, row = _checked_binary(stream, header, length), vertex.row(header.order)
        else:
            blocks = _ascii_blocks(stream, header, length)
            next(blocks)  # the checks, before anything is allocated
        out = {key: np.empty((vertex.count, len(names)), np.float32) for key, names in groups.items()}
        if not header.order:
            at = 0
            for block in blocks:
                with np.errstate(over="ignore", invalid="ignore"):
                    for key, index in columns.items():
                        out[key][at:at + len(block)] = block[:, index]
                at += len(block)
            return out
        plain, reader = {p.code for p in vertex.properties} == {"f4"}, Lock()

        def read(first: int, last: int) -> None:
            with reader:
                stream.seek(begin + first * row.itemsize)
                data = stream.read((last - first) * row.itemsize)
            if len(data) != (last - first) * row.itemsize:
                raise _cut_short(header)
            if plain:
                block = np.frombuffer(data, header.order + "f4").reshape(last - first, -1).astype(np.float32, copy=False)
                for key, index in columns.items():
                    np.take(block, index, axis=1, out=out[key][first:last], mode="clip")  # no index is cut; other modes copy once more
                return
            block = np.frombuffer(data, row)
            with np.errstate(over="ignore", invalid="ignore"):
                for key, names in groups.items():
                    for i, name in enumerate(names):
                        out[key][first:last, i] = block[name]

        run(read, ranges(vertex.count, max(1, BLOCK // row.itemsize)))
    return out


def _cut_short(header: Header) -> FastGSError:
    return FastGSError(f"the file is cut short: its header promises {header.vertex.count} vertices, which it is too small to hold; "
                       "copy or export it again.")


def _split(header: Header) -> tuple[tuple[Element, ...], tuple[Element, ...]]:
    """The elements before the vertices, and those after."""
    at = header.elements.index(header.vertex)
    return header.elements[:at], header.elements[at + 1:]


def _checked_binary(stream: BinaryIO, header: Header, length: int) -> int:
    """Where the vertices begin, when all is checked."""
    before, after = _split(header)
    _check_work(element for element in before if element.has_lists)
    for element in before:
        if element.has_lists:
            _walk_lists(stream, element, header, length)
        else:
            place = stream.tell() + element.count * element.row(header.order).itemsize
            if place > length:
                raise _cut_short(header)
            stream.seek(place)
    begin = stream.tell()
    end = begin + header.vertex.count * header.vertex.row(header.order).itemsize
    for element in after:
        if element.has_lists:
            break
        end += element.count * element.row(header.order).itemsize
    else:
        if end < length:
            stream.seek(end)
            _check_rest(stream.read(4097))
    if end > length:
        raise _cut_short(header)
    return begin


def _check_rest(rest: bytes) -> None:
    if len(rest) > 4096 or rest.strip(b" \t\r\n\0"):
        raise FastGSError("there is more in the file than its header says; it is damaged or was not copied as binary, so copy it again.")


def _check_work(elements: Iterable[Element]) -> None:
    """Raises FastGSError where the rows before the vertices are more than are walked one by one."""
    values = sum(element.count * len(element.properties) for element in elements)
    if values > MAX_WALKED:
        raise FastGSError(f"{values} values of other elements stand before its vertices; at most {MAX_WALKED} are read, so write the "
                          "vertices first.")


def _walk_lists(stream: BinaryIO, element: Element, header: Header, length: int) -> None:
    """Skip the rows of an element with lists."""
    order = "big" if header.order == ">" else "little"
    steps = [(int(p.count_code[1:] or 0), p.count_code.startswith("i"), int(p.code[1:])) for p in element.properties]
    for _ in range(element.count):
        for count_size, signed, size in steps:
            count = 1
            if count_size:
                raw = stream.read(count_size)
                count = int.from_bytes(raw, order, signed=signed)
                if len(raw) < count_size or count < 0:
                    raise _cut_short(header)
            stream.seek(count * size, 1)
        if stream.tell() > length:
            raise _cut_short(header)


class _Tokens:
    """The words of a stream, a piece at a time."""

    def __init__(self, stream: BinaryIO):
        self.stream, self.words, self.at, self.tail = stream, [], 0, b""

    def take(self, count: int) -> list[bytes]:
        """The next `count` words, fewer at the end of the file."""
        while len(self.words) - self.at < count:
            piece = self.stream.read(BLOCK)
            text = self.tail + piece
            words = text.split()
            self.tail = words.pop() if piece and words and not text[-1:].isspace() else b""
            if len(self.tail) > 4096:
                raise FastGSError("there is a number of more than 4096 characters in it; the file is damaged.")
            self.words, self.at = self.words[self.at:] + words, 0
            if not piece:
                break
        self.at += count
        return self.words[self.at - count:self.at]


def _ascii_blocks(stream: BinaryIO, header: Header, length: int) -> Iterator[np.ndarray | None]:
    """First None, when all is checked; then arrays [rows, columns] float64."""
    before, after = _split(header)
    _check_work(before)
    vertex, width = header.vertex, len(header.vertex.properties)
    if 2 * sum(e.count * len(e.properties) for e in header.elements) > length - header.size + 1:
        raise _cut_short(header)  # every number is a digit and a space at least
    yield None
    tokens = _Tokens(stream)
    for element in before:
        _skip_words(tokens, element, header)
    step = max(1, BLOCK // 16 // max(1, width))
    for start in range(0, vertex.count, step):
        rows = min(step, vertex.count - start)
        words = tokens.take(rows * width)
        if len(words) != rows * width:
            raise _cut_short(header)
        try:
            yield np.array([float(w) for w in words]).reshape(rows, width)
        except ValueError as error:
            raise FastGSError("there is something among its vertices that is not a number; the file is damaged.") from error
    if not after:
        _check_rest(b"".join(tokens.take(1)))


def _skip_words(tokens: _Tokens, element: Element, header: Header) -> None:
    for _ in range(element.count if element.properties else 0):
        for prop in element.properties:
            count = 1
            if prop.count_code:
                word = b"".join(tokens.take(1))
                if not word.isdigit() or len(word) > 9:
                    raise _cut_short(header)
                count = int(word)
            while count:  # a piece at a time, for the count may be a lie
                taken = len(tokens.take(min(count, 100_000)))
                if not taken:
                    raise _cut_short(header)
                count -= taken


def write(path: Path, comments: Sequence[str], columns: Sequence[tuple[Sequence[str], np.ndarray]]) -> None:
    """Write vertices as little-endian floats; columns: names and array [N, len(names)], in the file's order."""
    names = [name for group, _ in columns for name in group]
    count = len(columns[0][1])
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments), f"element vertex {count}",
             *(f"property float {name}" for name in names), "end_header", ""]
    header = "\n".join(lines).encode("ascii")
    if len(header) > MAX_HEADER:
        raise FastGSError(f"a PLY with {len(names)} columns is more than readers take; save it as .safetensors.")
    step = max(1, BLOCK // (4 * len(names)))
    with open(path, "wb") as stream:
        stream.write(header)
        for start in range(0, count, step):
            rows = [array[start:start + step] for _, array in columns]
            stream.write(np.ascontiguousarray(np.concatenate(rows, 1), "<f4").tobytes())
