# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of numbers in lossless pictures, a pixel a Gaussian, named by a meta.json: how SOG and its relatives keep Gaussians.

The pictures are WebP, or PNG; they lie in a zip file or in a folder.  A picture's header says its size before anything is unpacked.
"""
from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from pathlib import Path

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import damaged_if
from ..util.stated_paths import local
from ..util.zip_files import MAGIC, opened_zip, read_member
from .description import is_json_table, read_table
from .static import read_whole

META = "meta.json"
MAX_META = 1 << 22
"""Bytes of meta.json."""
LARGEST = 1 << 31
"""Bytes of a picture."""
GROWTH = 4
"""How many times as long as a zip file one of its members may be: they are packed already.  SMALL ones may be of any length."""
SMALL = 1 << 16
PNG = b"\x89PNG\r\n\x1a\n"


class Folder:
    """The files beside a meta.json."""

    def __init__(self, folder: Path, meta: str = META) -> None:
        self.folder, self.name = folder, meta

    def within(self, folder: str) -> Folder:
        """The files of a folder in it."""
        return Folder(self.folder / plain(folder))

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        return (self.folder / plain(name)).is_file()

    def size(self, name: str) -> int:
        """Bytes of a file."""
        if not self.has(name):
            raise FastGSError(f"its file {self.folder.name}/{name} is missing; copy or export all of its files again.")
        return (self.folder / plain(name)).stat().st_size

    def read(self, name: str, limit: int = LARGEST) -> bytes:
        """A file, of at most `limit` bytes."""
        damaged_if(self.size(name) > limit, f"{name} is larger than it can be")
        return read_whole(self.folder / plain(name))

    def meta(self, limit: int = MAX_META) -> dict:
        """What meta.json says."""
        return read_table(self.read(self.name, limit))


class Archive(Folder):
    """The files of a zip, wherever in it its meta.json, or a file of another name, lies; of two with one name, the last."""

    def __init__(self, archive: zipfile.ZipFile, length: int, meta: str) -> None:
        self.zip, self.length, self.name = archive, length, meta
        self.members = {info.filename: info for info in archive.infolist() if not info.is_dir()}
        self.base = next((name[:-len(meta)] for name in sorted(self.members, key=len) if name == meta or name.endswith(f"/{meta}")), "")

    def within(self, folder: str) -> Archive:
        inner = copy(self)
        inner.base, inner.name = f"{self.base}{plain(folder)}/", META
        return inner

    def has(self, name: str) -> bool:
        return self.base + name in self.members

    def size(self, name: str) -> int:
        if not self.has(name):
            raise FastGSError(f"its part {name} is missing; export it again.")
        return self.members[self.base + name].file_size

    def read(self, name: str, limit: int = LARGEST) -> bytes:
        damaged_if(self.size(name) > min(limit, max(SMALL, GROWTH * self.length)), f"{name} is larger than it can be")
        return read_member(self.zip, self.members[self.base + name])


@contextmanager
def opened(path: Path, meta: str = META) -> Iterator[Folder]:
    """The files that a meta.json names, by its path or by that of the zip file in which it is."""
    if read_whole(path, len(MAGIC)) != MAGIC:
        yield Folder(path.parent, path.name)
        return
    with opened_zip(path) as archive:
        yield Archive(archive, path.stat().st_size, meta)


def meta_of(head: bytes, path: Path, name: str = META, limit: int = MAX_META) -> dict:
    """What meta.json says, by its path or by that of a zip file; empty for any other file.  head: the file's first bytes."""
    if head.startswith(MAGIC):
        with opened(path, name) as files:
            return files.meta(limit) if files.has(name) else {}
    return read_table(read_whole(path)) if is_json_table(head) and path.stat().st_size <= limit else {}


