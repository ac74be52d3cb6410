# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoptic Sports as Dynamic 3D Gaussians prepared it.

    train_meta.json, test_meta.json      {w, h, k [T][C] 3 x 3, w2c [T][C] 4 x 4, fn [T][C], cam_id [T][C]}
    ims/<fn>                             pictures, undistorted
    seg/<fn>.png                         masks of the moving people and things
    init_pt_cld.npz                      data [P, 7]: x y z, r g b in 0..1, segment; of the first frame

OpenCV axes, world-to-camera, metres, y down; the test cameras are held out (github.com/JonathonLuiten/Dynamic3DGaussians).
"""
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from ...cameras import poses
from ...model.points import usable
from ...util.errors import FastGSError
from ...util.numpy_files import read_array
from ...util.reading import read_json
from ...util.stated_paths import below
from ..capture import Capture, Options, Points
from ..pixels.pictures import opened
from ..rigs import Entry, from_entries
from ..sources import Source

name = "Panoptic (Dynamic 3D Gaussians)"
TRAIN, TEST = "train_meta.json", "test_meta.json"
POINTS = "init_pt_cld.npz"
FPS = 30.0


def recognises(path: Path) -> bool:
    """A folder with train_meta.json, or that file."""
    return (path.is_dir() and (path / TRAIN).is_file()) or path.name == TRAIN


def load(path: Path, options: Options) -> Capture:
    """The capture that train_meta.json and, where it is there, test_meta.json describe."""
    folder = path if path.is_dir() else path.parent
    faults: list[str] = []
    train, count = _entries(folder, TRAIN)
    test: list[Entry] = []
    if (folder / TEST).is_file():
        test, test_count = _entries(folder, TEST)
        if test_count != count:
            faults.append(f"{TRAIN} has {count} frames, {TEST} {test_count}")
    held_out = list(dict.fromkeys(entry.view for entry in test))
    both = sorted(set(held_out) & {entry.view for entry in train})
    if both:
        raise FastGSError(f"{folder / TEST}: the cameras {', '.join(both)} are in {TRAIN} too; a camera can be in one of them only.")
    entries = train + [entry for entry in test if entry.frame < count]
    return from_entries(path, name, entries, options, frame_count=count, fps=FPS, held_out=held_out, points=_points(folder / POINTS),
                        faults=faults)


def _entries(folder: Path, called: str) -> tuple[list[Entry], int]:
    file = folder / called
    values = poses.table(read_json(file), f"{file}: it")
    lacking = [key for key in ("w", "h", "k", "w2c", "fn", "cam_id") if key not in values]
    if lacking:
        raise FastGSError(f"{file}: it lacks {', '.join(lacking)}.")
    columns = {key: poses.listed(values[key], f"{file}: its {key}") for key in ("k", "w2c", "fn", "cam_id")}
    count = len(columns["fn"])
    unequal = [key for key, column in columns.items() if len(column) != count]
    if unequal:
        raise FastGSError(f"{file}: its {unequal[0]} has {len(columns[unequal[0]])} frames, its fn {count}.")
    gain = _mask_gain(folder / "seg")
    entries = []
    for t in range(count):
        rows = {key: poses.listed(column[t], f"{file}: its {key} of frame {t}") for key, column in columns.items()}
        if len({len(row) for row in rows.values()}) > 1:
            raise FastGSError(f"{file}: frame {t} has {', '.join(f'{len(row)} {key}' for key, row in rows.items())}; it must be one each.")
        seen = set()
        for k, w2c, fn, camera in zip(*(rows[key] for key in ("k", "w2c", "fn", "cam_id"))):
            where = f"{file}: frame {t}, camera {shortened(camera)}"
            if not isinstance(camera, (int, str)):
                raise FastGSError(f"{where}: its cam_id must be a number or a text.")
            if str(camera) in seen:
                raise FastGSError(f"{where} is there twice.")
            seen.add(str(camera))
            entries.append(_entry(folder, where, str(camera), t, k, w2c, fn, (values["w"], values["h"]), gain))
    return entries, count


def _entry(folder: Path, where: str, view: str, t: int, k: object, w2c: object, fn: object, size: tuple[object, object],
           gain: float) -> Entry:
    matrix = poses.numbers(k, (3, 3), f"{where}: its k")
    if np.abs(matrix[[1, 2, 2, 2], [0, 0, 1, 2]] - [0, 0, 0, 1]).max() > 1e-6 or abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]):
        raise FastGSError(f"{where}: its k must be a matrix of focal lengths and a principal point, without skew.")
    given = poses.intrinsics(where, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *size)
    picture = below(folder / "ims", fn)
    if picture is None:
        raise FastGSError(f"{where}: its fn must name a picture in ims/, not {shortened(fn)}.")
    mask = folder / "seg" / picture.relative_to(folder / "ims").with_suffix(".png")
    return Entry(view, t, Source(picture, intrinsics=given), poses.rigid(w2c, f"{where}: its w2c"),
                 Source(mask, gain=gain) if gain and mask.is_file() else None)


def _mask_gain(folder: Path) -> float:
    """255 for masks of 0 and 1, as published, 1 for those of 0 and 255, 0 where there are none."""
    first = next(iter(sorted(folder.glob("*/*.png"))), None) if folder.is_dir() else None
    if first is None:
        return 0.0
    try:
        with opened(first) as picture:
            return 255.0 if np.asarray(picture).max() <= 1 else 1.0
    except FastGSError:  # check() tells about the file
        return 1.0


def _points(file: Path) -> Points | None:
    if not file.is_file():
        return None
    data = read_array(file, "data")
    if data.ndim != 2 or data.shape[1] < 6:
        raise FastGSError(f"{file}: its data must have the columns x y z r g b, not the shape {data.shape}.")
    return usable(data[:, :3], data[:, 3:6], np.zeros(len(data)))
