# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the contact sheets of docs/passes.md from the example's model: all passes, motion blur, depth of field, sorting, a
panorama.

    python tools/contact_sheets.py [docs]
"""
from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image
from sheet import DARK, grid

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.cameras_json import resized  # noqa: E402
from fastgs_blender.cameras.panorama import Panorama  # noqa: E402
from fastgs_blender.rendering import colour  # noqa: E402
from fastgs_blender.rendering.exposure import Aperture, Exposure  # noqa: E402
from fastgs_blender.rendering.filters import parting, values  # noqa: E402
from fastgs_blender.rendering.instances import Instance  # noqa: E402
from fastgs_blender.rendering.passes import PASSES, SORTINGS, PassSettings  # noqa: E402
from fastgs_blender.rendering.quantities import Mist  # noqa: E402

SIZE = 480, 270
WHEN = 0.4


def shown(name: str, image: dict) -> np.ndarray:
    """A pass as display colours [h, w, 3]."""
    values = image[name]
    if name == "rgb":
        return colour.over(values, image["alpha"], [0.05] * 3)
    if name.endswith("depth"):
        finite = values[np.isfinite(values)]
        near, far = np.percentile(finite, [1, 99])
        return grey(1 - (values - near) / (far - near))
    if name == "position":
        low, high = (np.percentile(values[image["alpha"] > 0.5], q, axis=0) for q in (2, 98))
        return (values - low) / (high - low)
    if name == "normal":
        return values / 2 + 0.5
    if name == "vector":
        return np.concatenate([values[..., 2:] / 8 + 0.5, np.full((*values.shape[:2], 1), 0.5)], -1)
    if name.startswith("cryptomatte"):
        bits = values[..., 0].view(np.uint32)
        tint = np.stack([bits >> shift & 255 for shift in (16, 8, 0)], -1) / 255
        return tint * values[..., 1:2]
    return grey(values / max(float(np.percentile(values, 99.5)), 1e-6))


def grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[..., None], 3, -1)


def sheet(path: Path, pictures: list[tuple[str, np.ndarray]], columns: int):
    grid(pictures, columns, DARK).save(path, quality=86, method=6)
    print(path)


def crossing(turn: float) -> tuple[fg.GaussianModel, fg.Camera]:
    """Six long flat Gaussians that reach through each other like the leaves of a fan, and a camera that has turned by so much."""
    turns = np.linspace(-0.5, 0.5, 6)
    model = fg.GaussianModel(
        position=np.stack([0.9 * np.sin(3 * turns), 0.5 * np.cos(9 * turns), 3 + 0 * turns], 1),
        rotation=np.stack([np.cos(turns), 0.2 * turns, np.sin(turns), 0.4 * turns], 1), scale=np.log(np.tile([0.9, 0.4, 0.01], (6, 1))),
        opacity=np.full(6, 4.0),
        features=[[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.95, 0.75, 0.2], [0.3, 0.7, 0.4], [0.6, 0.3, 0.7], [0.8, 0.8, 0.8]])
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    return model, fg.Camera(*SIZE, 300, 300, SIZE[0] / 2, SIZE[1] / 2, pose)


def popping(path: Path, model, camera):
    """Two frames a tenth of a degree apart, sorted by centre and by pixel; and how much the example jumps on an orbit."""
    rows = []
    for sorting in SORTINGS:
        settings = PassSettings(sorting=sorting)
        before, after = (shown("rgb", fg.render(*crossing(turn), settings=settings)) for turn in (-8.7e-4, 8.7e-4))
        rows += [(f"by {sorting}", before), ("0.1 degrees later", after), ("difference", np.abs(after - before))]
        eyes = [replace(camera, world_to_camera=camera.world_to_camera @ about(camera, model, degrees)) for degrees in np.arange(51) / 50]
        pictures = [fg.render(model, eye, WHEN, settings=settings)["rgb"] for eye in eyes]
        changes = np.array([np.abs(b - a).mean(-1) for a, b in pairwise(pictures)])[:, :128]
        blocks = changes.reshape(len(changes), 16, 8, -1, 8).mean((2, 4))
        frames = np.sqrt((changes**2).mean((1, 2)))
        print(f"by {sorting}: on an orbit of 1 degree around the example, by 0.02 at a time, a block of 8 x 8 pixels changes at most by "
              f"{(blocks - np.median(blocks, 0)).max():.4f} more than it usually does, and the frame by "
              f"{frames.max() / np.median(frames):.2f} times as much as usual")
    sheet(path, rows, 3)


def about(camera, model, degrees: float) -> np.ndarray:
    """The turn [4, 4] of the world about the middle of the model's Gaussians, around the camera's upward axis."""
    middle, axis = np.median(model.position, 0).astype(float), camera.world_to_camera[1, :3]
    a = np.radians(degrees)
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(4)
    turn[:3, :3] = np.eye(3) - np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross
    turn[:3, 3] = middle - turn[:3, :3] @ middle
    return turn


def parts(model) -> list[Instance]:
    """The model as two objects: the room, and the dancer with all that moves above her floor."""
    x, y, z = fg.slice_model(model, WHEN, cull=False).position.T
    speed = values(model, "SPEED")
    dancer = (z > 0.06) & (np.hypot(x, y) < 1.3) & ((np.hypot(x, y) < 0.4) | (speed > parting(speed)))
    return [Instance(model.take(chosen), np.eye(4), WHEN, name=name, index=index)
            for name, index, chosen in (("room", 1, ~dancer), ("dancer", 2, dancer))]


def main(folder: Path):
    model = fg.load(ROOT / "examples/fireside.safetensors")
    camera = resized(fg.load_cameras(ROOT / "examples/cameras.json")[3].camera, *SIZE)
    names = [name for name, entry in PASSES.items() if not entry.level and not entry.meshes]
    image = fg.render(parts(model), camera, passes=names, settings=PassSettings(Mist(2.5, 5.0)))
    sheet(folder / "passes.webp", [(name.replace("_", " "), shown(name, image)) for name in names], 3)

    def picture(**options):
        return shown("rgb", fg.render(model, camera, WHEN, **options))

    sheet(folder / "motion-blur.webp", [("sharp", picture())] + [
        (f"shutter of {text}, 32 steps", picture(exposure=Exposure(-half, half))) for text, half in (("1 frame", 0.5), ("3 frames", 1.5))],
        3)
    depth = image["median_depth"][np.isfinite(image["median_depth"])]
    near, far = np.percentile(depth, [3, 90])
    lens = Aperture(0.01 * float(near + far), float(near), 6)
    sheet(folder / "depth-of-field.webp", [("sharp", picture())] + [
        (f"focus at {distance:.1f}", picture(exposure=Exposure(aperture=replace(lens, distance=float(distance)))))
        for distance in (near, far)], 3)
    popping(folder / "sorting.webp", model, resized(camera, 240, 135))
    pose = np.linalg.inv(camera.world_to_camera)
    pose[:3, 3] += pose[:3, 2] * float(near) * 0.6
    around = fg.render(model, Panorama(960, 480, np.linalg.inv(pose)), WHEN)
    Image.fromarray(np.uint8(np.clip(shown("rgb", around), 0, 1) * 255 + 0.5)).save(folder / "panorama.webp", quality=86, method=6)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs")
