# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads what OpenCV's FileStorage writes: `%YAML:1.0` files and `<opencv_storage>` XML (docs.opencv.org, "XML/YAML/JSON Persistence").

Of YAML, the part that FileStorage uses: block and flow mappings and sequences, numbers, texts, tags, comments.  A mapping with rows, cols
and data is a matrix, whether or not it is tagged !!opencv-matrix (ROS writes them without).
"""
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import read_bytes, reading
from ..util.xml_files import plain_xml

LARGEST_FILE = 16 << 20
MOST_DEEP = 32
ENDINGS = (".yml", ".yaml", ".xml")
_KEY = re.compile(r"""("(?:[^"\\]|\\.)*"|'[^']*'|[^\s:#{}\[\],"'][^:#{}\[\]"']*?)\s*:(?=\s|$)""")
_REMARK = re.compile(r"""(?<=\s)#(?=[^"']*$).*$""")
_FLOW = re.compile(r"""\s*([\[\]{},]|"(?:[^"\\]|\\.)*"|'(?:[^']|'')*'|:(?=\s)|[^\s\[\]{},:][^\[\]{},\n]*?(?=\s*(?:[\[\]{},\n]|:\s|$)))""")


def read_storage(path: Path) -> dict[str, Any]:
    """The values in a file by name: numbers, texts, lists, dicts, and float64 matrices [rows, cols]; raises FastGSError."""
    with reading(path, "it is no file of OpenCV's FileStorage, or is cut short; export the calibration again"):
        try:
            if path.suffix.lower() == ".xml":
                found = _xml(path)
            else:
                found = _Yaml(read_bytes(path, LARGEST_FILE).decode("utf-8-sig")).document()
        except RecursionError as error:
            raise ValueError("it is nested too deeply") from error
    if not isinstance(found, dict):
        raise FastGSError(f"{path}: it does not hold named values; export the calibration again.")
    return found


def _xml(path: Path) -> Any:
    root = plain_xml(path, LARGEST_FILE)
    if root.tag != "opencv_storage":
        raise FastGSError(f"{path}: it begins with <{root.tag}> instead of <opencv_storage>, so it is no calibration of OpenCV's.")
    return _element(root, 0)


def _element(element: ET.Element, depth: int) -> Any:
    """Named children are a dict, children called _ a list, else the text: one value, or a list of numbers."""
    if depth > MOST_DEEP:
        raise ValueError("it is nested too deeply")
    children = list(element)
    if children and all(child.tag == "_" for child in children):
        return [_element(child, depth + 1) for child in children]
    if children:
        return _folded({child.tag: _element(child, depth + 1) for child in children})
    text = (element.text or "").strip()
    if text.startswith('"'):
        return text.strip('"')
    values = [_scalar(part) for part in text.split()]
    return values[0] if len(values) == 1 else values if values and not any(isinstance(v, str) for v in values) else text


def _folded(table: dict) -> Any:
    """A mapping, or the matrix that it describes."""
    if not {"rows", "cols", "data"} <= set(table):
        return table
    rows, cols, data = table["rows"], table["cols"], table["data"]
    data = data if isinstance(data, list) else [data]
    if not all(isinstance(n, int) and n > 0 for n in (rows, cols)) or rows * cols != len(data):
        raise ValueError(f"a matrix says that it has {rows} x {cols} numbers, and has {len(data)}")
    return np.array(data, np.float64).reshape(rows, cols)


def _scalar(text: str) -> Any:
    """A number, or the text as it is; .Inf and .Nan are YAML's."""
    if text[:1] in {'"', "'"}:
        return text[1:-1]
    plain = text.lower().lstrip("+-")
    if plain in {".inf", ".nan"}:
        return float(text.replace(".", "", 1))
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


