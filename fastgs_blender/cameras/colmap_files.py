# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's model files, text and binary: cameras, images (poses and names) and points.

Every count is checked against the file's length before it is believed.  (colmap.github.io/format.html)
"""
import io
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from ..model.points import Points, usable
from ..util.errors import FastGSError
from ..util.reading import open_file, read_bytes, reading
from ..util.stated_paths import below
from . import poses
from .lens import Intrinsics, Lens

MODELS = {
    "SIMPLE_PINHOLE": (0, "pinhole", "f cx cy"), "PINHOLE": (1, "pinhole", "fx fy cx cy"),
    "SIMPLE_RADIAL": (2, "opencv", "f cx cy k1"), "RADIAL": (3, "opencv", "f cx cy k1 k2"),
    "OPENCV": (4, "opencv", "fx fy cx cy k1 k2 p1 p2"), "OPENCV_FISHEYE": (5, "fisheye", "fx fy cx cy k1 k2 k3 k4"),
    "FULL_OPENCV": (6, "opencv", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "SIMPLE_RADIAL_FISHEYE": (8, "fisheye", "f cx cy k1"), "RADIAL_FISHEYE": (9, "fisheye", "f cx cy k1 k2"),
}
"""COLMAP's camera models: its number, our lens, its parameters in order."""
NUMBERS = {number: model for model, (number, *_) in MODELS.items()}


LARGEST_FILE = 16 * 2**30
DAMAGED = "COLMAP's file is cut short or damaged, so copy it or export the model again"


class ColmapCamera(NamedTuple):
    """Intrinsics and lens of one of COLMAP's cameras."""

    intrinsics: Intrinsics
    lens: Lens


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """A registered picture: its name (a path below the images' folder), pose and camera."""

    name: str
    world_to_camera: np.ndarray
    camera: ColmapCamera


def has_model(folder: Path) -> bool:
    """Whether the folder holds cameras and images, both as text or both binary."""
    return any((folder / f"cameras.{kind}").is_file() and (folder / f"images.{kind}").is_file() for kind in ("bin", "txt"))


def largest(folder: Path) -> Path:
    """Of a mapper's models 0, 1 ... beside one of them, that with the largest file of images: each holds what it could join, and the
    first may be a pair.  Another folder's name: the folder."""
    if not folder.name.isdecimal():
        return folder
    models = [each for each in folder.parent.iterdir() if each.name.isdecimal() and has_model(each)]
    return max(sorted(models), key=lambda each: max(file.stat().st_size for file in each.glob("images.*")))


