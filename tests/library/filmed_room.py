# SPDX-License-Identifier: GPL-3.0-or-later
"""A small room with textured walls, floor and boxes, filmed by cameras on an arc: captures for checks, with faults that are put in."""
from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

from fastgs_blender.captures.layouts.fastgs import write_cameras
from fastgs_blender.util import rotations

SIZE, FOCAL = (320, 240), 300.0
TEXTURE = 512
BOXES = (((-0.75, 0.35, -0.4), (-0.25, 1.0, 0.1)), ((0.3, 0.1, -0.2), (0.8, 1.0, 0.4)))
"""Low and high corners; y points down, the floor is at 1."""
FAR = 1.6
"""The back wall's z."""


@lru_cache(maxsize=8)
def texture(seed: int) -> np.ndarray:
    """[TEXTURE, TEXTURE, 3] in 0..1, with a spectrum of about 1 / f, periodic."""
    rng = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(TEXTURE)[:, None], np.fft.rfftfreq(TEXTURE)[None])
    f[0, 0] = np.inf
    plane = np.fft.irfft2((rng.normal(size=f.shape) + 1j * rng.normal(size=f.shape)) / f, s=(TEXTURE, TEXTURE))
    plane = plane / plane.std()
    colour = rng.uniform(0.35, 0.6, 3)
    return np.clip(colour + 0.16 * plane[..., None] * rng.uniform(0.7, 1.0, 3), 0.06, 0.94)


def pose(angle: float, distance: float = 3.0) -> np.ndarray:
    """World-to-camera of a camera on an arc around the origin, in radians from the middle; it looks at the origin, a little from above."""
    turn = rotations.to_matrices(np.array([np.cos(angle / 2), 0, np.sin(angle / 2), 0]))
    nod = rotations.to_matrices(np.array([np.cos(0.07), np.sin(0.07), 0, 0]))
    matrix = np.eye(4)
    matrix[:3, :3] = nod @ turn
    matrix[2, 3] = distance
    return matrix


@lru_cache(maxsize=128)
def picture(angle: float, moment: float, detail: int = 2) -> np.ndarray:
    """The room [h, w, 3] in 0..1 at a moment (in frames): the second box darts to and fro."""
    world_to_camera = pose(angle)
    width, height = SIZE[0] * detail, SIZE[1] * detail
    x = (np.arange(width) + 0.5 - width / 2) / (FOCAL * detail)
    y = (np.arange(height) + 0.5 - height / 2) / (FOCAL * detail)
    rays = np.stack([*np.broadcast_arrays(x, y[:, None]), np.ones((height, width))], -1) @ world_to_camera[:3, :3]
    origin = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
    nearest, colour = np.full((height, width), np.inf), np.zeros((height, width, 3))
    for k, (axis, at, low, high) in enumerate(_faces(moment)):
        others = [i for i in range(3) if i != axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (at - origin[axis]) / rays[..., axis]
            where = [origin[i] + t * rays[..., i] for i in others]
        inside = (t > 1e-6) & (t < nearest)
        for i, x in zip(others, where):
            inside &= (x >= low[i]) & (x <= high[i])
        nearest[inside] = t[inside]
        uv = np.stack([x[inside] - (low[i] if np.isfinite(low[i]) else 0.0) for i, x in zip(others, where)], 1)  # textures move with boxes
        colour[inside] = _sampled(texture(k % 6), uv * 150)
    return colour.reshape(SIZE[1], detail, SIZE[0], detail, 3).mean((1, 3))


def _faces(moment: float):
    """(axis, place, low, high) of all rectangles."""
    inf = 4.0
    yield 2, FAR, (-inf, -inf, 0), (inf, 1.0, 0)
    yield 1, 1.0, (-inf, 0, -inf), (inf, 0, FAR)
    for n, (low, high) in enumerate(BOXES):
        low, high = np.array(low), np.array(high)
        if n:
            swing = 0.35 * np.sin(0.9 * moment) * (0.3 + 0.7 * np.sin(0.23 * moment + 0.5) ** 2)
            low, high = low + [swing, 0, 0], high + [swing, 0, 0]
        for axis in range(3):
            for at in (low[axis], high[axis]):
                yield axis, at, low, high


def _sampled(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear samples [M, 3], periodic."""
    whole = np.floor(uv).astype(int)
    share = (uv - whole)[..., None]
    (a, b), (c, d) = [[image[(whole[:, 1] + j) % TEXTURE, (whole[:, 0] + i) % TEXTURE] for i in (0, 1)] for j in (0, 1)]
    return (a * (1 - share[:, 0]) + b * share[:, 0]) * (1 - share[:, 1]) + (c * (1 - share[:, 0]) + d * share[:, 0]) * share[:, 1]


def write_room(folder: Path, views: int = 8, frames: int = 5, *, spread: float = 1.2, late: Mapping[int, float] = {},
               change: Mapping[int, Callable[[np.ndarray, int], np.ndarray]] = {}, calibrated: Mapping[int, Callable] = {},
               held_out=(), detail: int = 2) -> Path:
    """A FAST-GS capture of the room.

    spread      radians between the outermost cameras
    late        by camera: frames by which its clock is ahead
    change      by camera: a function of its picture [h, w, 3] and its frame that gives the picture as it is written
    detail      rays across a pixel
    calibrated  by camera: a function of its true pose that gives the one that is written
    """
    cameras = []
    for i, angle in enumerate(np.linspace(-spread / 2, spread / 2, views)):
        name, true = f"cam{i:02}", pose(angle)
        (folder / name).mkdir(parents=True)
        for frame in range(frames):
            rgb = change.get(i, lambda image, frame: image)(picture(float(angle), frame + late.get(i, 0.0), detail), frame)
            Image.fromarray(np.uint8(np.clip(rgb, 0, 1) * 255 + 0.5)).save(folder / name / f"{frame + 1:04}.png", compress_level=1)
        cameras.append({"name": name, "width": SIZE[0], "height": SIZE[1], "fx": FOCAL, "fy": FOCAL, "cx": SIZE[0] / 2, "cy": SIZE[1] / 2,
                        "world_to_camera": calibrated.get(i, lambda matrix: matrix)(true)})
    write_cameras(folder, cameras, frame_count=frames, fps=24, held_out=[f"cam{i:02}" for i in held_out])
    return folder
