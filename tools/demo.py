# SPDX-License-Identifier: GPL-3.0-or-later
"""A demo of the whole workflow: imports the example model, moves a camera around it, and renders it in Blender through FAST-GS.

    python tools/demo.py [--model FILE] [--out demo]

The model was trained by this project on pictures of a scene of its own (tools/train_example.py).
"""
from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from pathlib import Path

from blender_setup import ROOT, enable_addon, set_image_output

EXAMPLE = ROOT / "examples" / "fireside.safetensors"
POSTER_FRAME = 26
FREEZE = 6, 30
"""Bullet time: the frame of the scene on which the capture freezes, and for how many frames."""


def main():
    arguments = argparse.ArgumentParser(description="Import a model of 4D Gaussians, animate a camera through it and render it in Blender.")
    arguments.add_argument("--model", type=Path, default=EXAMPLE)
    arguments.add_argument("--out", type=Path, default=Path("demo"))
    arguments.add_argument("--size", default="640x360", help="of the film; the poster is twice as wide")
    arguments.add_argument("--animation", type=Path, help="write the film once more as an animated WebP for the README")
    options = arguments.parse_args()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    size = tuple(int(x) for x in options.size.split("x"))
    began = time.monotonic()

    say("Starting Blender")
    enable_addon()
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    say("Importing the model")
    bpy.ops.import_scene.fastgs(filepath=str(options.model.resolve()), set_scene_range=True, use_engine=True)
    splats, scene = bpy.context.object, bpy.context.scene
    shot(bpy, scene, splats)
    scene.view_settings.view_transform = 'Standard'
    scene.render.resolution_percentage = 100
    poster = render_poster(bpy, scene, out / "poster.png", size)
    film = render_film(bpy, scene, out, size)
    if options.animation:
        animate(film, options.animation)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "demo.blend"), check_existing=False)
    print(f"\n{splats.fastgs.gaussian_count:,} Gaussians, {scene.frame_end} frames, {time.monotonic() - began:.0f} s in all:")
    for name, path in (("film", film), ("poster", poster), ("scene", out / "demo.blend")):
        print(f"  {name:7} {path}")


def shot(bpy, scene, splats):
    """Around the dancer in an eased arc; on the way time stands still for a moment."""
    start, frames = FREEZE
    scene.frame_start, scene.frame_end = 1, splats.fastgs.frame_count + frames
    bpy.ops.fastgs.bullet_time(start=start, length=frames, ramp=5)
    target = bpy.data.objects.new("Target", None)
    target.location, target.empty_display_size = (0.0, 0.2, 1.02), 0.1
    scene.collection.objects.link(target)
    for obj in scene.objects:
        obj.select_set(obj == target)
    bpy.context.view_layer.objects.active = target
    bpy.context.view_layer.update()
    bpy.ops.fastgs.camera_orbit(radius=3.1, elevation=0.16, start=-2.42, turns=0.27, rise=0.12, ease=0.5, new_camera=True,
                                frame_start=scene.frame_start, frame_end=scene.frame_end, spacing=8)
    scene.camera.data.lens = 27


def say(text):
    print(f"{text} ...", flush=True)


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


def animate(film, path):
    """The film as an animated WebP, which plays where README is read."""
    import av

    with av.open(str(film)) as container:
        rate = container.streams.video[0].average_rate
        first, *rest = [frame.to_image() for frame in container.decode(video=0)]
    first.save(path, save_all=True, append_images=rest, duration=round(1000 / rate), loop=0, quality=80, method=6)


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
    sys.stderr.write("\n")
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
