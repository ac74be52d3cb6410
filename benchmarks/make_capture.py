# SPDX-License-Identifier: GPL-3.0-or-later
"""A multi-view capture of an animated Blender scene, rendered with Cycles: ground truth from an independent renderer.

    python benchmarks/make_capture.py --scene robot --out captures/robot
    python benchmarks/make_capture.py --scene procedural --out captures/procedural
    python benchmarks/make_capture.py --scene room --out captures/room
    python benchmarks/make_capture.py --scene my.glb --action Walk --cameras 24 --frames 60 --size 640x480 --out captures/mine

Writes cameras.json, camNN/0001.png ..., masks/camNN/0001.png (white: what moves) and things/camNN/0001.png: the number, in things.json, of
the object that covers most of a pixel.  cam00 is held out and stands among the others.  --beside films the same scene from beside the
rig, --depth writes depth/camNN/0001.npy as well: truths for views that no camera had.  A file without lights gets a floor, surroundings
and light.  Pictures that are there already are kept, so a stopped run goes on.
"""
from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks"), str(ROOT / "tests" / "library")]

import capture_scenes as scenes  # noqa: E402
import room_scene  # noqa: E402
from touching_scenes import SCENES  # noqa: E402

from fastgs_blender.cameras.poses import look_at  # noqa: E402
from fastgs_blender.captures import generated  # noqa: E402
from fastgs_blender.rendering import colour  # noqa: E402
from fastgs_blender.util.outputs import replacing  # noqa: E402

ROBOT = ROOT.parent / "shared" / "data" / "robot" / "RobotExpressive.blend"
PRESETS = {"robot": dict(cameras=18, frames=40, size="480x360", samples=8, angle=42.0, distance=0.9),
           "procedural": dict(cameras=14, frames=30, size="320x240", samples=8, angle=42.0, distance=0.78),
           "room": dict(cameras=18, frames=48, size="400x300", samples=16, angle=44.0, distance=1.0),
           "touching": dict(cameras=12, frames=16, size="240x180", samples=4, angle=42.0, distance=1.25)}
SKY = 1e9
"""Depth from which on Cycles means that nothing was hit."""
MADE = {"procedural": scenes.procedural, "room": room_scene.furnished,
        **{name.replace(" ", "_"): lambda frames, make=make: scenes.touching(make()[0], frames) for name, make in SCENES.items()}}
"""The scenes that are made here, of so many frames; others are read from files."""


def main():
    options = parse()
    if options.scene in MADE:
        MADE[options.scene](options.frames)
    else:
        scenes.open_file(options.file, options.action)
    scene = bpy.context.scene
    first, last = scene.frame_start, scene.frame_end
    step = min(1.0, max((last - first) / options.frames, 1e-3))
    times = first + step * np.arange(options.frames)
    whole = np.linspace(first, last, 40, endpoint=False)  # the rig is the same whatever part of the animation is filmed
    moving = scenes.moving_meshes(whole)
    centre, radius, floor = scenes.extent(moving, whole)
    subject = scenes.with_companions(moving)
    if options.scene in MADE:
        floor = 0.0 if options.scene == "procedural" else floor - 0.02
    distance = options.distance * radius / np.sin(np.radians(options.angle) / 2)
    if not any(o.type == 'LIGHT' for o in scene.objects):
        scenes.stage(centre, radius, floor, 1.7 * distance)

    width, height = (int(x) for x in options.size.split("x"))
    focal = height / 2 / np.tan(np.radians(options.angle) / 2)
    if options.scene == "room":
        eyes, centre = room_scene.rig(options.cameras)
    else:
        eyes = centre + distance * generated.directions(options.cameras, options.rig)
    eyes = beside(eyes, centre, options.beside)
    poses = {f"cam{k:02}": look_at(eye, centre) for k, eye in enumerate(eyes)}
    write_description(options, poses, (width, height, focal), scene.render.fps / step)
    render(options, set_up(scene, width, height, focal, options), poses, times, {o.name for o in subject})