def plain(name: object) -> str:
    """The name of a file in the same folder, and nothing else; it may begin with "./"."""
    name = name.removeprefix("./") if isinstance(name, str) else name
    if not isinstance(name, str) or name in (".", "..") or local(Path(), name) is None or any(c in name for c in "/\\:"):
        raise FastGSError("it names a file that is not beside or below it; the file is damaged.")
    return name


def below(name: object) -> tuple[str, ...]:
    """The parts of the name of a file in the same folder or below it."""
    return tuple(plain(part) for part in name.removeprefix("./").split("/")) if isinstance(name, str) else (plain(name),)


def part(meta: dict, key: str) -> dict:
    """A table in meta.json."""
    if not isinstance(meta.get(key), dict):
        raise FastGSError(f"meta.json says nothing of {key}; the file is damaged.")
    return meta[key]


def names(meta: dict, key: str, count: int) -> list[str]:
    """The pictures of a part, `count` of them."""
    found = part(meta, key).get("files")
    if not isinstance(found, list) or len(found) < count:
        raise FastGSError(f"meta.json does not name the pictures of {key}; the file is damaged.")
    return [plain(name) for name in found[:count]]


def numbers(values: object, count: int) -> np.ndarray:
    """A list of numbers, `count` of them at least."""
    good = isinstance(values, list) and len(values) >= count and all(type(v) in (int, float) and abs(v) < 1e30 for v in values)
    damaged_if(not good, "meta.json has something else where numbers should be")
    return np.array(values, np.float64)


def bounds(part: dict, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest values [count] of a part."""
    return numbers(part.get("mins"), count)[:count], numbers(part.get("maxs"), count)[:count]


def table(part: dict, key: str = "codebook") -> np.ndarray:
    """A table of 256 values; what it has too few of is 0."""
    values = numbers(part.get(key), 1)[:256]
    return np.concatenate([values, np.zeros(256 - len(values))])


def sixteen_bits(files: Folder, pair: list[str], count: int) -> np.ndarray:
    """Shares [count, 4] in 0..1 of the numbers whose low and high bytes a pair of pictures holds."""
    low, high = pair
    return (pixels(files, low, count) + 256.0 * pixels(files, high, count)) / 65535


def pixels(files: Folder, name: str, count: int) -> np.ndarray:
    """The first `count` pixels of a picture, [count, 4] u8 as integers."""
    found = picture(files, name, 2 * count + (1 << 16)).reshape(-1, 4)
    if len(found) < count:
        raise FastGSError(f"its picture {name} has {len(found)} pixels for {count} Gaussians; the file is cut short or damaged.")
    return found[:count].astype(np.intp)


def picture(files: Folder, name: str, most: int) -> np.ndarray:
    """A picture [h, w, 4] u8 of at most `most` pixels, which its header tells before anything is unpacked."""
    from PIL import Image

    data = files.read(name)
    width, height = _size(data)
    damaged_if(width * height > most, f"its picture {name} has more pixels than there are Gaussians for")
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP", "PNG")) as image:
            if image.mode not in ("RGB", "RGBA"):
                raise FastGSError(f"its picture {name} is of another kind ({image.mode}) than numbers are kept in; export it again.")
            return np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FastGSError(f"its picture {name} is neither WebP nor PNG, or damaged ({error}); copy or export it again.") from error


def _size(data: bytes) -> tuple[int, int]:
    """Width and height in a picture's header, before any library makes room for it; 0 where there are none."""
    if data.startswith(PNG) and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if len(data) < 30 or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        return 0, 0
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    bits = int.from_bytes(data[21:25] if kind == b"VP8L" else data[26:30], "little")
    return (1 + (bits & 16383), 1 + (bits >> 14 & 16383)) if kind == b"VP8L" else (bits & 16383, bits >> 16 & 16383)


def webp(pixels: np.ndarray) -> bytes:
    """A lossless WebP picture of pixels [h, w, 4] u8."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(stream, "WEBP", lossless=True, exact=True, quality=75, method=4)
    return stream.getvalue()
