# SPDX-License-Identifier: GPL-3.0-or-later
"""FrameStore: the pixels of a capture, decoded once into a cache on disk, of which a bounded part is held in memory.

One file a shot, named by a digest of everything its pixels depend on (files, their sizes and times, lens, camera, scale), written
beside and renamed: a stopped or killed filling keeps what it has, and processes may fill and read the same cache at once.
Files are read into memory of our own, not mapped: what the system caches of them is not counted as ours and can be given up.
"""
from __future__ import annotations

import contextlib
import errno
import math
import os
import shutil
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from ...util.errors import FastGSError
from ...util.outputs import remove_leftovers
from ..capture import Capture, Shot
from . import bounds, decoding, framefiles, plain, undistortion
from .checks import sentence
from .filling import fill
from .probe import facts

RESERVE = 256 * 2**20
"""Bytes that are left free on the cache's disk."""
MOST_THREADS = 8
LOOKS = 24
"""Pictures of a capture in which a plain background is looked for."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """rgb [h, w, 3] float32 in 0..1, display sRGB, straight; mask [h, w] float32 in 0..1 (alpha channel x mask file) or None;
    valid [h, w] bool, False where the lens has no picture, or None: it has one everywhere;
    alpha [h, w] float32, the picture's own where there is a mask file besides, or None;
    stored [h, w, 3] uint8, what rgb is 255ths of, or None: other numbers;
    least [h, w, 3] bool, True where the camera was overexposed: the colour is this or brighter; None: nowhere."""

    rgb: np.ndarray
    mask: np.ndarray | None = None
    valid: np.ndarray | None = None
    alpha: np.ndarray | None = None
    stored: np.ndarray | None = None
    least: np.ndarray | None = None


class FrameStore:
    """The pixels of a capture's shots.  Safe to use from several threads.

    budget  bytes of pixels held in memory at most; one decoded picture a thread comes on top while the cache is filled
    whole   keep pictures before a plain background (plain.py) as they are: else what stands before it is cut out, and `plain` is that
            background, or None where there is none
    folder  where the cache lies; None: framefiles.default_folder(), where it shares a bounded space with other captures (bounds.py)
    beyond  shots for which fill() found no room there: they are decoded whenever they are needed
    """

    def __init__(self, capture: Capture, budget: int = 2**30, folder: Path | None = None, whole: bool = False) -> None:
        self.capture, self.budget, self.whole = capture, int(budget), whole
        self.folder = Path(folder) if folder is not None else framefiles.default_folder(capture)
        self._held: OrderedDict[Path, np.ndarray] = OrderedDict()
        self.held_bytes = 0
        self._lock = threading.Lock()
        self._paths: WeakKeyDictionary[Shot, Path] = WeakKeyDictionary()
        self._bounded = folder is None
        self.beyond: set[Shot] = set()
        self._valid: dict = {}
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            os.utime(self.folder)
        except OSError as error:
            raise self._cannot_write(error) from error
        remove_leftovers(self.folder)
        if folder is None:
            bounds.remove_unused(self.folder)

    def of(self, capture: Capture) -> FrameStore:
        """A store of the same pictures by another description of the capture, such as other cameras."""
        return FrameStore(capture, self.budget, None if self._bounded else self.folder, self.whole)

    def size(self, shot: Shot) -> tuple[int, int]:
        """Width and height of a shot's pixels."""
        height, width, _ = decoding.shape(shot, self.capture.scale)
        return width, height

    def missing(self, shots: Iterable[Shot] | None = None) -> list[Shot]:
        """The shots (default: all) whose pixels are not in the cache yet."""
        return [shot for shot in (self.capture.shots if shots is None else shots) if not self._is_there(shot)]

    def fill(self, progress: Callable[[int, int], None] | None = None, shots: Iterable[Shot] | None = None,
             threads: int | None = None) -> None:
        """Decode the shots (default: all) that are not in the cache yet; progress(done, of) is called from this thread.

        Raises FastGSError with the list of files that cannot be decoded (all others are in the cache then), or where the disk is full.
        An exception from progress, such as KeyboardInterrupt, stops the filling; what is done stays.
        """
        shots = list(self.capture.shots if shots is None else shots)
        faults: list[str] = []
        todo = []
        for shot in shots:
            try:
                if not self._is_there(shot):
                    todo.append(shot)
                elif self._bounded:
                    with contextlib.suppress(OSError):
                        os.utime(self._path(shot))  # what was used last goes last
            except FastGSError as error:
                faults.append(str(error))
        todo = self._with_room(todo, shots)
        self._check_space(todo)
        done = len(shots) - len(todo) - len(faults)
        report = progress or (lambda done, of: None)
        report(done, len(shots))
        for fault in fill(todo, self.capture.scale, self._is_there, self._keep, threads or min(os.cpu_count() or 1, MOST_THREADS)):
            faults += [fault] if fault else []
            done += 1
            report(done, len(shots))
        if faults:
            raise FastGSError(sentence(self.capture.path, list(dict.fromkeys(faults))))

    def pixels(self, shot: Shot) -> Pixels:
        """The pixels of a shot, decoded now if they are not in the cache; the arrays are the caller's.  Raises FastGSError."""
        stored = self.stored(shot)
        rgb, mask, alpha = _planes(stored)
        valid = self._valid_of(shot)
        if self.plain is None or mask is None:
            return Pixels(rgb, mask, valid, alpha, stored[..., :3] if stored.dtype == np.uint8 else None)
        tells = self.plain.tells(rgb, mask if alpha is None else alpha)
        return Pixels(rgb, mask, tells if valid is None else tells & valid, alpha)

    @cached_property
    def plain(self) -> plain.Plain | None:
        """The plain background of all pictures, as some of them show."""
        if self.whole:
            return None
        some = [self.capture.shots[k] for k in np.unique(np.linspace(0, len(self.capture.shots) - 1, LOOKS).round().astype(int))]
        with contextlib.suppress(FastGSError):  # whoever asks for a damaged picture is told
            self.fill(shots=some)
        pictures, valid = [], []
        for shot in some:
            with contextlib.suppress(FastGSError):
                if facts(shot.image).alpha:
                    return None
                pictures.append(_planes(self._read(shot))[0])
                valid.append(self._valid_of(shot))
        return plain.background(pictures, valid) if pictures else None

    def stored(self, shot: Shot) -> np.ndarray:
        """The pixels [h, w, 3 to 5] as they are kept in memory: uint8 or uint16, not to be written to."""
        path = self._path(shot)
        with self._lock:
            if path in self._held:
                self._held.move_to_end(path)
                return self._held[path]
        array = self._read(shot)
        if self.plain is not None:
            array = _cut_out(array, self.plain)
        array.flags.writeable = False
        with self._lock:
            if array.nbytes <= self.budget and path not in self._held:
                self._held[path] = array
                self.held_bytes += array.nbytes
                while self.held_bytes > self.budget:
                    self.held_bytes -= self._held.popitem(last=False)[1].nbytes
        return array

    def _read(self, shot: Shot) -> np.ndarray:
        """The pixels [h, w, 3 to 5] of a shot as they are cached on disk, decoded now if they are not there."""
        found = framefiles.read(self._path(shot), decoding.shape(shot, self.capture.scale), _kind(shot))
        return self._decode_now(shot) if found is None else found

    def _decode_now(self, shot: Shot) -> np.ndarray:
        """A shot's pixels from its files, kept in the cache as well where there is room."""
        for _, found in decoding.decode([shot], self.capture.scale):
            if isinstance(found, FastGSError):
                raise found
            if not self._bounded or self._path(shot).exists():  # else fill() has found no room, here or in another process
                self._keep(shot, found)
            return found
        raise AssertionError

    def _valid_of(self, shot: Shot) -> np.ndarray | None:
        if shot.camera is None or shot.image.lens.is_pinhole:
            return None
        camera = shot.camera
        key = shot.image.lens, shot.image.intrinsics, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
        if key not in self._valid:
            self._valid[key] = undistortion.valid(shot)
        return self._valid[key]

    def _path(self, shot: Shot) -> Path:
        path = self._paths.get(shot)
        if path is None:
            path = self._paths[shot] = self.folder / f"{framefiles.digest(shot, self.capture.scale)}.frame"
        return path

    def _names(self, shots: Iterable[Shot]) -> Iterator[str]:
        """Names of the files of those shots whose pictures are there."""
        for shot in shots:
            with contextlib.suppress(FastGSError):
                yield self._path(shot).name

    def _is_there(self, shot: Shot) -> bool:
        try:
            length = self._path(shot).stat().st_size
        except FileNotFoundError:
            return False
        return length == self._length(shot)

    def _length(self, shot: Shot) -> int:
        return framefiles.HEADER + math.prod(decoding.shape(shot, self.capture.scale)) * np.dtype(_kind(shot)).itemsize

    def _keep(self, shot: Shot, array: np.ndarray) -> None:
        try:
            framefiles.write(self._path(shot), array)
        except OSError as error:
            raise self._cannot_write(error) from error

    def _with_room(self, todo: list[Shot], shots: list[Shot]) -> list[Shot]:
        """Those shots that the bounded cache has room for, of all that are asked for; the others go to `beyond`.

        Frames of videos come first, because one of these alone takes long to decode; else the order is that of the digests, so that all
        processes keep the same ones, evenly spread.
        """
        self.beyond.clear()
        lengths = {shot: self._length(shot) for shot in todo}
        if not self._bounded or not todo:
            return todo
        names = set(self._names(shots))
        left = bounds.room(self.folder, sum(lengths.values()), names, set(self._names(self.capture.shots)) - names, RESERVE)
        for shot in sorted(todo, key=lambda shot: (shot.image.frame is None, self._path(shot).name)):
            left -= lengths[shot]
            if left < 0:
                self.beyond.add(shot)
        return [shot for shot in todo if shot not in self.beyond]

    def _check_space(self, todo: Iterable[Shot]) -> None:
        need = sum(map(self._length, todo))
        free = shutil.disk_usage(self.folder).free
        if need and need + RESERVE > free:
            raise FastGSError(f"{self.folder}: the frames of this capture need {_bytes(need + RESERVE)} there, and {_bytes(free)} are "
                              "free; free some, use a smaller scale or fewer frames, or set FASTGS_CACHE_DIR to a folder on another disk.")

    def _cannot_write(self, error: OSError) -> FastGSError:
        full = error.errno in {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}
        reason = "the disk is full" if full else error.strerror or str(error)
        return FastGSError(f"{self.folder}: decoded frames cannot be written there ({reason}), those so far are kept; free some space or "
                           "set FASTGS_CACHE_DIR to another folder.")


