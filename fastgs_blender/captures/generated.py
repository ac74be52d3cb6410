# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a rendered capture: camera positions, the subject's coverage of a picture by Cryptomatte, points from depth."""
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..cameras.camera import Camera
from ..rendering.cryptomatte import in_pictures
from ..util.rotations import transformed


def directions(count: int, rig: str = "dome") -> np.ndarray:
    """Unit vectors [count, 3] from the subject to the cameras: z up, the first among the others, in front (-y).

    dome  all around, 10 to 55 degrees above the horizon; arc: 110 degrees in front
    """
    k = np.arange(count) + 0.5
    if rig == "arc":
        azimuth = np.radians(-90 + 110 * (k / count - 0.5))
        rise = np.radians(22 + 10 * np.cos(np.pi * (k - 0.5)))
    else:
        low, high = np.sin(np.radians((10, 55)))
        rise = np.arcsin(low + (high - low) * k / count)
        azimuth = np.pi * (3 - np.sqrt(5)) * k
    middle = count // 2
    order = [middle, *(i for i in range(count) if i != middle)]
    azimuth = (azimuth - (azimuth[middle] + np.pi / 2) * (rig == "dome"))[order]
    rise = rise[order]
    return np.stack([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)], 1)


def cover(planes: dict[str, np.ndarray], manifest: str | bytes, names: Iterable[str]) -> np.ndarray:
    """The share of each pixel [h, w] that the objects of these names cover, read from Cryptomatte.

    planes    CryptoObject00.r ... by name; manifest: JSON, from objects' names to hexadecimal hashes
    """
    names = set(names)
    wanted = np.array([in_pictures(int(code, 16)) for name, code in json.loads(manifest).items() if name in names], np.uint32)
    share = np.zeros(next(plane.shape for name, plane in planes.items() if name.startswith("CryptoObject")), np.float32)
    level = 0
    while any(name.startswith(f"CryptoObject{level:02}.") for name in planes):
        found = {name.rpartition(".")[2].lower(): plane for name, plane in planes.items() if name.startswith(f"CryptoObject{level:02}.")}
        for identity, part in ("rg", "ba"):
            ids = np.ascontiguousarray(found[identity], np.float32).view(np.uint32)
            share += np.where(np.isin(ids, wanted), found[part], 0)
        level += 1
    return np.clip(share, 0, 1)


def unproject(camera: Camera, depth: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """World places [M, 3] of pixels of a pinhole camera whose depth [h, w] is measured along its axis."""
    z = depth[rows, columns].astype(np.float64)
    x = (columns + 0.5 - camera.cx) / camera.fx * z
    y = (rows + 0.5 - camera.cy) / camera.fy * z
    return transformed(np.stack([x, y, z], 1), np.linalg.inv(camera.world_to_camera))


def write_points(path: Path, xyz: np.ndarray, rgb: np.ndarray, t: np.ndarray) -> None:
    """A points.ply: xyz [P, 3], rgb [P, 3] uint8, t [P] in 0..1, NaN for points that are there all the time."""
    table = np.zeros(len(xyz), [(name, "<f4") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")] + [("t", "<f4")])
    for i, name in enumerate("xyz"):
        table[name] = xyz[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        table[name] = rgb[:, i]
    table["t"] = t
    properties = "".join(f"property {'uchar' if table.dtype[name] == np.uint8 else 'float'} {name}\n" for name in table.dtype.names or ())
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{properties}end_header\n"
    with open(path, "wb") as file:
        file.write(header.encode() + table.tobytes())
