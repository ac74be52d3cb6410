# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture small enough to train on in seconds: coloured blobs, some of which move, before a patchwork of others."""
from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

import fastgs_blender as fg
from fastgs_blender.captures.capture import Capture, Points, Shot
from fastgs_blender.captures.pixels.store import Pixels

SIZE = (48, 36)


def toy_scene(frames: int = 6) -> fg.GaussianModel:
    """The truth: 60 Gaussians that stand and 20 that travel and swing."""
    rng = np.random.default_rng(5)
    still, moving = 60, 20
    n = still + moving
    grid = np.stack(np.meshgrid(np.linspace(-2.2, 2.2, 10), np.linspace(-1.7, 1.7, 6)), -1).reshape(-1, 2)
    position = np.zeros((n, 3))
    position[:still] = np.concatenate([grid, np.full((still, 1), 1.2)], 1)
    position[still:] = rng.uniform(-0.6, 0.6, (moving, 3))
    motion = np.zeros((n, 4, 3))
    motion[still:, 0, 0], motion[still:, 1, 1] = 0.5, 0.3
    rotation = np.zeros((n, 4))
    rotation[:, 0] = 1
    return fg.GaussianModel(
        position=position, rotation=rotation, scale=np.log(np.where(np.arange(n) < still, 0.4, 0.16))[:, None] + np.zeros((1, 3)),
        opacity=np.where(np.arange(n) < still, 4.0, 2.5), features=rng.uniform(0.05, 0.95, (n, 3)), motion=motion,
        basis=fg.Cosine(4, frames / max(frames - 1, 1)), clip=fg.Clip(frames, 24.0, 1))


def toy_cameras(views: int) -> list[fg.Camera]:
    """Cameras on an arc in front of the scene."""
    cameras = []
    for angle in np.linspace(-0.5, 0.5, views):
        matrix = np.eye(4)
        matrix[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        matrix[2, 3] = 4.0
        cameras.append(fg.Camera(*SIZE, 45.0, 45.0, SIZE[0] / 2, SIZE[1] / 2, matrix))
    return cameras


class MemoryStore:
    """The pixels of shots, by view and frame; with mask: straight colour, and the picture's alpha as mask."""

    plain, whole = None, False

    def __init__(self, model, shots, mask=False):
        self.pictures = {}
        for shot in shots:
            image = fg.render(model, shot.camera, shot.t)
            rgb, alpha = np.clip(image["rgb"], 0, 1), image["alpha"]
            straight = rgb / np.maximum(alpha, 1e-6)[..., None]
            self.pictures[shot.view, shot.frame] = Pixels(straight, alpha) if mask else Pixels(rgb)

    def pixels(self, shot):
        return self.pictures[shot.view, shot.frame]

    def of(self, capture):
        return self

    def missing(self, shots):
        return []

    def fill(self, progress=None, shots=()):
        pass


def toy_capture(frames: int = 6, views: int = 5, mask: bool = False):
    """(capture, store, points): the first view is held out; points lie near the Gaussians of the truth."""
    model = toy_scene(frames)
    shots = [Shot(f"cam{v:02}", f, camera, None, None, v == 0, f / frames)
             for f in range(frames) for v, camera in enumerate(toy_cameras(views))]
    capture = Capture(Path("toy"), "test", shots, model.clip)
    rng = np.random.default_rng(7)
    xyz = (model.position + rng.normal(0, 0.05, (len(model), 3))).astype(np.float32)
    return capture, MemoryStore(model, shots, mask), Points(xyz, model.features.copy())


def write_capture(folder: Path, frames: int = 6, views: int = 5) -> Path:
    """The same capture as files as a FAST-GS capture."""
    capture, store, points = toy_capture(frames, views)
    write_shots(folder, capture, store)
    rows = "".join("{:.6f} {:.6f} {:.6f} {} {} {}\n".format(*p, *np.uint8(np.clip(c, 0, 1) * 255)) for p, c in zip(points.xyz, points.rgb))
    header = "".join(f"property float {axis}\n" for axis in "xyz") + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    (folder / "points.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{header}end_header\n{rows}", "utf-8")
    return folder


def write_shots(folder: Path, capture: Capture, store: MemoryStore) -> None:
    """The pictures and cameras of a capture as files of a FAST-GS capture."""
    cameras = []
    for shot in capture.at_frame(0):
        c = shot.camera
        cameras.append({"name": shot.view, "width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
                        "world_to_camera": c.world_to_camera.tolist()})
    for shot in capture.shots:
        path = folder / shot.view / f"{shot.frame + 1:04d}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.uint8(np.round(store.pixels(shot).rgb * 255))).save(path, compress_level=1)  # a quarter of the time
    (folder / "cameras.json").write_text(json.dumps({
        "format": "fast-gs capture", "version": 1, "fps": 24, "start_frame": 1, "frame_count": capture.clip.frame_count, "axes": "RDF",
        "held_out": ["cam00"], "cameras": cameras}), "utf-8")


def write_examples(folder: Path) -> Path:
    """The examples that come with the repository, their model with every eighth Gaussian: commands take the same steps, sooner."""
    examples = Path(__file__).resolve().parents[2] / "examples"
    shutil.copytree(examples, folder, ignore=shutil.ignore_patterns("*.py"))
    (path,) = folder.glob("*.safetensors")
    fg.save(fg.load(path).take(slice(None, None, 8)), path)
    return folder
