# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the contact sheets of docs/passes.md from the example's model: all passes, motion blur, depth of field, a panorama.

    python tools/contact_sheets.py [docs]
"""
from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.cameras_json import resized  # noqa: E402
from fastgs_blender.cameras.panorama import Panorama  # noqa: E402
from fastgs_blender.rendering import colour  # noqa: E402
from fastgs_blender.rendering.exposure import Aperture, Exposure  # noqa: E402
from fastgs_blender.rendering.instances import Instance  # noqa: E402
from fastgs_blender.rendering.passes import PASSES, PassSettings  # noqa: E402
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
    """Pictures with their names, a few a row."""
    width, height, gap, line = *SIZE, 6, 22
    rows = -(-len(pictures) // columns)
    out = Image.new("RGB", (columns * (width + gap) - gap, rows * (height + line + gap) - gap), (24, 24, 26))
    for i, (name, values) in enumerate(pictures):
        x, y = i % columns * (width + gap), i // columns * (height + line + gap)
        pixels = np.uint8(np.clip(np.nan_to_num(values), 0, 1) * 255 + 0.5)
        out.paste(Image.fromarray(pixels), (x, y + line))
        ImageDraw.Draw(out).text((x + 6, y + 4), name, fill=(230, 230, 230))
    out.save(path, quality=86, method=6)
    print(path)


def parts(model) -> list[Instance]:
    """The model without its backdrop as two objects: the floor, and what stands on it."""
    place = fg.slice_model(model, WHEN, cull=False).position
    near = np.linalg.norm(place - np.median(place, 0), axis=1) < 3.0
    low = place[:, 2] < np.percentile(place[near, 2], 30)
    return [Instance(model.take(near & chosen), np.eye(4), WHEN, name=name, index=index)
            for name, index, chosen in (("floor", 1, low), ("things", 2, ~low))]


def main(folder: Path):
    model = fg.load(ROOT / "examples/playground.safetensors")
    camera = resized(fg.load_cameras(ROOT / "examples/cameras.json")[0].camera, *SIZE)
    names = [name for name, entry in PASSES.items() if not entry.level and not entry.meshes]
    image = fg.render(parts(model), camera, passes=names, settings=PassSettings(Mist(2.5, 5.0)))
    sheet(folder / "passes.webp", [(name.replace("_", " "), shown(name, image)) for name in names], 3)

    def picture(**options):
        return shown("rgb", fg.render(model, camera, WHEN, **options))

    sheet(folder / "motion-blur.webp", [("sharp", picture()), ("shutter of 1 frame, 32 steps", picture(exposure=Exposure(-0.5, 0.5)))], 2)
    depth = image["median_depth"][np.isfinite(image["median_depth"])]
    near, far = np.percentile(depth, [15, 75])
    lens = Aperture(0.03 * float(near + far), float(near), 6)
    sheet(folder / "depth-of-field.webp", [("sharp", picture())] + [
        (f"focus at {distance:.1f}", picture(exposure=Exposure(aperture=replace(lens, distance=float(distance)))))
        for distance in (near, far)], 3)
    pose = np.linalg.inv(camera.world_to_camera)
    pose[:3, 3] += pose[:3, 2] * float(near) * 0.6
    around = fg.render(model, Panorama(960, 480, np.linalg.inv(pose)), WHEN)
    Image.fromarray(np.uint8(np.clip(shown("rgb", around), 0, 1) * 255 + 0.5)).save(folder / "panorama.webp", quality=86, method=6)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs")
