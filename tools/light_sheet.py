# SPDX-License-Identifier: GPL-3.0-or-later
"""The example in the light of a lamp, beside a ball that nobody sees, and the passes that a compositor gets of it: docs/light-passes.webp.

    python tools/light_sheet.py [--out docs/light-passes.webp]
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from sheet import grid

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.poses import look_at  # noqa: E402
from fastgs_blender.rendering.colour import linear_to_srgb  # noqa: E402
from fastgs_blender.rendering.lamps import Lamp, flat  # noqa: E402
from fastgs_blender.rendering.passes import PASSES  # noqa: E402
from fastgs_blender.rendering.relight import SceneLight  # noqa: E402
from fastgs_blender.rendering.shadow import Light  # noqa: E402
from fastgs_blender.surfaces.carving import carved  # noqa: E402
from fastgs_blender.surfaces.views import render_views, subject_of  # noqa: E402

SIZE, T, DETAIL = (400, 250), 0.25, 120
BALL, RADIUS = np.array([0.75, -0.75, 0.3]), 0.3


def ball() -> np.ndarray:
    """Its triangles [F, 3, 3]."""
    u, v = np.meshgrid(np.linspace(0, np.pi, 25), np.linspace(0, 2 * np.pi, 49), indexing="ij")
    grid_ = BALL + RADIUS * np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1)
    a, b, c, d = grid_[:-1, :-1], grid_[1:, :-1], grid_[1:, 1:], grid_[:-1, 1:]
    return np.concatenate([np.stack(each, -2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))])


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "light-passes.webp")
    options = arguments.parse_args()
    model = fg.load(ROOT / "examples" / "fireside.safetensors")
    camera = fg.Camera(*SIZE, 300.0, 300.0, SIZE[0] / 2, SIZE[1] / 2, look_at(np.array([0.5, -2.9, 1.6]), np.array([0.1, 0.0, 0.85])))
    subject = subject_of(model, T)  # Make Mesh without its motion, which one picture does not show
    mesh = carved(subject, render_views(subject, DETAIL, lambda share: None), DETAIL, 2, 0.01, lambda share: None)
    surface = np.concatenate([mesh.vertices[mesh.quads[:, list(corners)]] for corners in ((0, 1, 2), (0, 2, 3))])
    towards = np.array([-1.0, 1.3, -1.6]) / np.linalg.norm([-1.0, 1.3, -1.6])
    lamp = Lamp(Light.rectangle(np.array([1.6, -1.8, 2.4]), (0.2, 0, 0), (0, 0.2, 0), 16), np.array([9.0, 8.0, 6.5]), towards, flat())
    settings = fg.PassSettings(light=SceneLight((lamp,), ball(), bias=0.02))
    pictures = {"captured": fg.render(model, camera, T)["rgb"]}
    for name, settings_of in (("a lamp on captured colours", dict(captured_light=0.25, lamp_light=1.0, shadows=0.9)),
                      ("a lamp on unlit colours", dict(captured_light=0.25, lamp_light=1.0, shadows=0.9, unlit=1.0))):
        shown = fg.Instance(model, np.eye(4), T, fg.ObjectSettings(**settings_of), surface=surface)
        pictures[name] = fg.render([shown], camera, settings=settings)["rgb"]
    shown = fg.Instance(model, np.eye(4), T, surface=surface)
    names = "normal", "unlit", "lamp_light", "mesh_shadow", "lamp_shadow", "contact"
    passes = fg.render([shown], camera, passes=names, settings=settings)
    for name, image in passes.items():
        entry = PASSES[name]
        pictures[entry.blender] = image if entry.colour else linear_to_srgb(image) if entry.channels == 3 and name != "normal" else (
            entry.look(image))
    grid(pictures.items(), 3).save(options.out, quality=85, method=6)
    print(options.out)


if __name__ == "__main__":
    main()
