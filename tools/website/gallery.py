# SPDX-License-Identifier: GPL-3.0-or-later
"""The models of the site's gallery, their pages, and their moving pictures in docs/gallery.

    python tools/website/gallery.py [NAME ...]            models and pictures
    python tools/website/gallery.py --models [NAME ...]   the models alone, those that are not there yet

The models go to build/gallery, compressed, and `make site` makes a page of each.  All are made of what is in the repository.
"""
from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import fastgs_blender as fg

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tools"), str(ROOT / "benchmarks")]
EXAMPLE = ROOT / "examples" / "fireside.safetensors"
MODELS, PICTURES = ROOT / "build" / "gallery", ROOT / "docs" / "gallery"
BACKGROUND = "#242c35"
"""Of the pages of what is transparent where nothing is."""
SIZE, FRAMES, QUALITY = (400, 300), 36, 40
WINDOW = (960, 540)
"""Of a page's camera."""
SEEN = 7
"""Cameras of a swing by which its model is judged."""


@dataclass(frozen=True)
class Entry:
    """A model of the gallery.

    title, words       what its card says
    target             what the camera looks at
    eye                from there to the camera: distance, and the angles around and above in degrees
    sway               how far the camera swings to each side, in degrees
    turns_back         whether the clip plays there and back; otherwise it begins anew
    count, samples     how many Gaussians a bake has, and Cycles' samples of the light on each; 0: colours without light
    open               whether its picture is transparent where nothing is; a room fills it
    """

    title: str
    words: str
    target: tuple[float, float, float]
    eye: tuple[float, float, float]
    sway: float
    turns_back: bool = False
    count: int = 0
    samples: int = 0
    open: bool = False


ENTRIES = {
    "dancer": Entry("A dancer", "Trained from twelve cameras. She dances there and back, without a seam.", (0.0, 0.2, 1.0),
                    (3.0, -8, 8), 12, turns_back=True),
    "room": Entry("A room", "Furniture and two people, baked with the light of Cycles.", (0.0, 0.6, 0.9), (3.3, 0, 14), 14,
                  turns_back=True, count=150_000, samples=32),
    "robot": Entry("A robot", "Forty rigid parts, baked without training. Its dance has no seam.", (0.0, 0.0, 0.95), (3.7, 18, 10), 24,
                   count=60_000, samples=32, open=True),
    "fire": Entry("Fire and cloth", "A flame, a flag, thrown balls and spinners, baked.", (0.0, 0.0, 0.8), (3.4, 10, 10), 18,
                  turns_back=True, count=50_000, open=True),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *ENTRIES], metavar="NAME", help=f"{', '.join(ENTRIES)}; default: all")
    parser.add_argument("--models", action="store_true", help="take no pictures")
    args = parser.parse_args()
    for name in args.names or ENTRIES:
        if not model_of(name).exists():
            making = multiprocessing.get_context("spawn").Process(target=bake, args=(name, model_of(name)))  # one Blender for each scene
            making.start()
            making.join()
            if making.exitcode:
                sys.exit(f"The model of {name} was not made; the reason stands above.")
            print(f"{model_of(name).relative_to(ROOT)}: {model_of(name).stat().st_size / 1e6:.1f} MB")
        if not args.models:
            picture = film(name)
            print(f"{picture.relative_to(ROOT)}: {picture.stat().st_size / 1000:.0f} kB")


def model_of(name: str) -> Path:
    """The file of an entry's model, which may not be there yet."""
    return EXAMPLE if ENTRIES[name].count == 0 else MODELS / f"{name}.safetensors"


def bake(name: str, path: Path) -> None:
    """The entry's model: the bake of its scene, compressed."""
    from blender_setup import ADDON, enable_addon

    enable_addon()
    import addon_utils
    import bpy
    import capture_scenes
    import robot
    import room_scene

    import fastgs_blender as fg

    entry = ENTRIES[name]
    {"room": room_scene.furnished, "robot": robot.dancing, "fire": capture_scenes.procedural}[name](FRAMES)
    addon_utils.enable(ADDON)  # a scene of its own begins with factory settings
    for obj in bpy.context.scene.objects:
        obj.select_set(obj.type == 'MESH' and not obj.hide_render)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        whole = Path(folder) / path.name
        bpy.ops.fastgs.bake(filepath=str(whole), count=entry.count, max_order=24, import_result=False,
                            lighting='CYCLES' if entry.samples else 'NONE', light_samples=max(entry.samples, 1), light_frames=4)
        pack(name, fg.load(whole), path)


