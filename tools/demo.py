# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole way in one go: an animated scene becomes 4D Gaussians, and Blender renders them through FAST-GS.

    python tools/demo.py [--out demo]
"""
from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from pathlib import Path

from blender_setup import enable_addon, set_image_output

BACKDROP = (0.030, 0.034, 0.085)
POSTER_FRAME = 8


def main():
    arguments = argparse.ArgumentParser(description="Bake an animated scene into 4D Gaussians and render it through Blender.")
    arguments.add_argument("--out", type=Path, default=Path("demo"))
    arguments.add_argument("--count", type=int, default=400_000, help="Gaussians, for moving and still objects together")
    arguments.add_argument("--size", default="640x360", help="of the film; the poster is twice as wide")
    arguments.add_argument("--picture", type=Path, help="write the poster once more, small enough for the README")
    options = arguments.parse_args()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    size = tuple(int(x) for x in options.size.split("x"))
    began = time.monotonic()

    say("Starting Blender")
    enable_addon()
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    import demo_scene

    say("Building an animated scene: shape keys, modifiers, keyframes")
    moving, still = demo_scene.build()
    splats = [bake(bpy, moving, out / "moving.safetensors", options.count * 5 // 8),
              bake(bpy, still, out / "still.safetensors", options.count * 3 // 8)]
    for obj in moving + still:
        obj.hide_render = True

    scene = bpy.context.scene
    demo_scene.camera(scene)
    demo_scene.set_world(scene, BACKDROP, 1.0)
    scene.render.engine = 'FASTGS'
    scene.view_settings.view_transform = 'Standard'
    scene.render.resolution_percentage = 100
    poster = render_poster(bpy, scene, out / "poster.png", size)
    if options.picture:
        shrink(poster, options.picture)
    film = render_film(bpy, scene, out, size)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "demo.blend"), check_existing=False)
    total = sum(obj.fastgs.gaussian_count for obj in splats)
    print(f"\n{total:,} Gaussians, {scene.frame_end} frames, {time.monotonic() - began:.0f} s in all:")
    for name, path in (("film", film), ("poster", poster), ("scene", out / "demo.blend")):
        print(f"  {name:7} {path}")


def say(text):
    print(f"{text} ...", flush=True)


def bake(bpy, objects, path, count):
    """Bake objects with the scene's light and import the model, as the operator does from Blender's menu."""
    say(f"Baking {len(objects)} object{'s' * (len(objects) > 1)} into {count:,} Gaussians, with their light")
    for obj in bpy.context.scene.objects:
        obj.select_set(obj in objects)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.fastgs.bake(filepath=str(path), count=count, lighting='CYCLES', light_samples=36, light_frames=6,
                        overwrite=True)
    return bpy.context.object


def render_poster(bpy, scene, path, size):
    say("Rendering a still")
    set_image_output(scene.render.image_settings)
    scene.render.image_settings.color_mode = 'RGB'
    scene.render.image_settings.compression = 100
    scene.render.resolution_x, scene.render.resolution_y = 2 * size[0], 2 * size[1]
    scene.frame_set(POSTER_FRAME)
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return path


def shrink(poster, path):
    """The poster 960 pixels wide, its lowest bit dropped: half the bytes, and nobody sees it."""
    from PIL import Image

    image = Image.open(poster).convert("RGB")
    image = image.resize((960, round(960 * image.height / image.width)), Image.Resampling.LANCZOS)
    image.point(lambda value: min((value + 1) // 2 * 2, 255)).save(path, optimize=True)


def render_film(bpy, scene, out, size):
    """An H.264 film through Blender's own animation render; where this Blender writes no films, a sequence of PNGs."""
    settings = scene.render.image_settings
    scene.render.resolution_x, scene.render.resolution_y = size
    path = out / "demo.mp4"
    try:
        if hasattr(settings, "media_type"):
            settings.media_type = 'VIDEO'
        settings.file_format = 'FFMPEG'
    except TypeError:
        path = out / "frames"
        set_image_output(settings)
        scene.render.filepath = str(path / "frame_")
    else:
        scene.render.ffmpeg.format, scene.render.ffmpeg.codec = 'MPEG4', 'H264'
        scene.render.ffmpeg.constant_rate_factor = 'HIGH'
        scene.render.filepath = str(path)
        scene.render.use_file_extension = False
    bpy.app.handlers.render_post.append(progress(scene))
    with quiet():
        bpy.ops.render.render(animation=True)
    return path


@contextlib.contextmanager
def quiet():
    """Blender's lines about each frame, written past Python, go nowhere meanwhile."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def progress(scene):
    """A handler that keeps one line up to date."""
    began = time.monotonic()

    def show(*_):
        done, total = scene.frame_current - scene.frame_start + 1, scene.frame_end - scene.frame_start + 1
        left = (time.monotonic() - began) / done * (total - done)
        sys.stderr.write(f"\rRendering frame {done} of {total}, {left:.0f} s left ".ljust(60))
        sys.stderr.flush()

    return show


if __name__ == "__main__":
    main()