def read_images(folder: Path) -> list[ColmapImage]:
    """The registered pictures of a model, by name; binary files where there are both.  Raises FastGSError."""
    with reading(folder, DAMAGED):
        return _images(folder, "bin" if (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file() else "txt")


def _images(folder: Path, kind: str) -> list[ColmapImage]:
    file = folder / f"cameras.{kind}"
    records = (_cameras_bin if kind == "bin" else _cameras_txt)(file)
    cameras = {number: _camera(f"{file}: camera {number}", *rest) for number, *rest in records}
    file = folder / f"images.{kind}"
    images = []
    for name, quaternion, translation, camera in (_images_bin if kind == "bin" else _images_txt)(file):
        where = f"{file}: {name}"
        parts = below(Path(), name)
        if parts is None:
            raise FastGSError(f"{file}: {name!r} is no name of a picture within the capture.")
        if camera not in cameras:
            raise FastGSError(f"{where} has the camera {camera}, which cameras.{kind} does not hold; the files belong to different models.")
        images.append(ColmapImage(parts.as_posix(), poses.from_quaternion(quaternion, translation, where), cameras[camera]))
    if not images:
        raise FastGSError(f"{file}: no picture is registered in this model; run COLMAP again.")
    return sorted(images, key=lambda image: image.name)


def read_points(folder: Path) -> Points | None:
    """The points of a model; None where it has none."""
    for kind, reader in (("bin", _points_bin), ("txt", _points_txt)):
        file = folder / f"points3D.{kind}"
        if file.is_file():
            with reading(file, DAMAGED):
                rows = np.array(list(reader(file)), np.float64).reshape(-1, 6)
                return usable(rows[:, :3], rows[:, 3:] / 255) if len(rows) else None
    return None


def _camera(where: str, model: Any, width: int, height: int, parameters: Sequence[float]) -> ColmapCamera:
    model = NUMBERS.get(model, model)
    if model not in MODELS:
        raise FastGSError(f"{where} has the model {model}, which is not known here; undistort the pictures with colmap image_undistorter.")
    _, lens, words = MODELS[model]
    names = words.split()
    if len(names) != len(parameters):
        raise FastGSError(f"{where} has {len(parameters)} parameters, but {model} has {len(names)}.")
    values = dict(zip(names, parameters))
    f = values.pop("f", None)
    fx, fy = (values.pop("fx"), values.pop("fy")) if f is None else (f, f)
    given = poses.intrinsics(where, fx, fy, values.pop("cx"), values.pop("cy"), width, height)
    for name, value in values.items():
        poses.number(value, f"{where}: its {name}")
    return ColmapCamera(given, Lens.named(lens, values))


class _Reader:
    """A binary file read in order, never beyond its end."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, read_bytes(path, LARGEST_FILE), 0

    def take(self, layout: str) -> tuple:
        size = struct.calcsize(layout)
        self._need(size)
        self.at += size
        return struct.unpack_from(layout, self.data, self.at - size)

    def count(self, least: int) -> int:
        """A number of records of at least so many bytes each."""
        (count,) = self.take("<Q")
        if count * least > len(self.data) - self.at:
            raise self.damaged()
        return count

    def skip(self, size: int) -> None:
        self._need(size)
        self.at += size

    def text(self) -> str:
        """A name that ends with a zero byte."""
        end = self.data.find(b"\0", self.at, self.at + 4096)
        if end < 0:
            raise self.damaged()
        name = self.data[self.at:end].decode("utf-8", "surrogateescape")
        self.at = end + 1
        return name

    def _need(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise self.damaged()

    def damaged(self) -> FastGSError:
        return FastGSError(f"{self.path}: COLMAP's file is cut short or damaged; copy it or export the model again.")


def _cameras_bin(path: Path) -> Iterator[tuple]:
    reader = _Reader(path)
    for _ in range(reader.count(24)):
        number, model, width, height = reader.take("<IiQQ")
        if model not in NUMBERS:
            raise FastGSError(f"{path}: camera {number} has the model number {model}, which is not known here; undistort the pictures with "
                              "colmap image_undistorter.")
        yield number, model, width, height, reader.take(f"<{len(MODELS[NUMBERS[model]][2].split())}d")


def _images_bin(path: Path) -> Iterator[tuple]:
    reader = _Reader(path)
    for _ in range(reader.count(73)):
        values = reader.take("<I7dI")
        name = reader.text()
        reader.skip(24 * reader.count(24))
        yield name, values[1:5], values[5:8], values[8]


def _points_bin(path: Path) -> Iterator[tuple]:
    reader = _Reader(path)
    for _ in range(reader.count(51)):
        values = reader.take("<Q3d3Bd")
        reader.skip(8 * reader.count(8))
        yield values[1:7]


def _lines(path: Path) -> Iterator[str]:
    with open_file(path) as file, io.TextIOWrapper(file, "utf-8-sig", "surrogateescape") as stream:
        for line in stream:
            yield line.strip()


def _records(path: Path) -> Iterator[list[str]]:
    for line in _lines(path):
        if line and not line.startswith("#"):
            yield line.split()


def _cameras_txt(path: Path) -> Iterator[tuple]:
    for words in _records(path):
        with _understood(path, words):
            record = int(words[0]), words[1], int(words[2]), int(words[3]), [float(word) for word in words[4:]]
        yield record


def _images_txt(path: Path) -> Iterator[tuple]:
    lines = _lines(path)
    for line in lines:
        if not line or line.startswith("#"):
            continue
        words = line.split(None, 9)
        with _understood(path, words):
            values = [float(word) for word in words[1:8]]
            record = words[9], values[:4], values[4:], int(words[8])
        yield record
        next(lines, None)  # its points


def _points_txt(path: Path) -> Iterator[tuple]:
    for words in _records(path):
        with _understood(path, words):
            record = tuple(float(words[i]) for i in range(1, 7))
        yield record


class _understood:
    """Around the parsing of a line: what makes no sense becomes a FastGSError."""

    def __init__(self, path: Path, words: list[str]) -> None:
        self.path, self.words = path, words

    def __enter__(self) -> "_understood":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None and issubclass(kind, (ValueError, IndexError, OverflowError)):
            raise FastGSError(f"{self.path}: the line {' '.join(self.words)[:60]!r} makes no sense in COLMAP's format; the file is damaged "
                              "or cut short, so copy it or export the model again.") from error