def beside(eyes, centre, degrees: float) -> np.ndarray:
    """The eyes [N, 3], each turned farther from the front (-y) around the vertical through the centre [3], to its own side."""
    x, y, z = (eyes - centre).T
    turn = np.radians(degrees) * np.where(x < 0, -1, 1)
    return centre + np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], 1)


def parse():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="robot", help=f"robot, {', '.join(MADE)}, or a .blend or .glb file")
    parser.add_argument("--robot", type=Path, default=ROBOT, help="where RobotExpressive.blend lies")
    parser.add_argument("--action", help="which action the rigs do; for the robot Robot_Dance")
    parser.add_argument("--cameras", type=int)
    parser.add_argument("--frames", type=int, help="of the animation, from its start on; denser where it is shorter")
    parser.add_argument("--size", help="of a picture, as 480x360")
    parser.add_argument("--samples", type=int, help="of Cycles, for each pixel; denoised")
    parser.add_argument("--rig", choices=("dome", "arc"), default="dome")
    parser.add_argument("--beside", type=float, default=0.0, metavar="DEGREES", help="turn each camera so far to its own side")
    parser.add_argument("--depth", action="store_true", help="write depths along the view, float32, inf where nothing is")
    parser.add_argument("--angle", type=float, help="vertical angle of view in degrees")
    parser.add_argument("--distance", type=float, help="of the cameras; 1: the subject's sphere just fits")
    parser.add_argument("--only-frames", type=int, help="stop after so many pictures (to look at them first); every n-th is taken")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    for name, value in PRESETS.get(options.scene, PRESETS["touching" if options.scene in MADE else "robot"]).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    options.file = options.robot if options.scene == "robot" else Path(options.scene)
    options.action = options.action or ("Robot_Dance" if options.scene == "robot" else None)
    if options.scene not in MADE and not options.file.is_file():
        parser.error(f"{options.file} is not there; give a .blend or .glb file, robot, {', '.join(MADE)}")
    return options


