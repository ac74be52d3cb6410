# SPDX-License-Identifier: GPL-3.0-or-later
"""write the cameras of a capture, or a camera move, into a file

SOURCE is a capture, a camera file or path of another program, a training run or a model (whose file knows some of the cameras that it was
trained on).  Without --move its cameras are written, each under its name; of a camera that moves, --view NAME writes every frame.

--move makes a path with a camera for each frame, which fastgs render follows:
  orbit  around what the cameras look at
  dolly  from one camera straight on; --zoom keeps the subject's size
  path   smoothly through the cameras, in the order of --views

The file is a cameras.json as 3DGS trainers write it; --format writes those of other programs.  The camera path of nerfstudio is what its
viewer plays; its transforms.json has the cameras of a capture, each with the picture called like it.
"""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..util.errors import FastGSError
from .shared import image_size, note, print_json, say

if TYPE_CHECKING:
    from ..cameras.camera import Camera
    from .sight import Sight


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SOURCE", help="a capture, camera file, training run or model")
    parser.add_argument("--out", required=True, metavar="FILE", help="the file to write")
    parser.add_argument("--format", metavar="NAME", default="cameras.json", help="cameras.json (default), fastgs, transforms.json, "
                        "nerfstudio, instant-ngp, supersplat or colmap")
    parser.add_argument("--view", "--views", dest="views", metavar="NAME,NAME", help="the cameras to use: names, or numbers from 0")
    parser.add_argument("--move", choices=("orbit", "dolly", "path"), help="write a camera move instead")
    parser.add_argument("--frames", type=int, metavar="N", help="frames of the move (default: those of the source's clip, else 100)")
    parser.add_argument("--size", metavar="WxH", help="image size; the horizontal field of view stays the same")
    parser.add_argument("--turns", type=float, default=1.0, metavar="X", help="orbit: turns, negative the other way round (default: 1)")
    parser.add_argument("--elevation", type=float, metavar="DEGREES", help="orbit: above the horizon (default: the first camera's)")
    parser.add_argument("--rise", type=float, default=0.0, metavar="DEGREES", help="orbit: change of the elevation (default: 0)")
    parser.add_argument("--distance", type=float, metavar="X", help="orbit: from the subject (default: the first camera's); dolly: the "
                        "way (default: a third of that to the subject)")
    parser.add_argument("--zoom", action="store_true", help="dolly: the lens changes so that the subject keeps its size")
    parser.add_argument("--closed", action="store_true", help="path: back to the first camera")
    parser.add_argument("--ease", type=float, default=0.0, metavar="X", help="share of the time for starting and stopping, 0 to 1")
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it exists already")


def run(args: argparse.Namespace) -> None:
    from ..cameras.cameras_json import View, resized, save_cameras
    from ..cameras.paths import format_named, save_path
    from ..cameras.paths.base import CameraPath, warn_of_rate
    from .sight import sight

    out = Path(args.out)
    if out.exists() and not args.overwrite:
        raise FastGSError(f"{out} is there already; give another name, or --overwrite to replace it.")
    format_named(args.format)
    size = image_size(args.size) if args.size else None
    seen = sight(args.source)
    views = seen.chosen(args.views.split(",") if args.views else None)
    moving = args.move or any(views is frames for frames in seen.moving.values())
    if args.move:
        views = [View(f"{i:05d}", camera) for i, camera in enumerate(_moved(args, seen, [view.camera for view in views]))]
    views = [View(view.name, resized(view.camera, *size)) for view in views] if size else views
    path = CameraPath([view.camera for view in views], seen.fps, 1, seen.axes, names=() if moving else [view.name for view in views])
    if args.format == "cameras.json":  # which names the frames of a move, too
        warn_of_rate(path, args.format)
        save_cameras(views, out)
    else:
        save_path(path, out, args.format)
    if args.json:
        print_json({"file": str(out), "cameras": len(views), "names": [view.name for view in views]})
    elif not args.quiet:
        say(f"{out}: {len(views)} camera{'s' if len(views) > 1 else ''}")


def _moved(args: argparse.Namespace, seen: Sight, cameras: list[Camera]) -> list[Camera]:
    """The cameras of the move; a remark where they leave what the source's cameras cover."""
    import numpy as np

    from ..cameras import flights, poses

    frames = args.frames or seen.frames or 100
    if args.move == "path":
        path = flights.through(cameras, frames, closed=args.closed, ease=args.ease)
    elif args.move == "orbit":
        path = flights.orbit(cameras, frames, centre=seen.centre, turns=args.turns, elevation=args.elevation, distance=args.distance,
                            rise=args.rise, ease=args.ease)
    else:
        away = float(np.linalg.norm(poses.inverse(cameras[0].world_to_camera)[:3, 3] - seen.centre))
        way = away / 3 if args.distance is None else args.distance
        path = flights.dolly(cameras[0], frames, distance=way, subject=away if args.zoom else None, ease=args.ease)
    if len(seen.views) > 1:
        beyond = flights.outside(path, [view.camera for view in seen.views])
        if beyond.any():
            note(f"from frame {int(np.flatnonzero(beyond)[0])} on the cameras leave the region that the source's cameras cover, by up to "
                 f"{beyond.max():.3g}; expect holes there.")
    return path
