# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequences of files: numbered files of static models in a folder or in a zip file, opened as one source (model/sequence.py).

A path stands for a sequence where it is
    a folder                       frames/                   with the numbered files of one sequence in it, or with a folder for each frame
    a pattern of names             frames/take_####.ply      every file whose number stands there, with any number of digits
    the same with two numbers      frames/take_[10-50].ply   those from 10 to 50
    a zip file                     frames.zip                as a folder
Frames have the places that their numbers give them, divided by the step that all numbers share; where one is missing, its
neighbours are shown.  Capitals make no difference.  Of what a trainer saved after several iterations, the last counts.
A folder that SOG was written into, meta.json and pictures, stands for that one model; with a lod-meta.json (streamed_sog.py), for the
finest of its levels; a trainer's folder, for the last model that was saved in it.  A zip file without a sequence in it is its model, of
any of ALONE, else a checkpoint; a remark tells of others.
"""
import contextlib
import math
import os
import re
import shutil
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterable
from functools import lru_cache
from pathlib import Path, PurePosixPath

import numpy as np

from ..model.gaussians import Clip, GaussianModel
from ..model.sequence import FreeClip, Sequence, Source
from ..model.slicing import freeze
from ..model.temporal import Always
from ..util.errors import FastGSError, LossWarning, shown_as
from ..util.identity import status_of
from ..util.reading import reading
from ..util.stated_paths import below
from ..util.zip_files import members, opened_zip
from . import sog, streamed_sog
from .base import Format, Loader, usable
from .frame_names import (
    CHECKPOINTS,
    EXTENSIONS,
    SAVED,
    is_frame,
    is_packed_frame,
    models_among,
    once,
    one_sequence,
    pattern_of,
    sequences_among,
    state_of,
)
from .pixel_tables import META
from .static import read_whole
from .turning import with_axes

PLACE = re.compile(r"#+|\[(\d{1,18})-(\d{1,18})\]")
"""Where a pattern's number goes."""
COMPANIONS = (".pt", ".pth", "/cfg_args", "/cameras.json", "/cfg.yml", "/config.yml")
"""What names of files end with that a model's reader may look for beside it: they are unpacked with a single model."""
LEVELS = streamed_sog.META
"""Of SOG's levels of detail in folders beside each other."""
DEPTH = 4
"""Folders below the one that was chosen in which frames are looked for: frame_0001/point_cloud/iteration_7000/point_cloud.ply."""
MOST_FOLDERS = 10_000
"""After so many folders below the one that was chosen, none in them is looked into."""
SPARSE = 100
"""Numbers whose range is this many times as long as their list are names, not times: the frames then follow each other closely."""
RATIO = 100
"""How many times larger a file may be than what a zip file holds of it; models are packed two to five times."""


class SequenceFormat(Format):
    """A format of clips that are a model of their own on each frame: opened, not loaded."""

    def load(self, path: Path) -> GaussianModel:
        raise FastGSError("it is a sequence of frames, which are read one at a time; open it with open_source(), or turn it into one "
                          "model with fastgs convert.")

    def single(self, path: Path, load: Loader) -> GaussianModel | None:
        """The file's model where it is no sequence after all."""
        return None


def within(path: Path, clip: Clip, at: np.ndarray, read: Callable[[int], GaussianModel], alike: bool = False) -> Sequence:
    """The sequence in one file, whose frame i is read(i) as the file has it."""
    def checked(i: int) -> GaussianModel:
        with reading(path), np.errstate(all="ignore"):
            return usable(read(i), path)

    return Sequence(clip, at, checked, lambda i: status_of(str(path)), str(path), alike=alike)


class NumberedFiles(SequenceFormat):
    """A folder or a pattern of names."""

    name = "numbered files"

    def sniff(self, head: bytes, path: Path) -> bool:
        return stands_for_many(path)

    def open(self, path: Path, load: Loader) -> Source:
        found = numbered_files(path)
        return _sequence([n for n, _ in found], lambda i: _still(load(found[i][1]), found[i][1]), lambda i: status_of(str(found[i][1])),
                         str(path))


