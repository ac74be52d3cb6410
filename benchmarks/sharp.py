# SPDX-License-Identifier: GPL-3.0-or-later
"""A model drawn in finer and coarser pixels than it was trained with: against the true picture, and against its small picture enlarged.

    .venv/bin/python benchmarks/sharp.py CAPTURE [--source MODEL] [--scale X] [--steps 1600] [--folder DIR] [--pictures]

CAPTURE is trained on at --scale with its held-out cameras left out (once: the model stays in the folder).  Truth at half, 2 and 4 times
the pixels are its own pictures where these are so large, or, with --source, pictures of the model that was filmed.  With a source there are
also cameras that moved: to half the distance, a fifth farther, and between two cameras.

Each row: PSNR over all channels, mean of views and frames, with antialiasing off, on, and of the small picture enlarged (Lanczos), which is
drawn in pixels as large as the training's.  Prints a table in Markdown.
"""
from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import fastgs_blender as fg
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.evaluation.metrics import psnr
from fastgs_blender.rendering.instances import Instance, ObjectSettings

SIZES = (0.5, 1, 2, 4)
FINEST = 4
"""Truth is drawn at so many times the size, and averaged down."""
SETTINGS = {"off": ObjectSettings(antialias=False), "on": ObjectSettings()}


def eye(camera: fg.Camera) -> np.ndarray:
    """Where it stands [3]."""
    return np.linalg.inv(camera.world_to_camera)[:3, 3]


def larger(camera: fg.Camera, k: float) -> fg.Camera:
    """The camera with k times as many pixels along each side."""
    lens = {name: getattr(camera, name) * k for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, width=round(camera.width * k), height=round(camera.height * k), window=None, **lens)


def moved(camera: fg.Camera, focus: np.ndarray, share: float) -> fg.Camera:
    """The camera at another distance from the depth of the focus, along its own axis."""
    pose = camera.world_to_camera.copy()
    pose[2, 3] -= (1 - share) * (pose[:3, :3] @ focus + pose[:3, 3])[2]
    return replace(camera, world_to_camera=pose)


def between(a: fg.Camera, b: fg.Camera) -> fg.Camera:
    """Half way between two cameras, turned as the first."""
    pose = np.linalg.inv(a.world_to_camera)
    pose[:3, 3] = (eye(a) + eye(b)) / 2
    return replace(a, world_to_camera=np.linalg.inv(pose))


def enlarged(picture: np.ndarray, width: int, height: int) -> np.ndarray:
    """A float picture [h, w, 3] enlarged."""
    planes = [Image.fromarray(np.float32(picture[..., c])).resize((width, height), Image.Resampling.LANCZOS) for c in range(3)]
    return np.clip(np.stack(planes, -1), 0, 1)


def drawn(model, camera, t, kind="on") -> np.ndarray:
    """[h, w, 3] in 0..1."""
    return np.clip(fg.render([Instance(model, np.eye(4), t, SETTINGS[kind])], camera, backend="cpu")["rgb"], 0, 1)


def box(picture: np.ndarray, k: int) -> np.ndarray:
    """A picture averaged over k x k pixels."""
    h, w = picture.shape[0] // k * k, picture.shape[1] // k * k
    return picture[:h, :w].reshape(h // k, k, w // k, k, 3).mean((1, 3))


class Scene:
    """A capture, the model that was trained on it, and true pictures of what it films."""

    def __init__(self, args):
        self.capture = fg.open_capture(args.capture, scale=args.scale, held_out=args.held_out)
        self.whole = fg.open_capture(args.capture, scale=1, held_out=args.held_out)
        self.store = FrameStore(self.whole)
        self.source = args.source and fg.load(args.source)
        path = args.folder / "model.safetensors"
        if not path.exists():
            fg.train(args.capture, args.folder, scale=args.scale, device="cpu", iterations=args.steps, max_gaussians=20000,
                     preview_every=0, overwrite=True, held_out=args.held_out)
        self.model = fg.load(path)
        self.shots = {}
        for shot, whole in zip(self.capture.held_out, self.whole.held_out):
            if shot.frame in args.frames:
                self.shots[shot.view, shot.frame] = shot, whole

    def truth(self, camera, k, t, whole=None):
        """The true picture of a camera with k times the pixels."""
        if self.source is not None:
            t += 0.5 / self.model.clip.frame_count  # as refilm.py films
            return box(drawn(self.source, larger(camera, FINEST), t, "off"), round(FINEST / k))
        picture = self.store.pixels(whole).rgb
        most = picture.shape[1] // camera.width
        return box(picture, round(most / k)) if k <= most else None

    def rows(self):
        """(place, size, view and frame, camera of training size, truth) of every picture."""
        focus = np.asarray(self.capture.focus, np.float64)
        for (view, frame), (shot, whole) in self.shots.items():
            places = {"trained": shot.camera}
            if self.source is not None:
                own = eye(shot.camera)
                nearest = sorted((s.camera for s in self.capture.training if s.frame == frame),
                                 key=lambda camera: np.linalg.norm(eye(camera) - own))
                places |= {"half as far": moved(shot.camera, focus, 0.5), "a fifth farther": moved(shot.camera, focus, 1.2),
                           "between": between(nearest[0], nearest[1])}
            for place, camera in places.items():
                for k in SIZES:
                    yield place, k, (view, frame), camera, shot.t, self.truth(camera, k, shot.t, whole)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--source", type=Path)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--held-out", nargs="+")
    parser.add_argument("--steps", type=int, default=1600)
    parser.add_argument("--frames", type=int, nargs="+", default=[1, 5])
    parser.add_argument("--folder", type=Path, default=Path("build/sharp"))
    parser.add_argument("--pictures", action="store_true", help="write PNGs of the first view beside the model")
    args = parser.parse_args()
    scene, found, first = Scene(args), {}, {}
    for place, k, key, camera, t, truth in scene.rows():
        if truth is None:
            continue
        nearer = {"half as far": 2, "a fifth farther": 1 / 1.2}.get(place, 1)
        own = larger(camera, k)
        pictures = {kind: drawn(scene.model, own, t, kind) for kind in SETTINGS}
        if k * nearer > 1:
            pictures["enlarged"] = enlarged(drawn(scene.model, larger(camera, 1 / nearer), t), own.width, own.height)
        for kind, picture in pictures.items():
            found.setdefault((place, k), {}).setdefault(kind, []).append(psnr(picture, truth))
        if args.pictures and first.setdefault((place, k), key) == key:
            for kind, picture in (pictures | {"truth": truth}).items():
                Image.fromarray(np.uint8(picture * 255 + 0.5)).save(args.folder / f"{place.replace(' ', '_')}_{k}_{kind}.png")
    print("| camera | pixels | off | on | enlarged |\n|---|---|---|---|---|")
    for (place, k), kinds in found.items():
        cells = [f"{np.mean(kinds[kind]):.2f}" if kind in kinds else "" for kind in ("off", "on", "enlarged")]
        print(f"| {place} | {k:g}x | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