def pack(name: str, model: fg.GaussianModel, path: Path) -> None:
    """Write an entry's model compressed; a room is judged from where its page looks, for others would see the backs of its walls."""
    import fastgs_blender as fg
    from fastgs_blender.cameras.viewpoints import viewpoint_of

    entry = ENTRIES[name]
    cameras = [moment(entry, part, model.clip.frame_count, WINDOW)[0] for part in np.linspace(0.25, 0.75, SEEN)]
    seen = tuple(viewpoint_of(camera, f"{name} {k}", entry.eye[0]) for k, camera in enumerate(cameras))
    told = model if entry.open else replace(model, surroundings=replace(model.surroundings, cameras=seen))
    with warnings.catch_warnings(action="ignore", category=fg.LossWarning):
        fg.save(told, path, compress="fine")


def film(name: str) -> Path:
    """The entry as an animated WebP that loops, transparent where nothing is."""
    from PIL import Image

    import fastgs_blender as fg
    from fastgs_blender.rendering.colour import display

    entry, model, pictures = ENTRIES[name], fg.load(model_of(name)), []
    for k in range(FRAMES):
        image = fg.render(model, *moment(entry, k / FRAMES, model.clip.frame_count))
        colour = display(image["rgb"], image["alpha"], model.colour_space)
        shown = np.dstack([colour, image["alpha"]]) if entry.open else colour
        pictures.append(Image.fromarray(np.uint8(np.round(255 * np.clip(shown, 0, 1)))))
    target = PICTURES / f"{name}.webp"
    target.parent.mkdir(exist_ok=True)
    seconds = model.clip.frame_count / model.clip.fps * (2 if entry.turns_back else 1)
    pictures[0].save(target.with_stem(f"{name}-still"), quality=QUALITY)
    pictures[0].save(target, save_all=True, append_images=pictures[1:], duration=round(1000 * seconds / FRAMES), loop=0, quality=QUALITY,
                     alpha_quality=QUALITY)
    return target


def play(name: str, target: Path) -> None:
    """The entry as a web page, with the camera's swing as its opening move."""
    import fastgs_blender as fg
    from fastgs_blender.formats.web import kept_file, save_page
    from fastgs_blender.formats.web.page import Page, PageObject
    from fastgs_blender.rendering.colour import srgb_to_linear

    entry, model = ENTRIES[name], fg.load(model_of(name))
    frames = model.clip.frame_count * (2 if entry.turns_back else 1)
    cameras, times = zip(*(moment(entry, k / frames, model.clip.frame_count, WINDOW) for k in range(frames)), strict=True)
    behind = srgb_to_linear(np.array([int(BACKGROUND[i:i + 2], 16) / 255 for i in (1, 3, 5)]) * entry.open)
    page = Page([PageObject(model, times=times)], cameras, entry.title, frames, model.clip.fps, background=behind.tolist(),
                pivot=entry.target)
    target.parent.mkdir(parents=True, exist_ok=True)
    save_page(page, target, packed={model: kept_file(model_of(name))})


def moment(entry: Entry, part: float, frames: int, size: tuple[int, int] = SIZE) -> tuple:
    """The camera and the model's t at a part of the loop, 0 to 1."""
    import fastgs_blender as fg

    turn = 2 * np.pi * part
    distance, around, above = entry.eye[0], *np.radians(entry.eye[1:])
    around += np.radians(entry.sway) * np.sin(turn)
    eye = np.array(entry.target) + distance * np.array([np.sin(around) * np.cos(above), -np.cos(around) * np.cos(above), np.sin(above)])
    focal = 1.15 * size[1]
    camera = fg.Camera(*size, focal, focal, size[0] / 2, size[1] / 2, fg.look_at(eye, entry.target))
    return camera, (0.5 - 0.5 * np.cos(turn)) * (frames - 1) / frames if entry.turns_back else part


if __name__ == "__main__":
    main()
