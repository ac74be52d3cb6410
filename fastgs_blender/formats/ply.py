# SPDX-License-Identifier: GPL-3.0-or-later
"""A bounded reader of PLY files (ascii, binary of both byte orders) and a writer of binary ones.

Nothing is allocated on the word of a header: counts are checked against the file's length first.
"""
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO, Literal

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import damaged_if, open_file
from ..util.threads import ranges, run

MAX_HEADER = 1 << 20
"""Bytes.  The longest header we write has some 70 KB."""
MAX_ELEMENTS = 1000
MAX_WALKED = 10_000_000
"""Values and lists, in all elements together, that are walked one by one to find the vertices behind them."""
LONGEST_LINE = 1 << 20
"""Bytes."""
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
    lines, size = list[str](), 0
    while size < len(head):
        end = head.find(b"\n", size)
        if end < 0:
            break
        line = head[size:end].decode("utf-8", "replace").strip()
        size = end + 1
        if line == "end_header":
            return _parse(lines, size)
        lines.append(line)
    damaged_if(len(head) == MAX_HEADER, "its PLY header does not end within 1 MB")
    raise FastGSError("its PLY header is cut short; copy or export the file again.")


def _parse(lines: list[str], size: int) -> Header:
    order, comments, elements, columns = None, [], {}, dict[str, Property]()
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
                damaged_if(len(elements) > MAX_ELEMENTS, f"its PLY header names more than {MAX_ELEMENTS} elements")
            elif key == "property":
                prop = _property(words)
                _expect(bool(elements) and prop.name not in columns)
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


def read_vertices(path: Path, header: Header, groups: Mapping[str, Sequence[str] | str]) -> dict[str, Any]:
    """Columns of the vertices, in one pass over the file: for each group of names an array [N, len(names)] float32, for one name [N].

    Raises FastGSError where columns are missing, or the file is shorter or longer than its header says, or holds lists among the vertices.
    """
    vertex, place = header.vertex, {name: i for i, name in enumerate(header.vertex.names)}
    named = {key: (names,) if isinstance(names, str) else names for key, names in groups.items()}
    missing = [name for names in named.values() for name in names if name not in place]
    if missing:
        raise FastGSError(f"its columns {', '.join(missing[:12])} are missing; export it again.")
    if vertex.has_lists:
        raise FastGSError("its vertices have list properties, which Gaussians never have.")
    columns = {key: np.array([place[name] for name in names], np.intp) for key, names in named.items()}
    with open_file(path) as stream:
        length = stream.seek(0, 2)
        stream.seek(header.size)
        if header.order:
            begin, row = _checked_binary(stream, header, length), vertex.row(header.order)
        elif 2 * sum(e.count * len(e.properties) for e in header.elements) > length - header.size + 1:
            raise _cut_short(header)  # every number is a digit and a space at least
        out = {key: np.empty((vertex.count, len(names)), np.float32) for key, names in named.items()}
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
            table = np.frombuffer(data, row)
            with np.errstate(over="ignore", invalid="ignore"):
                for key, names in named.items():
                    for i, name in enumerate(names):
                        out[key][first:last, i] = table[name]

        if header.order:
            run(read, ranges(vertex.count, max(1, BLOCK // row.itemsize)))
        else:
            for first, block in _text_blocks(stream, header):
                with np.errstate(over="ignore", invalid="ignore"):
                    for key, index in columns.items():
                        out[key][first:first + len(block)] = block[:, index]
    return {key: out[key][:, 0] if isinstance(names, str) else out[key] for key, names in groups.items()}


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
    values = sum(element.count * len(element.properties) for element in before if element.has_lists)
    if values > MAX_WALKED:
        raise FastGSError(f"{values} values of other elements stand before its vertices; at most {MAX_WALKED} are read, so write the "
                          "vertices first.")
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


def _walk_lists(stream: BinaryIO, element: Element, header: Header, length: int) -> None:
    """Skip the rows of an element with lists."""
    order: Literal["big", "little"] = "big" if header.order == ">" else "little"
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


def _text_blocks(stream: BinaryIO, header: Header) -> Iterator[tuple[int, np.ndarray]]:
    """Pieces of the vertices of a file in text, a row a line: number of the first one, and an array [rows, columns] float64."""
    before, after = _split(header)
    lines = (line for line in iter(lambda: stream.readline(LONGEST_LINE), b"") if line.strip())
    for element in before:
        deque(islice(lines, element.count if element.properties else 0), maxlen=0)
    vertex, width = header.vertex, len(header.vertex.properties)
    step = max(1, BLOCK // 16 // max(1, width))
    for first in range(0, vertex.count, step):
        rows = list(islice(lines, min(step, vertex.count - first)))
        if len(rows) < min(step, vertex.count - first):
            raise _cut_short(header)
        try:
            yield first, np.loadtxt(rows, comments=None, ndmin=2).reshape(len(rows), width)
        except ValueError as error:
            raise FastGSError("a row of its vertices is not as its header says, or no numbers; copy the file again.") from error
    if not after:
        _check_rest(stream.read(4097))


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
