# SPDX-License-Identifier: GPL-3.0-or-later
"""What Geometry Nodes on all Gaussians cost: python benchmarks/points.py [--gaussians 100000] [--frames 8]

A node tree moves, fades and recolours every Gaussian of a moving model.  Milliseconds of processor time a frame, medians:

* plain frame    a frame change without points, and the instances of the new frame
* points         the same with *Modifiers Change: Splats*, without a modifier: what giving points costs
* native copy    a frame change with a copy that holds the frame as a mesh of discs
* nodes          the same with the tree: giving, Blender's evaluation, reading back, and the edited model
* F12            the library's picture of 960 x 540 of each of these

and by how much a picture of them differs from the library's own edit of the model: not more than 1e-4.

Needs a Python with Blender's bpy.
"""
from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path

import numpy as np
from viewport import load_extension, module

SIZE = 960, 540


def capture(fg, n: int):
    """A ball of moving Gaussians with harmonics."""
    rng = np.random.default_rng(0)
    return fg.GaussianModel(
        position=rng.normal(0, 1, (n, 3)), rotation=rng.normal(size=(n, 4)), scale=rng.normal(-4, 0.5, (n, 3)), opacity=rng.normal(1, 2, n),
        features=rng.normal(0, 0.3, (n, 12)), appearance=fg.SH(1), motion=rng.normal(0, 0.02, (n, 10, 3)), basis=fg.Fourier(5),
        clip=fg.Clip(300, 30.0), axes="RFU")


def tree():
    """The nodes: a sine of x is added to y, opacity is halved, red and blue are swapped."""
    import bpy

    build = module("scene.splats.effects").Builder
    point_edits = module("scene.point_edits")
    made = bpy.data.node_groups.new("Measured", 'GeometryNodeTree')
    for way in ('INPUT', 'OUTPUT'):
        made.interface.new_socket("Geometry", in_out=way, socket_type='NodeSocketGeometry')
    b = build(made)
    wave = b.vector('SINE', b.vector('MULTIPLY', b.position(), (5.0, 0.0, 0.0)))
    x = b.node('ShaderNodeSeparateXYZ', (wave,)).outputs[0]
    geometry = b.moved(b.given("Geometry"), b.vector('SCALE', (0.0, 0.3, 0.0), x))
    geometry = b.store(geometry, point_edits.OPACITY, b.math('MULTIPLY', b.attribute(point_edits.OPACITY), 0.5))
    parts = b.node('ShaderNodeSeparateXYZ', (b.attribute(point_edits.COLOR),)).outputs
    swapped = b.node('ShaderNodeCombineXYZ', (parts[2], parts[1], parts[0])).outputs[0]
    b.node('NodeGroupOutput', (b.store(geometry, point_edits.COLOR, swapped),))
    return made


def own_edit(model, t):
    """The same by the library."""
    edits, colour = module("fastgs_blender.model.edits"), module("fastgs_blender.rendering.colour")
    now = edits.state_of(model, t)
    offset = np.zeros_like(now.position)
    offset[:, 1] = 0.3 * np.sin(5 * now.position[:, 0])
    linear = colour.srgb_to_linear(np.clip(now.colour, 0, None))
    return edits.Edit(t, now.position + offset, opacity=0.5 * now.opacity, colour=colour.linear_to_srgb(linear[:, ::-1])).applied(model)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=8)
    args = parser.parse_args(arguments)
    user = load_extension()
    import bpy

    fg = module("fastgs_blender")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    path, model = Path(user) / "points.safetensors", capture(fg, args.gaussians)
    fg.save(model, path)
    model = fg.load(path)
    bpy.ops.import_scene.fastgs(filepath=str(path))
    scene, obj = bpy.context.scene, bpy.context.object
    scene.render.fps = round(model.clip.fps)
    pose = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 5], [0, 0, 0, 1]])
    camera = fg.Camera(*SIZE, 800, 800, SIZE[0] / 2, SIZE[1] / 2, pose)

    def instances():
        return module("scene.snapshot").take(bpy.context.evaluated_depsgraph_get()).load()[0]

    def measured() -> tuple[float, float]:
        frames, pictures = [], []
        for number in range(-1, args.frames):
            begin = time.process_time()
            scene.frame_set(40 + 3 * number)
            shown = instances()
            middle = time.process_time()
            fg.render(shown, camera)
            if number >= 0:
                frames.append(1e3 * (middle - begin))
                pictures.append(1e3 * (time.process_time() - middle))
        return statistics.median(frames), statistics.median(pictures)

    print(f"{args.gaussians:,} Gaussians, milliseconds of processor time a frame, medians of {args.frames}")
    plain = measured()
    obj.fastgs.points = 'ALL'
    points = measured()
    obj.modifiers.new("Measured", 'NODES').node_group = tree()
    nodes = measured()
    scene.frame_set(41)
    found = fg.render(instances(), camera)
    obj.modifiers.remove(obj.modifiers["Measured"])
    obj.fastgs.points = 'SOME'
    bpy.ops.fastgs.native_copy(kind='DISCS')
    copied = measured()
    for name, (frame, picture) in {"plain frame": plain, "native copy": copied, "points": points, "nodes": nodes}.items():
        print(f"{name:<12} {frame:8.0f} ms, F12 {picture:8.0f} ms: {(frame + picture) / sum(plain):5.2f} plain frames")
    wanted = fg.render(own_edit(model, 40 / 300), camera)
    difference = max(float(np.abs(found[name] - wanted[name]).max()) for name in found)
    print(f"difference to the library's own edit of the model: {difference:.1e}; bound 1e-4")
    return int(difference > 1e-4)


if __name__ == "__main__":
    sys.exit(main())