def _bytes(count: int) -> str:
    """Bytes as a text, rounded up to a tenth of a gigabyte or to a megabyte."""
    return f"{math.ceil(count / 1e8) / 10:.1f} GB" if count >= 1e9 else f"{math.ceil(count / 1e6)} MB"


def _planes(stored: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """The colours [h, w, 3], mask and alpha [h, w] of stored pixels, as float32 in 0..1."""
    most = np.float32(_most(stored.dtype))
    mask, alpha = (stored[..., k] / most if stored.shape[2] > k else None for k in (3, 4))
    return stored[..., :3] / most, mask, alpha


def _cut_out(stored: np.ndarray, background: plain.Plain) -> np.ndarray:
    """Stored pixels without alpha as they would be with the alpha of what stands before a plain background."""
    rgb, mask, _ = _planes(stored)
    rgb, share = background.cut_out(rgb)
    planes = [rgb, *(each[..., None] for each in ([share] if mask is None else [mask * share, share]))]
    return (np.concatenate(planes, -1) * _most(stored.dtype) + 0.5).astype(stored.dtype)


def _most(kind: np.dtype) -> int:
    return 255 if kind == np.uint8 else 65535


def _kind(shot: Shot) -> type[np.integer]:
    """The type of a shot's cached numbers."""
    return np.uint16 if facts(shot.image).deep else np.uint8
