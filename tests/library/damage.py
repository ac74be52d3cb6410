# SPDX-License-Identifier: GPL-3.0-or-later
"""Changes a file's content at random, byte by byte and by the structure of its kind (text, JSON, PLY, safetensors, zip, PNG, ...)."""
from __future__ import annotations

import contextlib
import gzip
import io
import json
import random
import re
import struct
import warnings
import zipfile
import zlib

INTEGERS = (0, 1, -1, 2, 127, 128, 255, 256, 32767, -32768, 65535, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, -(2**63), 2**64 - 1, 10**9)
FLOATS = (float("nan"), float("inf"), -float("inf"), -0.0, 3.4e38, -3.4e38, 1e-45, 1e18, 1e300, -1.0)
WORDS = (b"nan", b"inf", b"-1", b"0", b"1e400", b"-1e400", b"99999999999", b"9" * 30, b"1e308", b"", b" ", b"\n", b"\0", b"\xff\xfe", b"{",
         b"[" * 3000, b'"', b"/", b"../..", b"%s", b"true", b"None", b"\x1b[31m", "é漢".encode(), b"\xed\xb3\xbf", b"-")
NAMES = ("", "/", ".", "..", "\udcff", "a\x1b]0;x\x07b", "\0", "a" * 5000, "C:\\x", "%n", "NaN", "é漢")
RAW = ("1e999", "-1e999", "NaN", "Infinity", "1" + "0" * 400, "-0", "1e-400", "9223372036854775808", "0.1e1", "[" * 50 + "]" * 50)


def mutated(data: bytes, draw: random.Random, others: list[bytes] = ()) -> bytes:
    """The content changed in one to four places, by its structure where it has one that is known."""
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        ways = [_bytes, *(way for knows, way in STRUCTURES if knows(data))]
        data = draw.choice(ways)(data, draw, others)
    return data


def _place(draw: random.Random, length: int) -> int:
    """A place in the content, more of them near its beginning, where headers are."""
    return int(draw.random() ** draw.choice((1, 2, 4)) * length)


def _number(draw: random.Random) -> bytes:
    order = draw.choice("<>")
    if draw.random() < 0.5:
        size = draw.choice((1, 2, 4, 8))
        return (draw.choice(INTEGERS) % 256**size).to_bytes(size, "little" if order == "<" else "big")
    code, value = draw.choice("efd"), draw.choice(FLOATS)
    with contextlib.suppress(OverflowError):
        return struct.pack(order + code, value)
    return struct.pack(order + code, float("inf"))


