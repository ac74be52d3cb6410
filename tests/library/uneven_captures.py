# SPDX-License-Identifier: GPL-3.0-or-later
"""A small capture whose cameras are neither genlocked nor equally exposed, with the truth known."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from toy_captures import MemoryStore, Pixels, toy_cameras, toy_scene, write_shots

import fastgs_blender as fg
from fastgs_blender.captures.capture import Capture, Points, Shot


def lively_scene(frames: int, terms: int = 8, speed: float = 1.0) -> fg.GaussianModel:
    """The toy scene whose moving Gaussians dart about, now fast, now slowly."""
    scene = toy_scene(frames)
    rng = np.random.default_rng(11)
    motion = np.zeros((len(scene), terms, 3))
    together = rng.normal(0, 1, (1, terms, 3)) + 0.4 * rng.normal(0, 1, (20, terms, 3))
    motion[60:] = speed * 0.5 * together / np.sqrt(np.arange(1, terms + 1))[:, None]
    motion[60:, :, 2] *= 0.3
    return replace(scene, motion=motion, basis=fg.Cosine(terms, frames / max(frames - 1, 1)))


def uneven_capture(frames: int, views: int, offsets: Mapping[str, float] = {}, gains: Mapping[str, tuple] = {},
                   speed: float = 1.0, terms: int = 8, zoom: int = 1):
    """(capture, store, points) like toy_capture's: shots have the times that genlocked cameras would have, while view v's picture f shows
    the moment f + offsets[v], its colours times gains[v]."""
    model = lively_scene(frames, terms, speed)
    cameras = [fg.Camera(zoom * c.width, zoom * c.height, zoom * c.fx, zoom * c.fy, zoom * c.cx, zoom * c.cy, c.world_to_camera)
               for c in toy_cameras(views)]
    shots = [Shot(f"cam{v:02}", f, camera, None, None, v == 0, f / frames) for f in range(frames) for v, camera in enumerate(cameras)]
    capture = Capture(Path("uneven"), "test", shots, model.clip)
    filmed = [replace(shot, t=shot.t + offsets.get(shot.view, 0.0) / frames) for shot in shots]
    store = MemoryStore(model, filmed)
    for (view, frame), pixels in store.pictures.items():
        store.pictures[view, frame] = Pixels(np.clip(pixels.rgb * np.float32(gains.get(view, 1.0)), 0, 1).astype(np.float32))
    rng = np.random.default_rng(7)
    xyz = (model.position + rng.normal(0, 0.05, (len(model), 3))).astype(np.float32)
    return capture, store, Points(xyz, model.features.copy())


def write_uneven(folder: Path, frames: int, views: int, offsets: Mapping[str, float] = {}, gains: Mapping[str, tuple] = {},
                 speed: float = 1.0, zoom: int = 1) -> Path:
    """The same as files of a FAST-GS capture."""
    capture, store, _ = uneven_capture(frames, views, offsets, gains, speed, zoom=zoom)
    write_shots(folder, capture, store)
    return folder
