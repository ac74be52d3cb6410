# SPDX-License-Identifier: GPL-3.0-or-later
"""store where a model's capture was filmed from, what its backdrop is, and a good view

Training writes the first two by itself.  MODEL is a FAST-GS .safetensors; its Gaussians stay as they are, byte for byte.

    fastgs annotate model.safetensors --capture my-capture
    fastgs annotate model.safetensors --view cameras.json cam03
    fastgs annotate model.safetensors --backdrop 0 0 0 12
"""
import argparse
from typing import Any

from ..util.errors import FastGSError
from .shared import print_json, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="the model's file")
    parser.add_argument("--out", metavar="FILE", help="write the model there; by default it replaces MODEL")
    parser.add_argument("--capture", metavar="FOLDER", help="the capture that the model was trained on: its cameras are stored")
    parser.add_argument("--scale", type=float, metavar="X",
                        help="with --capture: the size of its pictures in training, as a share of their own, as --scale of train; "
                        "by default that of the capture's layout")
    parser.add_argument("--view", nargs=2, metavar=("FILE", "NAME"), help="look from this camera of a cameras.json first")
    parser.add_argument("--backdrop", nargs=4, type=float, metavar=("X", "Y", "Z", "RADIUS"),
                        help="what lies outside of this sphere, in the model's own space, is backdrop")
    parser.add_argument("--no-backdrop", action="store_true", help="nothing is backdrop")


def run(args: argparse.Namespace) -> None:
    from ..cameras.cameras_json import choose, load_cameras
    from ..cameras.viewpoints import viewpoint_of
    from ..captures import open_capture
    from ..captures.viewpoints import viewpoints
    from ..formats import load
    from ..formats.annotate import annotate
    from ..model.surroundings import Backdrop

    if args.backdrop and args.no_backdrop:
        raise FastGSError("--backdrop and --no-backdrop contradict each other; give one of them.")
    if args.scale is not None and not args.capture:
        raise FastGSError("--scale is the size of a capture's pictures; give --capture as well.")
    known: dict[str, Any] = {}
    if args.capture:
        known["cameras"] = viewpoints(open_capture(args.capture, scale=args.scale))
    if args.view:
        path, name = args.view
        view = choose(load_cameras(path), name, path)
        known["view"] = viewpoint_of(view.camera, view.name)
    if args.backdrop or args.no_backdrop:
        known["backdrop"] = Backdrop(tuple(args.backdrop[:3]), args.backdrop[3]) if args.backdrop else None
    if not known:
        raise FastGSError("there is nothing to store; give --capture, --view or --backdrop.")
    target = args.out or args.model
    annotate(args.model, target, **known)
    around = load(target).surroundings
    if args.json:
        print_json({"file": str(target), "cameras": len(around.cameras), "view": around.view and around.view.name,
                    "backdrop": around.backdrop and [*around.backdrop.centre, around.backdrop.radius]})
    else:
        looked = around.view and (around.view.name or "a view of its own")
        say(f"{target}: {len(around.cameras)} cameras, {'a' if around.backdrop else 'no'} backdrop, {looked or 'no view'}")
