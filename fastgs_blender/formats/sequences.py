# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequences of files: numbered files of static models in a folder or in a zip file, opened as one source (model/sequence.py).

A path stands for a sequence where it is
    a folder                       frames/                   with the numbered files of one sequence in it
    a pattern of names             frames/take_####.ply      every file whose number stands there, with any number of digits
    the same with two numbers      frames/take_[10-50].ply   those from 10 to 50
    a zip file                     frames.zip                as a folder
Frames have the places that their numbers give them, divided by the step that all numbers share; where one is missing, its
neighbours are shown.
"""
from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
import warnings
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ..model.gaussians import GaussianModel
from ..model.sequence import FreeClip, Sequence
from ..model.slicing import freeze
from ..model.temporal import Always
from ..util.errors import FastGSError, LossWarning
from ..util.identity import status_of
from ..util.reading import reading
from ..util.zip_files import opened_zip
from .base import Format
from .turning import with_axes
from .zipped import members

EXTENSIONS = (".compressed.ply", ".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb", ".gltf")
"""Of files that are taken for frames."""
PLACE = re.compile(r"#+|\[(\d{1,18})-(\d{1,18})\]")
"""Where a pattern's number goes."""
MOST_FRAMES = 1_000_000
SPARSE = 100
"""Numbers whose range is this many times as long as their list are names, not times: the frames then follow each other closely."""
RATIO = 100
"""How many times larger a file may be than what a zip file holds of it; models are packed two to five times."""
ADVICE = "name them with their frames' numbers, as in frame_0001.ply"
Loader = Callable[[Path], GaussianModel]


class SequenceFormat(Format):
    """A format of clips that are a model of their own on each frame: opened, not loaded."""

    def load(self, path):
        raise FastGSError("it is a sequence of frames, which are read one at a time; open it with open_source(), or turn it into one "
                          "model with fastgs convert.")


class NumberedFiles(SequenceFormat):
    """A folder or a pattern of names."""

    name = "numbered files"

    def sniff(self, head, path):
        return stands_for_many(path)

    def open(self, path, load):
        found = numbered_files(path)
        return _sequence([n for n, _ in found], lambda i: _still(load(found[i][1]), found[i][1]), lambda i: status_of(str(found[i][1])),
                         str(path))


class ZippedFiles(SequenceFormat):
    """Numbered files in a zip file; one that holds a single model is that model."""

    name = "zip file of numbered files"
    reads = (".zip",)

    def sniff(self, head, path):
        return any(_is_frame(name) for name in members(head, path))

    def open(self, path, load):
        with reading(path), opened_zip(path) as archive:
            infos = {info.filename: info for info in archive.infolist() if not info.is_dir() and _is_frame(info.filename)}
        if len(infos) == 1:
            return _unpacked(path, next(iter(infos.values())), load)
        found = _one_sequence(infos, "the zip file")
        return _sequence([n for n, _ in found], lambda i: _still(_unpacked(path, infos[found[i][1]], load), f"{path}: {found[i][1]}"),
                         lambda i: status_of(str(path)), str(path))


def stands_for_many(path: str | os.PathLike) -> bool:
    """Whether a path is a folder or a pattern of names; what is in it is not looked at."""
    return os.path.isdir(path) or (PLACE.search(os.path.basename(path)) is not None and not os.path.lexists(path))


def place_of(path: str | os.PathLike) -> str:
    """What a path that may be a pattern must find on the disk: the file, or the folder."""
    path = os.fsdecode(path)
    return os.path.dirname(path) if stands_for_many(path) and not os.path.isdir(path) else path


def title(path: Path) -> str:
    """A name for what is at a path, without the place of a number."""
    plain = PLACE.sub("", path.name) if stands_for_many(path) else path.name
    for extension in EXTENSIONS:
        plain = plain.removesuffix(extension)
    return plain.rstrip("_-. ") or path.parent.name


def numbered_files(path: Path) -> list[tuple[int, Path]]:
    """The frames' numbers, increasing, and files of a folder or a pattern; raises FastGSError."""
    if path.is_dir():
        return [(n, path / name) for n, name in _one_sequence(_names(path), "the folder")]
    place = PLACE.search(path.name)
    number = re.compile(re.escape(path.name[:place.start()]) + r"(\d{1,18})" + re.escape(path.name[place.end():]))
    found = sorted((int(m[1]), path.parent / m[0]) for m in map(number.fullmatch, _names(path.parent)) if m)
    if place[1] is not None:
        found = [pair for pair in found if int(place[1]) <= pair[0] <= int(place[2])]
    if not found:
        raise FastGSError("there are no such files; check the folder and the name.")
    return _once(found)