def _bytes(data: bytes, draw: random.Random, others) -> bytes:
    out = bytearray(data)
    at, length = _place(draw, len(out)), draw.choice((1, 1, 2, 4, 8, 16, 64, 1000))
    what = draw.choice(("flip", "flip", "set", "number", "number", "word", "delete", "repeat", "insert", "end", "swap", "splice", "zero"))
    if not out:
        out += draw.randbytes(length)
    elif what == "flip":
        out[at] ^= 1 << draw.randrange(8)
    elif what == "set":
        out[at] = draw.randrange(256)
    elif what in ("number", "word"):
        new = _number(draw) if what == "number" else draw.choice(WORDS)
        if what == "number" and draw.random() < 0.5:
            at = max(0, len(out) - -(-(len(out) - at) // len(new)) * len(new))  # where an array's number begins, if arrays end the file
        out[at:at + draw.choice((len(new), len(new), 0))] = new
    elif what == "delete":
        del out[at:at + length]
    elif what == "repeat":
        out[at:at] = out[at:at + length] * draw.choice((1, 1, 3, 100))
    elif what == "insert":
        out[at:at] = draw.randbytes(length)
    elif what == "end":
        del out[at:]
    elif what == "swap":
        other = _place(draw, len(out))
        out[at:at + length], out[other:other + length] = out[other:other + length], out[at:at + length]
    elif what == "splice" and others:
        source = draw.choice(others)
        begin = _place(draw, len(source))
        out[at:at + draw.choice((0, length))] = source[begin:begin + length]
    else:
        out[at:at + length] = bytes(len(out[at:at + length]))
    return bytes(out)


def _is_text(data: bytes) -> bool:
    return b"\n" in data and data.isascii() and b"\0" not in data


def _lines(data: bytes, draw: random.Random, others) -> bytes:
    """Text: a line or a word of it."""
    lines = data.split(b"\n")
    at = draw.randrange(len(lines))
    what = draw.choice(("delete", "repeat", "swap", "word", "word", "word", "many"))
    if what == "delete":
        del lines[at]
    elif what == "repeat":
        lines.insert(at, lines[at])
    elif what == "many":
        lines[at:at] = [lines[at]] * 2000
    elif what == "swap":
        other = draw.randrange(len(lines))
        lines[at], lines[other] = lines[other], lines[at]
    else:
        words = re.split(rb"([\s,;=:]+)", lines[at])
        place = draw.randrange(len(words))
        words[place] = draw.choice((*WORDS, *(str(i).encode() for i in INTEGERS), *(repr(v).encode() for v in FLOATS)))
        lines[at] = b"".join(words)
    return b"\n".join(lines)


def _is_json(data: bytes) -> bool:
    return data.lstrip(b" \t\r\n\xef\xbb\xbf")[:1] in (b"{", b"[") and _json(data) is not None


def _json(data):
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None


def _deep(tree, levels: int = 100) -> bool:
    """Whether lists lie in lists further than json.dumps() goes on every stack."""
    inner = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    return levels == 0 or any(_deep(each, levels - 1) for each in inner)


def _json_mutated(data: bytes, draw: random.Random, others) -> bytes:
    """JSON: a value, a key or an entry of it; and JSON in its texts."""
    tree = _json(data)
    if not tree or not isinstance(tree, (dict, list)) or _deep(tree):
        return draw.choice((b"null", b"[]", b"{}", b"1", b'"a"'))
    text = json.dumps(_changed_tree(tree, draw))
    text = re.sub(r'"\^raw:(.*?)\^"', r"\1", text)
    return re.sub(r"\^again\^", "", text).encode()


def _changed_tree(tree, draw: random.Random):
    node = tree
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = draw.choice(keys)
        inner = node[key]
        if isinstance(inner, (dict, list)) and inner and draw.random() < 0.75:
            node = inner
            continue
        if isinstance(inner, str) and _is_json(inner.encode("utf-8", "replace")) and draw.random() < 0.9:
            node[key] = _json_mutated(inner.encode("utf-8", "replace"), draw, []).decode()
            return tree
        break
    what = draw.choice(("value", "value", "value", "delete", "again", "rename", "add"))
    if what == "delete":
        del node[key]
    elif what == "again" and isinstance(node, dict):
        node[f"{key}^again^"] = _value(draw)  # the same key a second time
    elif what == "again":
        node[key:key] = [inner] * draw.choice((1, 3, 300))
    elif what == "rename" and isinstance(node, dict):
        node[draw.choice(NAMES)] = node.pop(key)
    elif what == "add":
        if isinstance(node, dict):
            node[draw.choice((*keys, "extra"))] = _value(draw)
        else:
            node.append(_value(draw))
    else:
        node[key] = draw.choice((_value(draw), [inner], {"a": inner}, str(inner)))
        if type(inner) is float or (type(inner) is int and abs(inner) < 2**63):
            node[key] = draw.choice((node[key], -inner, inner * 2, inner + 1, 0, inner * 1e30, inner + 0.5))
    return tree


def _value(draw: random.Random):
    return draw.choice((None, True, False, [], {}, [[]], {"": None}, [1, "a", None], *INTEGERS, 0.5, 1e308, -1e308, *NAMES,
                        *(f"^raw:{text}^" for text in RAW)))


def _is_safetensors(data: bytes) -> bool:
    return data[8:9] == b"{" and int.from_bytes(data[:8], "little") <= len(data) - 8


def _safetensors(data: bytes, draw: random.Random, others) -> bytes:
    size = int.from_bytes(data[:8], "little")
    text = _json_mutated(data[8:8 + size], draw, others)
    return len(text).to_bytes(8, "little") + text + data[8 + size:]


def _is_splatv(data: bytes) -> bool:
    return data[:4] == b"\x4b\x67\0\0" and len(data) > 8


def _splatv(data: bytes, draw: random.Random, others) -> bytes:
    size = int.from_bytes(data[4:8], "little")
    text = _json_mutated(data[8:8 + size], draw, others)
    return data[:4] + len(text).to_bytes(4, "little") + text + data[8 + size:]


def _is_ply(data: bytes) -> bool:
    return data.startswith(b"ply") and b"end_header\n" in data


def _ply(data: bytes, draw: random.Random, others) -> bytes:
    """PLY: lines of its header, and the JSON of our comments."""
    head, mark, body = data.partition(b"end_header\n")
    lines = head.split(b"\n")
    ours = [i for i, line in enumerate(lines) if line.startswith(b"comment fastgs ")]
    if not ours or draw.random() < 0.5:
        return _lines(head, draw, others) + mark + body
    at = draw.choice(ours)
    tag, key, text = [*lines[at].split(b" ", 3)[1:], b"", b""][:3]
    text = _json_mutated(text, draw, others) if _is_json(text) else json.dumps(_changed_tree([_json(text)], draw)).encode()
    lines[at] = b" ".join((b"comment", tag, key, text))
    return b"\n".join(lines) + mark + body


def _is_zip(data: bytes) -> bool:
    try:
        return data.startswith(b"PK\x03\x04") and zipfile.is_zipfile(io.BytesIO(data))
    except zipfile.BadZipFile:  # raised for some damage, instead of an answer
        return False


def _zip(data: bytes, draw: random.Random, others) -> bytes:
    """A zip file: one member's content, name or compression, with checksums that are right again."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(name, archive.read(name)) for name in archive.namelist()]
    except Exception:  # noqa: BLE001 (an earlier mutation has broken the zip file in whatever way)
        return data
    if not members:
        return data
    at, out = draw.randrange(len(members)), io.BytesIO()
    name, content = members[at]
    what = draw.choice(("content", "content", "content", "name", "delete", "again"))
    if what == "content":
        members[at] = (name, mutated(content, draw, others))
    elif what == "name":
        members[at] = (draw.choice([other for other, _ in members] + ["", "a/" + name, "../" + name]), content)
    elif what == "delete":
        del members[at]
    else:
        members.append((name, mutated(content, draw, others)))
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", draw.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, 8, 12, 14))) as archive:
        warnings.simplefilter("ignore")  # names that stand twice
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name or "x"), content)
    return out.getvalue()


def _is_gzip(data: bytes) -> bool:
    return data.startswith(b"\x1f\x8b\x08")


def _gzip(data: bytes, draw: random.Random, others) -> bytes:
    """A gzip file: its content, packed again."""
    try:
        content = zlib.decompressobj(31).decompress(data)
    except zlib.error:
        return data
    return gzip.compress(_bytes(content, draw, others), mtime=0)


def _is_png(data: bytes) -> bool:
    return data.startswith(b"\x89PNG\r\n\x1a\n")


def _png(data: bytes, draw: random.Random, others) -> bytes:
    """A PNG: one chunk's content, with its checksum right again."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        size = int.from_bytes(data[at:at + 4], "big")
        chunks.append((data[at + 4:at + 8], data[at + 8:at + 8 + size]))
        at += 12 + size
    if not chunks:
        return data
    at = draw.randrange(len(chunks))
    kind, content = chunks[at]
    chunks[at] = (kind, _bytes(content, draw, others))
    if draw.random() < 0.2:
        chunks.insert(at, chunks[draw.randrange(len(chunks))])
    return data[:8] + b"".join(struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)


STRUCTURES = ((_is_text, _lines), (_is_json, _json_mutated), (_is_json, _json_mutated), (_is_safetensors, _safetensors),
              (_is_safetensors, _safetensors), (_is_splatv, _splatv), (_is_ply, _ply), (_is_ply, _ply), (_is_zip, _zip), (_is_zip, _zip),
              (_is_gzip, _gzip), (_is_gzip, _gzip), (_is_gzip, _gzip), (_is_png, _png))
"""(does it know the content, change it): those that matter most stand twice."""


class _AnyNumber(int):
    """Equals every number."""

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other):
        return True

    def __ne__(self, other):
        return False


class Unchecked:
    """For a reader in place of the module zlib: every checksum is right, so that damage gets past them."""

    error = zlib.error

    def __init__(self):
        self._stream = zlib.decompressobj(-zlib.MAX_WBITS)  # without the stream's own checksum

    @staticmethod
    def crc32(data):
        return _AnyNumber()

    @classmethod
    def decompressobj(cls):
        return cls()

    def decompress(self, data, most):
        return self._stream.decompress(data[2:], most)

    @property
    def eof(self):
        return self._stream.eof
