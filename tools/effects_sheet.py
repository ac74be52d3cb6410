# SPDX-License-Identifier: GPL-3.0-or-later
"""The example under each effect of Geometry Nodes, and bent by a lattice: docs/effects.webp.  Needs a Python with Blender's bpy.

    python tools/effects_sheet.py [--out docs/effects.webp]
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "benchmarks")]
from looks_sheet import FRAME, PAPER, camera  # noqa: E402
from sheet import grid  # noqa: E402
from viewport import load_extension, module  # noqa: E402

SHOTS = (
    ("as the file says", None, {}),
    ("Dissolve 0.35", 'DISSOLVE', {"Amount": 0.35, "Noise Scale": 2.5, "Drift": (0.0, 0.0, 0.5)}),
    ("Dissolve 0.65", 'DISSOLVE', {"Amount": 0.65, "Noise Scale": 2.5, "Drift": (0.0, 0.0, 0.5)}),
    ("Wind", 'WIND', {"Strength": 1.0, "Turbulence": 0.3, "Noise Scale": 1.2}),
    ("Scatter 0.15", 'SCATTER', {"Amount": 0.15}),
    ("Scatter 0.6", 'SCATTER', {"Amount": 0.6}),
    ("Sweep 0.4", 'SWEEP', {"Amount": 0.4}),
    ("Freeze at a Distance", 'FREEZE', {"Distance": 0.5, "Width": 0.2}),
)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "effects.webp")
    options = arguments.parse_args()
    load_extension()
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.fastgs.import_example()
    obj, scene = bpy.context.object, bpy.context.scene
    scene.frame_set(int(obj.fastgs.start_frame) + FRAME)
    pictures = {}
    for name, effect, values in SHOTS:
        if effect is not None:
            bpy.ops.fastgs.add_effect(effect=effect)
            modifier = obj.modifiers.active
            for key, value in values.items():
                module("scene.splats.effects").set_input(modifier, key, value)
        pictures[name] = picture(bpy)
        if effect is not None:
            obj.modifiers.remove(modifier)
    lattice = bpy.data.objects.new("Lattice", bpy.data.lattices.new("Lattice"))
    scene.collection.objects.link(lattice)
    lattice.location, lattice.scale = (0, 0, 1.5), (7, 5.4, 3.2)
    for index, turn in enumerate((0.0, 0.9)):
        for point in list(lattice.data.points)[4 * index:4 * index + 4]:
            x, y, z = point.co
            point.co_deform = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z
    modifier = obj.modifiers.new("Lattice", 'LATTICE')
    modifier.object = lattice
    pictures["a twisted lattice"] = picture(bpy)
    grid(pictures.items(), 4).save(options.out, quality=85, method=6)
    print(options.out)


def picture(bpy) -> np.ndarray:
    """uint8 [h, w, 3] of what the scene shows, over paper."""
    bpy.context.view_layer.update()
    parts, _ = module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()
    fg = module("fastgs_blender")
    out = fg.render(parts, fg.Camera(**vars(camera())))
    alpha = out["alpha"][..., None]
    straight = np.clip(module("fastgs_blender.rendering.colour").display(out["rgb"], out["alpha"], parts[0].model.colour_space), 0, 1)
    return np.round(255 * straight * alpha + np.array(PAPER) * (1 - alpha)).astype(np.uint8)


if __name__ == "__main__":
    main()