def grouped(paths: Iterable[Path]) -> list[Path]:
    """Chosen files as sources to open: those of a sequence become one pattern, the others stay as they are, in their order."""
    paths = list(dict.fromkeys(paths))
    found: dict[Path, Path] = {}
    for folder in dict.fromkeys(path.parent for path in paths):
        names = [path.name for path in paths if path.parent == folder and _is_frame(path.name)]
        there = _names(folder) if folder.is_dir() else names
        for (before, after), numbers in _sequences(names).items():
            low, high = min(numbers), max(numbers)
            everything = sum(1 for name in there if re.fullmatch(re.escape(before) + r"\d{1,18}" + re.escape(after), name))
            inside = "####" if everything == len(numbers) else f"[{low[1]}-{high[1]}]"
            found |= {folder / f"{before}{digits}{after}": folder / f"{before}{inside}{after}" for _, digits in numbers}
    return list(dict.fromkeys(found.get(path, path) for path in paths))


def _names(folder: Path) -> list[str]:
    with reading(folder):
        return sorted(entry.name for entry in os.scandir(folder))


def _is_frame(name: str) -> bool:
    return name.lower().endswith(EXTENSIONS) and not os.path.basename(name).startswith(".") and "__MACOSX" not in name


def _sequences(names: Iterable[str]) -> dict[tuple[str, str], list[tuple[int, str]]]:
    """{(before, after the number): [(number, its digits), ...]} of names that differ in one number, two names at least.

    Where several numbers differ, the last one is the frame's.
    """
    alike = defaultdict(list)
    for name in names:
        alike[tuple(re.split(r"\d+", name))].append(re.findall(r"\d+", name))
    found: dict[tuple[str, str], list[tuple[int, str]]] = defaultdict(list)
    for texts, rows in alike.items():
        differing = [c for c in range(len(texts) - 1) if len({row[c] for row in rows}) > 1]
        for row in rows if differing else ():
            c = differing[-1]
            parts = [text + digits for text, digits in zip(texts, row)]
            found["".join(parts[:c]) + texts[c], texts[c + 1] + "".join(d + t for d, t in zip(row[c + 1:], texts[c + 2:]))].append(
                (int(row[c][:18]), row[c]))
    return {key: sorted(numbers) for key, numbers in found.items() if len(numbers) > 1}


def _one_sequence(names: Iterable[str], where: str) -> list[tuple[int, str]]:
    """Numbers and names of the one sequence among names; raises FastGSError."""
    found = _sequences(name for name in names if _is_frame(name))
    if not found:
        raise FastGSError(f"{where} holds no numbered model files ({', '.join(EXTENSIONS)}); choose a file, or {ADVICE}.")
    if len(found) > 1:
        patterns = sorted(f"{before}####{after}" for before, after in found)
        raise FastGSError(f"{where} holds {len(found)} sequences ({', '.join(patterns[:4])}); choose one of them by its name.")
    (before, after), numbers = next(iter(found.items()))
    return _once([(n, f"{before}{digits}{after}") for n, digits in numbers])


def _once(found: list) -> list:
    """The same, each number once: 7.ply and 07.ply are one frame."""
    if len(found) > MOST_FRAMES:
        raise FastGSError(f"there are {len(found)} frames; at most {MOST_FRAMES} are read, so choose a part of them.")
    return list({n: (n, name) for n, name in found}.values())


def _sequence(numbers: list[int], read, state, about: str) -> Sequence:
    at = np.array(numbers, np.float64) - numbers[0]
    step = math.gcd(*(n - numbers[0] for n in numbers)) or 1
    at /= step
    if at[-1] + 1 > SPARSE * len(at):
        at = np.arange(len(at), dtype=np.float64)
    missing = int(at[-1]) + 1 - len(at)
    if missing:
        warnings.warn(LossWarning(f"{about}: {missing} of {int(at[-1]) + 1} frames are missing; their neighbours are shown."), stacklevel=4)
    first: list[str] = []

    def oriented(i):
        model = read(i)
        if not first:
            first.append(model.axes)
        return with_axes(model, first[0])

    return Sequence(FreeClip(int(at[-1]) + 1, start_frame=min(numbers[0], 10**9)), at, oriented, state, about)


def _still(model: GaussianModel, name) -> GaussianModel:
    """The model, if nothing in it changes in time."""
    if model.basis.terms or model.rotation_basis.terms or not isinstance(model.temporal_kind, Always):
        raise FastGSError(f"{name}: this frame changes over time itself; open it alone.")
    return freeze(model, 0.0) if model.appearance.name == "changing" else model


def _unpacked(path: Path, info: zipfile.ZipInfo, load: Loader) -> GaussianModel:
    """The model in a member of a zip file, unpacked into a temporary file as far as its claims go."""
    name = info.filename
    if info.file_size > RATIO * max(info.compress_size, 1) + 2**16 or info.flag_bits & 1:
        raise FastGSError(f"{path}: its part {name} is encrypted, or far larger than what the zip file holds of it; unpack it yourself.")
    with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        target = Path(folder, "frame" + next(e for e in EXTENSIONS if name.lower().endswith(e)))
        with reading(path), opened_zip(path) as archive, archive.open(info) as source, open(target, "wb") as out:
            shutil.copyfileobj(source, out)
        try:
            return load(target)
        except FastGSError as error:
            raise FastGSError(str(error).replace(str(target), f"{path}: {name}")) from error.__cause__