class ZippedFiles(SequenceFormat):
    """Numbered files in a zip file; one without is its model."""

    name = "zip file of numbered files"
    reads = (".zip",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return bool(models_among(members(head, path)))

    def single(self, path: Path, load: Loader) -> GaussianModel | None:
        infos, taken, beside = _contents(path)
        return _unpacked(path, infos[taken[0][1]], load, beside) if len(taken) == 1 else None

    def open(self, path: Path, load: Loader) -> Source:
        if (model := self.single(path, load)) is not None:
            return model
        infos, found, _ = _contents(path, tell=False)
        return _sequence([n for n, _ in found], lambda i: _still(_unpacked(path, infos[found[i][1]], load), f"{path}: {found[i][1]}"),
                         lambda i: status_of(str(path)), str(path))


def resolved(path: Path, below: bool = True) -> Path:
    """The file that a path stands for: in a folder of SOG its meta.json or lod-meta.json, in a trainer's its last model; else the path.

    below  whether trainers' models in folders below count
    """
    for known, name in ((streamed_sog.StreamedSog(), LEVELS), (sog.Sog(), META)):
        meta = path / name
        if os.path.isfile(meta):
            with contextlib.suppress(FastGSError), reading(meta):
                if known.sniff(read_whole(meta, 512), meta):
                    return meta
            return path
    if not below or not os.path.isdir(path):
        return path
    names = _names(path)
    found = models_among(names if any(map(is_packed_frame, names)) else _names_below(path))
    return path / found[0] if len(found) == 1 and SAVED.search(found[0]) else path


def stands_for_many(path: str | os.PathLike) -> bool:
    """Whether a path is a folder or a pattern of names; what is in it is not looked at."""
    return os.path.isdir(path) or (PLACE.search(os.path.basename(path)) is not None and not os.path.lexists(path))


def place_of(path: str | os.PathLike) -> str:
    """What a path that may be a pattern, or name a level, must find on the disk: the file, or the folder."""
    path = os.fsdecode(path)
    if stands_for_many(path) and not os.path.isdir(path):
        return os.path.dirname(path)
    return str(streamed_sog.parted(Path(path))[0])


def title(path: Path) -> str:
    """A name for what is at a path, without extension and place of a number; of SOG in a folder it is the folder's."""
    file, level = streamed_sog.parted(path)
    if file.name.lower() in (META, LEVELS):
        return file.absolute().parent.name + (f" level {level}" if level else "")
    plain = PLACE.sub("", path.name) if stands_for_many(path) else path.name
    extension = next((e for e in EXTENSIONS if plain.lower().endswith(e)), "" if path.is_dir() else Path(plain).suffix)
    return plain.removesuffix(plain[len(plain) - len(extension):]).rstrip("_-. ") or path.parent.name


def stored_bytes(path: Path) -> int:
    """Bytes of the file at a path and, of SOG in a folder, of its pictures and chunks.  Raises OSError and FastGSError.

    Files are read anew only where the one at the path has changed, so that panels may ask.
    """
    status = os.stat(place_of(path))
    return status.st_size + _bytes_beside(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=256)
def _bytes_beside(path: Path, *status: int) -> int:
    """Bytes of the other files of SOG in a folder."""
    name = streamed_sog.parted(path)[0].name.lower()
    if name == META:
        files = sog.pictures(path)
    elif name == LEVELS:
        files = [Path(entry) for folder in streamed_sog.chunk_folders(path) for entry in os.scandir(folder)]
    else:
        return 0
    return sum(file.stat().st_size for file in files if file.is_file())


def numbered_files(path: Path, below: bool = True) -> list[tuple[int, Path]]:
    """The frames' numbers, increasing, and files of a folder or a pattern; raises FastGSError.

    below  whether a folder that has no frames itself may have folders with them
    """
    if path.is_dir():
        names = _names(path)
        found = names if any(map(is_frame, names)) or not below else _names_below(path)
        return [(n, path / name) for n, name in one_sequence(found, "the folder")]
    place = PLACE.search(path.name)
    assert place is not None
    number = pattern_of(path.name[:place.start()], path.name[place.end():])
    files = sorted((int(m[1]), path.parent / m[0]) for m in map(number.fullmatch, _names(path.parent)) if m)
    if place[1] is not None:
        files = [pair for pair in files if int(place[1]) <= pair[0] <= int(place[2])]
    if not files:
        raise FastGSError("there are no such files; check the folder and the name.")
    return once(files)


def grouped(paths: Iterable[Path]) -> list[Path]:
    """Chosen files as sources to open: those of a sequence become one pattern, the others stay as they are, in their order."""
    paths = list(dict.fromkeys(paths))
    found: dict[Path, Path] = {}
    for folder in dict.fromkeys(path.parent for path in paths):
        names = [path.name for path in paths if path.parent == folder and is_frame(path.name)]
        there = _names(folder) if folder.is_dir() else names
        for (before, after), rows in sequences_among(names).items():
            everything = sum(1 for name in there if pattern_of(before, after).fullmatch(name))
            inside = "####" if everything == len(rows) else f"[{rows[0].digits}-{rows[-1].digits}]"
            found |= {folder / row.name: folder / f"{before}{inside}{after}" for row in rows}
    return list(dict.fromkeys(found.get(path, path) for path in paths))


def _names(folder: Path) -> list[str]:
    with reading(folder):
        return sorted(entry.name for entry in os.scandir(folder))


def _names_below(folder: Path) -> list[str]:
    """The names of frames in folders below one, with the folders' names before them and "/" between; what cannot be read is passed over."""
    found: list[str] = []
    places, seen = [""], {os.path.realpath(folder)}
    for above in places:  # which grows while it is gone through
        names: list[str] = []
        with contextlib.suppress(FastGSError):
            names = [name for name in _names(folder / above) if not name.startswith(".")]
        if above:
            found += [above + name for name in names if is_frame(name) or name == META or name.endswith(CHECKPOINTS)]
        for name in names if above.count("/") < DEPTH and len(places) < MOST_FOLDERS else ():
            real = os.path.realpath(folder / above / name)  # a link may lead back
            if real not in seen and os.path.isdir(real):
                seen.add(real)
                places.append(f"{above}{name}/")
    return found


def _contents(path: Path, tell: bool = True) -> tuple[dict[str, zipfile.ZipInfo], list[tuple[int, str]], list[zipfile.ZipInfo]]:
    """The members of a zip file; numbers and names of the frames, or only the model's; and what may be looked for beside a model.

    A LossWarning tells of other models in it.
    """
    with reading(path), opened_zip(path) as archive:
        infos = {info.filename: info for info in archive.infolist() if not info.is_dir()}
    models = models_among(infos)
    frames = [name for name in models if is_packed_frame(name)]
    several = len(frames) > 1 and (sequences_among(frames) or sequences_among(frames, loose=True))
    taken = one_sequence(frames, "the zip file") if several else [(0, models[0])]
    others = sorted(set(models) - {name for _, name in taken})
    if others and tell:
        what = taken[0][1] if len(taken) == 1 else f"the sequence {taken[0][1]} to {taken[-1][1]}"
        more = f" and {len(others) - 3} others" if len(others) > 3 else ""
        warnings.warn(LossWarning(f"{path}: of the models in it, {what} is opened; {', '.join(others[:3])}{more} can be opened if the zip "
                                  "file is unpacked."), stacklevel=4)
    state = state_of(taken[0][1])
    beside = [info for name, info in infos.items() if f"/{name}".endswith(COMPANIONS) and state_of(name) in (-1, state)]
    return infos, taken, beside


def _sequence(numbers: list[int], read: Callable[[int], GaussianModel], state: Callable[[int], tuple], about: str) -> Sequence:
    at = np.array(numbers, np.float64) - numbers[0]
    step = math.gcd(*(n - numbers[0] for n in numbers)) or 1
    at /= step
    if at[-1] + 1 > SPARSE * len(at):
        at = np.arange(len(at), dtype=np.float64)
    missing = int(at[-1]) + 1 - len(at)
    if missing:
        warnings.warn(LossWarning(f"{about}: {missing} of {int(at[-1]) + 1} frames are missing; their neighbours are shown."), stacklevel=4)
    first: list[str] = []

    def oriented(i: int) -> GaussianModel:
        model = read(i)
        if not first:
            first.append(model.axes)
        return with_axes(model, first[0])

    return Sequence(FreeClip(int(at[-1]) + 1, start_frame=min(numbers[0], 10**9)), at, oriented, state, about)


def _still(model: GaussianModel, name: object) -> GaussianModel:
    """The model, if nothing in it changes in time."""
    if model.basis.terms or model.rotation_basis.terms or not isinstance(model.temporal_kind, Always):
        raise FastGSError(f"{name}: this frame changes over time itself; open it alone.")
    return freeze(model, 0.0) if model.appearance.name == "changing" else model


def _unpacked(path: Path, info: zipfile.ZipInfo, load: Loader, beside: Iterable[zipfile.ZipInfo] = ()) -> GaussianModel:
    """The model in a member of a zip file, unpacked into a temporary folder as far as its claims go, with the members `beside`."""
    with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        with reading(path), opened_zip(path) as archive:
            for member in (info, *beside):
                file = below(Path(folder), str(PurePosixPath(member.filename.lstrip("/"))))
                if file is None or any(c in member.filename for c in "\\:\0"):
                    raise FastGSError(f"{path}: its part {member.filename} lies outside of it; unpack it yourself.")
                if member.file_size > RATIO * max(member.compress_size, 1) + 2**16 or member.flag_bits & 1:
                    raise FastGSError(f"{path}: its part {member.filename} is encrypted, or far larger than what the zip file holds of it; "
                                      "unpack it yourself.")
                file.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as source, open(file, "wb") as out:
                    shutil.copyfileobj(source, out)
        with shown_as(f"{folder}{os.sep}", f"{path}: "):
            return load(Path(folder, *PurePosixPath(info.filename.lstrip("/")).parts))
