# SPDX-License-Identifier: GPL-3.0-or-later
"""How far Vector, Depth and Normal of baked meshes are from those of the meshes themselves, where they are opaque.

    python benchmarks/baked_passes.py [--gaussians 100000] [--size 320x240] [--only arm]

A torus turns and travels as between two keyframes of Blender, over clips of several lengths; a thinner one also makes a quarter turn at a
constant rate.  An arm bends.  Everything is baked with the defaults, sampled twice per frame, and seen at a third of the clip.
"""
from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import fastgs_blender as fg
from fastgs_blender.util import rotations

OPAQUE = 0.99


def torus(thin: float, along: int = 64, around: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a torus of radius 1."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    a, b = 2 * np.pi * i / along, 2 * np.pi * j / around
    points = np.stack([np.cos(a) * (1 + thin * np.cos(b)), np.sin(a) * (1 + thin * np.cos(b)), thin * np.sin(b)], 1)
    corner = [((i + di) % along) * around + (j + dj) % around for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return points, np.concatenate([np.stack([corner[0], corner[1], corner[2]], 1), np.stack([corner[0], corner[2], corner[3]], 1)])


def arm(along: int = 24, around: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a tube along z, from -1.5 to 1.5, that becomes thinner."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(along + 1), np.arange(around), indexing="ij"))
    radius = 0.3 - 0.08 * i / along
    points = np.stack([radius * np.cos(2 * np.pi * j / around), radius * np.sin(2 * np.pi * j / around), 3 * i / along - 1.5], 1)
    a, b = (j + i * around)[i < along], ((j + 1) % around + i * around)[i < along]
    return points, np.concatenate([np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)])


def bent(points: np.ndarray, share: float) -> np.ndarray:
    """The arm's points when this share of the clip is over: it bends by 120 degrees and back, and turns by 46."""
    angle, weight = 0.1 + 2.2 * np.sin(np.pi * share) ** 2, 1 / (1 + np.exp(-points[:, 2:] / 0.12))
    turns = [rotations.to_matrices(rotations.exp(np.array([each])))[0] for each in ([0, angle / 2, 0], [0, 0, 0.4 * share + 0.2])]
    return ((1 - weight) * points + weight * (points @ turns[0].T) + [-0.5, 0, 0.3]) @ turns[1].T


def steady(points: np.ndarray, share: float) -> np.ndarray:
    """The points when this share of a quarter turn at a constant rate is done."""
    return points @ rotations.to_matrices(rotations.exp(np.array([[0.0, 0, np.pi / 4 * share]])))[0].T + [0.8 * share - 0.4, 0, 0]


def moved(points: np.ndarray, share: float) -> np.ndarray:
    """The points when this share of the way is done."""
    done = share**2 * (3 - 2 * share)
    turn = rotations.to_matrices(rotations.unit(np.array([[1.0, 0.5 * done, 0.4 * done, 0.9 * done]])))[0]
    return points @ turn.T + np.array([1.6 * done - 0.8, 0.6 * done - 0.3, 0.2 * done])


def truth(now: np.ndarray, following: np.ndarray, triangles: np.ndarray, camera: fg.Camera):
    """(depth [h, w], inf where nothing is; normal [h, w, 3]; motion to the next frame [h, w, 2]) of the mesh at the pixels' centres."""
    view = camera.local(now)
    to_world = camera.world_to_camera[:3, :3]
    after = camera.pixels(following @ to_world.T + camera.world_to_camera[:3, 3])
    pixels, depth = camera.pixels(view), np.full((camera.height, camera.width), np.inf)
    normal, motion = np.zeros((*depth.shape, 3)), np.zeros((*depth.shape, 2))
    following_depth = (following @ to_world.T + camera.world_to_camera[:3, 3])[:, 2]
    for corners in triangles:
        p, z = pixels[corners], view[corners, 2]
        (left, top), (right, bottom) = np.floor(p.min(0)).astype(int), np.ceil(p.max(0)).astype(int)
        x, y = np.meshgrid(np.arange(max(left, 0), min(right, camera.width)), np.arange(max(top, 0), min(bottom, camera.height)))
        matrix = np.concatenate([p.T, np.ones((1, 3))])
        if not x.size or abs(np.linalg.det(matrix)) < 1e-9:
            continue
        share = np.stack([x + 0.5, y + 0.5, np.ones(x.shape)], -1) @ np.linalg.inv(matrix).T
        weight = share / z  # perspective: shares of the surface, not of the picture
        near = 1 / weight.sum(-1)
        weight *= near[..., None]
        hit = (share >= 0).all(-1) & (near < depth[y, x])
        rows = y[hit], x[hit]
        depth[rows] = near[hit]
        across = np.cross(now[corners[1]] - now[corners[0]], now[corners[2]] - now[corners[0]])
        normal[rows] = across / np.linalg.norm(across)
        weight = weight[hit] * following_depth[corners]
        there = (weight @ after[corners]) / weight.sum(-1, keepdims=True)
        motion[rows] = there - np.stack([x[hit] + 0.5, y[hit] + 0.5], -1)
    return depth, normal, motion


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--size", default="320x240")
    parser.add_argument("--only", default="", help="the meshes whose names have this in them")
    args = parser.parse_args()
    width, height = (int(side) for side in args.size.split("x"))
    pose = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 6], [0, 0, 0, 1]])
    camera = fg.Camera(width, height, 1.4 * width, 1.4 * width, width / 2, height / 2, pose)
    print(f"{args.gaussians:,} Gaussians, {width} x {height}; Vector in pixels, Depth in percent, Normal in degrees")
    print(f"{'mesh':24} {'frames':>6} {'motion':>7}   Vector: mean, median   Depth: mean   Normal: median")
    meshes = {"torus": (*torus(0.25), moved), "thin torus": (*torus(0.12), moved), "thin torus, steady": (*torus(0.12), steady),
              "bending arm": (*arm(), bent)}
    for name, (points, triangles, place) in meshes.items():
        if args.only not in name:
            continue
        for frames in (12, 24, 48):
            times = np.arange(2 * frames - 1) / 2
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                model, _ = fg.bake(np.stack([place(points, time / (frames - 1)) for time in times]), triangles, frames=times,
                                   frame_count=frames, count=args.gaussians)
            frame = frames // 3
            found = fg.render(model, camera, frame / frames, passes=("alpha", "depth", "normal", "vector"))
            depth, normal, motion = truth(*(place(points, (frame + step) / (frames - 1)) for step in (0, 1)), triangles, camera)
            solid = (found["alpha"] > OPAQUE) & np.isfinite(depth)
            off = np.linalg.norm(found["vector"][..., 2:] * [-1, 1] - motion, axis=-1)[solid]
            angle = np.degrees(np.arccos(np.clip(np.abs((found["normal"] * normal).sum(-1))[solid], 0, 1)))
            wrong = np.abs(found["depth"][solid] / depth[solid] - 1)
            print(f"{name:24} {frames:6} {np.linalg.norm(motion[solid], axis=-1).mean():7.1f}   {off.mean():12.3f}, "
                  f"{np.median(off):6.3f}   {100 * wrong.mean():11.2f}   {np.median(angle):14.1f}", flush=True)


if __name__ == "__main__":
    main()