class _Yaml:
    """A parser of one document, line by line; raises ValueError with the number of the line."""

    def __init__(self, text: str) -> None:
        self.lines: list[tuple[int, int, str]] = []  # number, indentation, content; flow values joined with the lines after them
        open_since = 0
        for number, line in enumerate(text.splitlines(), 1):
            content = _REMARK.sub("", line).strip()
            if not open_since and (not content or content.startswith(("#", "%", "---")) or content == "..."):
                continue
            if open_since:
                number_before, indent, before = self.lines[-1]
                self.lines[-1] = number_before, indent, f"{before} {content}" if len(before) < LARGEST_FILE else before
            else:
                self.lines.append((number, len(line) - len(line.lstrip(" ")), content))
                self._balance = 0
            self._balance += _brackets(content)
            open_since = self._balance > 0
        if open_since:
            raise ValueError("a bracket is never closed")
        self.at = 0

    def document(self) -> Any:
        if not self.lines:
            return {}
        found = self._block(self.lines[0][1], 0)
        if self.at < len(self.lines):
            raise ValueError(f"line {self.lines[self.at][0]} does not belong to what is above it")
        return found

    def _block(self, indent: int, depth: int) -> Any:
        """The mapping or sequence whose lines are indented so far."""
        if depth > MOST_DEEP:
            raise ValueError("it is nested too deeply")
        table: dict = {}
        items: list = []
        while self.at < len(self.lines) and self.lines[self.at][1] == indent:
            number, _, content = self.lines[self.at]
            if content == "-" or content.startswith("- "):
                rest = content[1:].strip()
                if _KEY.match(rest):  # a mapping that begins beside its dash
                    inner = indent + len(content) - len(rest)
                    self.lines[self.at] = number, inner, rest
                    items.append(self._block(inner, depth + 1))
                    continue
                self.at += 1
                items.append(self._value(rest, indent, depth, number))
                continue
            key = _KEY.match(content)
            if key is None:
                raise ValueError(f"line {number} has no name before a colon")
            self.at += 1
            table[str(_scalar(key.group(1)))] = self._value(content[key.end():].strip(), indent, depth, number)
        if table and items:
            raise ValueError(f"line {number} mixes a list with named values")
        return items or _folded(table)

    def _value(self, text: str, indent: int, depth: int, number: int) -> Any:
        text = re.sub(r"^!{1,2}\S+\s*", "", text)
        if text:
            return _flow(text, number)
        if self.at < len(self.lines):
            _, inner, content = self.lines[self.at]
            if inner > indent or (inner == indent and content.startswith("-")):
                return self._block(inner, depth + 1)
        return ""


def _brackets(text: str) -> int:
    """How many brackets a line opens more than it closes, those in quotes apart."""
    bare = re.sub(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'', "", text)
    return sum(bare.count(c) for c in "[{") - sum(bare.count(c) for c in "]}")


def _flow(text: str, number: int) -> Any:
    """A scalar, or a value in brackets."""
    if text[0] not in "[{":
        return _scalar(text)
    tokens, at = [], 0
    while at < len(text):
        token = _FLOW.match(text, at)
        if token is None:
            if text[at:].strip():
                raise ValueError(f"line {number} cannot be understood at {text[at:at + 20].strip()!r}")
            break
        tokens.append(token.group(1))
        at = token.end()
    value, end = _flow_value(tokens, 0, 0, number)
    if end != len(tokens):
        raise ValueError(f"line {number} goes on after its bracket is closed")
    return value


def _flow_value(tokens: list[str], at: int, depth: int, number: int) -> tuple[Any, int]:
    if depth > MOST_DEEP or at >= len(tokens):
        raise ValueError(f"line {number} is nested too deeply or cut short")
    if tokens[at] not in {"[", "{"}:
        if tokens[at] in {"]", "}", ",", ":"}:
            raise ValueError(f"line {number} has {tokens[at]!r} where a value should be")
        return _scalar(tokens[at]), at + 1
    table: dict = {}
    items: list = []
    close = "]" if tokens[at] == "[" else "}"
    at += 1
    while at < len(tokens) and tokens[at] != close:
        if close == "]":
            item, at = _flow_value(tokens, at, depth + 1, number)
            items.append(item)
        else:
            key, colon, rest = tokens[at].partition(":")
            if tokens[at + 1:at + 2] == [":"]:
                table[str(_scalar(tokens[at]))], at = _flow_value(tokens, at + 2, depth + 1, number)
            elif key and colon and rest:  # FileStorage writes x:1. in brackets
                table[key], at = _scalar(rest), at + 1
            else:
                raise ValueError(f"line {number} has no colon after {tokens[at][:20]!r}")
        if at < len(tokens) and tokens[at] == ",":
            at += 1
        elif at < len(tokens) and tokens[at] != close:
            raise ValueError(f"line {number} lacks a comma before {tokens[at][:20]!r}")
    if at >= len(tokens):
        raise ValueError(f"line {number} has a bracket that is never closed")
    return (items if close == "]" else _folded(table)), at + 1