def write_description(options, poses, lens, fps):
    """cameras.json; and make_capture.json, by which a run that goes on knows that it continues the same capture."""
    width, height, focal = lens
    pinhole = dict(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
    cameras = [dict(name=name, **pinhole, world_to_camera=matrix.tolist()) for name, matrix in poses.items()]
    made = {"scene": options.scene if options.scene in MADE else options.file.name, "action": options.action,
            "rig": options.rig, "samples": options.samples, "blender": bpy.app.version_string}
    made |= {"beside": options.beside} if options.beside else {}
    files = {"cameras.json": {"format": "fast-gs capture", "version": 1, "fps": fps, "start_frame": 1, "frame_count": options.frames,
                              "axes": "RFU", "held_out": ["cam00"], "cameras": cameras},
             "make_capture.json": made}
    options.out.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        text, path = json.dumps(content, indent=1), options.out / name
        if path.exists() and path.read_text(encoding="utf-8") != text:
            raise SystemExit(f"{path} belongs to a capture with other settings; choose another folder or remove this one.")
        with replacing([path]) as (part,):
            part.write_text(text, encoding="utf-8")


# Pictures


def set_up(scene, width, height, focal, options):
    """Cycles with few samples and a fast denoiser, the same noise in every picture; returns the camera."""
    scene.render.engine = 'CYCLES'
    cycles, render = scene.cycles, scene.render
    cycles.device, cycles.samples, cycles.use_adaptive_sampling = 'CPU', options.samples, False
    cycles.seed, cycles.use_animated_seed = 0, False
    cycles.use_denoising, cycles.denoiser, cycles.denoising_prefilter = True, 'OPENIMAGEDENOISE', 'FAST'
    cycles.max_bounces = 4
    if options.scene == "room":  # lit without noise
        cycles.use_denoising, cycles.max_bounces = False, 0
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1
    render.use_border = render.use_motion_blur = render.film_transparent = False
    render.use_persistent_data, render.use_compositing, render.use_sequencer = True, False, False
    if options.threads:
        render.threads_mode, render.threads = 'FIXED', options.threads
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = 'MULTI_LAYER_IMAGE'
    render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR_MULTILAYER', '32'
    for layer in scene.view_layers:
        layer.use_pass_cryptomatte_object, layer.pass_cryptomatte_depth = True, 6
        layer.use_pass_z = options.depth
    camera = bpy.data.objects.new("Capture", bpy.data.cameras.new("Capture"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.sensor_fit, camera.data.sensor_width, camera.data.lens_unit = 'HORIZONTAL', 36, 'MILLIMETERS'
    camera.data.lens, camera.data.clip_start, camera.data.clip_end = 36 * focal / width, 0.01, 1e4
    return camera


def render(options, camera, poses, times, subject):
    from mathutils import Matrix

    work = [(frame, name) for frame in range(options.frames) for name in poses]
    if options.only_frames:
        work = work[:: max(1, len(work) // options.only_frames)]
    for name in poses:
        (options.out / name).mkdir(exist_ok=True)
        (options.out / "masks" / name).mkdir(parents=True, exist_ok=True)
        (options.out / "things" / name).mkdir(parents=True, exist_ok=True)
    names = sorted(o.name for o in bpy.context.scene.objects if o.type == 'MESH' and not o.hide_render)
    (options.out / "things.json").write_text(json.dumps({name: number for number, name in enumerate(names, 1)}, indent=1), encoding="utf-8")
    bar = tqdm(work, unit="picture", smoothing=0.05)
    last = None
    with tempfile.TemporaryDirectory() as folder:
        bpy.context.scene.render.filepath = str(Path(folder, "picture.exr"))
        for frame, name in bar:
            picture = options.out / name / f"{frame + 1:04}.png"
            files = [picture, *(options.out / kind / name / picture.name for kind in ("masks", "things"))]
            if all(file.exists() for file in files):
                continue
            if frame != last:
                scenes.go_to(times[frame])
                last = frame
            camera.matrix_world = Matrix((np.linalg.inv(poses[name]) @ np.diag([1, -1, -1, 1])).tolist())
            bpy.ops.render.render(write_still=True)
            depth = options.out / "depth" / name / f"{picture.stem}.npy" if options.depth else None
            save(bpy.context.scene.render.filepath, subject, names, files, depth)


def save(path, subject, names, files, depth):
    """The denoised image as sRGB (view transform Standard), how much of each pixel the subject covers, what covers most of it, and depths
    if wanted."""
    import OpenEXR
    from PIL import Image

    with OpenEXR.File(path, separate_channels=True) as file:
        header = dict(file.header())
        planes = {name.split(".", 1)[-1]: channel.pixels for k in range(len(file.parts)) for name, channel in file.channels(k).items()}
    rgb = np.stack([planes[f"Combined.{c}"] for c in "RGB"], -1)
    manifest = next(value for name, value in header.items() if name.startswith("cryptomatte/") and name.endswith("/manifest"))
    cover = generated.cover(planes, manifest, subject)
    if depth is not None:
        depth.parent.mkdir(parents=True, exist_ok=True)
        plane = next(plane for name, plane in planes.items() if name.startswith("Depth."))
        np.save(depth, np.where(plane < SKY, plane, np.inf).astype(np.float32))
    each = np.stack([np.full(cover.shape, 1e-3, np.float32), *(generated.cover(planes, manifest, [name]) for name in names)])
    images = [colour.linear_to_srgb(np.clip(rgb, 0, 1)), cover, each.argmax(0) / 255]
    for target, image in zip(files, images):
        with replacing([target]) as (part,), part.open("wb") as file:
            Image.fromarray(np.floor(image * 255 + 0.5).astype(np.uint8)).save(file, format="PNG")


if __name__ == "__main__":
    main()
