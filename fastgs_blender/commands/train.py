# SPDX-License-Identifier: GPL-3.0-or-later
"""train a model from a multi-view capture

The folder given with --out gets model.safetensors, and while training runs a checkpoint, a log, previews and status.json.
Ctrl-C saves and stops; --resume continues exactly where the run was, also after it was killed.

Several processes or machines share the work when torchrun starts them:
    torchrun --nproc-per-node=2 -m fastgs_blender train CAPTURE --out DIR
"""
import argparse
import os

from ..model.motion import trained_motions
from ..training.core.presets import PRESETS
from ..util.documentation import page
from ..util.errors import FastGSError
from .shared import add_device, note, print_json, use_threads

FLAGS = {
    "motion": (str, "KIND", f"{', '.join(trained_motions())} or static (default: cosine)"),
    "order": (int, "L", "order of the motion: frequencies, cosines, degree or keyframes (default: the usual one)"),
    "iterations": (int, "N", "steps (default: by the preset)"),
    "batch": (int, "N", "views per step and process"),
    "max_gaussians": (int, "N", "never more Gaussians than this (default: by the preset)"),
    "motion_weight": (float, "X", "lambda of the motion regulariser (default: 0.01)"),
    "density": (str, "KIND", "density control: default or mcmc"),
    "init": (str, "KIND", "source of the starting points: auto, triangulate, file, model or random (default: auto)"),
    "masks": (str, "USE", "how masks are used: auto, cut, weight, only or off (default: auto)"),
    "seed": (int, "N", "seed of all random numbers (default: 0)"),
}
"""Settings with a flag of their own; --set reaches all."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", nargs="?", metavar="CAPTURE", help="the capture: a folder or file that `fastgs info` recognises; not "
                        "needed with --resume")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the model and everything about the run")
    parser.add_argument("--resume", action="store_true", help="continue the run in that folder, with its capture and its options")
    parser.add_argument("--overwrite", action="store_true", help="start again from the beginning if the folder has a run already")
    parser.add_argument("--preset", choices=tuple(PRESETS), help="how long to train, how large a model: draft, standard (the default), "
                        "final; or a published setup: paper, stg")
    parser.add_argument("--basis", choices=("paper",), help="the paper's printed basis of motion: period 1, L = 5")
    for name, (kind, metavar, text) in FLAGS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, metavar=metavar, help=text)
    parser.add_argument("--init-model", metavar="FILE", help="a model to start from, for example one made by a bake")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=f"any other option, see {page('training')}")
    parser.add_argument("--layout", metavar="NAME", help="the capture's layout, where it is not recognised")
    parser.add_argument("--scale", type=float, metavar="X",
                        help="factor on the pictures' size (default: the layout's; smaller for drafts of large ones)")
    parser.add_argument("--frames", metavar="A:B", help="the part of the capture to train on, frames counted from 0 (default: all)")
    parser.add_argument("--scan", metavar="SCAN", help="photographs of the place, as a capture in the same world, such as of a walk around "
                        "it while it is empty: much better with few cameras")
    parser.add_argument("--held-out", metavar="NAME,NAME", help="views to keep for evaluation (default: the layout's)")
    add_device(parser)
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def run(args: argparse.Namespace) -> None:
    from ..training.run.launch import launch, source_of

    use_threads(args.threads)
    if args.capture is None and not args.resume:
        raise FastGSError("name the CAPTURE to train on; only a run that is resumed (--resume) knows its own.")
    held_out = None if args.held_out is None else [name for name in args.held_out.split(",") if name]
    source = source_of(args.capture, args.layout, args.scale, frames_slice(args.frames), held_out, args.scan)
    report = launch(source, args.out, options(args), args.resume, args.overwrite, args.quiet, note, args.device)
    if not report:  # one of several processes, and not the first
        return
    if args.json:
        print_json(report)
    else:
        quality = f", {report['held_out_psnr']:.2f} dB in the held-out views" if "held_out_psnr" in report else ""
        note(f"{report['model']}: {report['gaussians']} Gaussians after {report['iterations']} steps{quality}.")


def options(args: argparse.Namespace) -> dict:
    """The settings given on the command line."""
    from ..training.core.settings import option_from_text

    wanted = dict(option_from_text(text) for text in args.set)
    wanted |= {name: value for name in FLAGS if (value := getattr(args, name)) is not None}
    if args.init_model:
        wanted["init_model"] = os.path.abspath(args.init_model)
    if args.basis == "paper":
        if wanted.get("motion", "paper") != "paper":
            raise FastGSError("--basis paper is a motion of its own; leave out --motion.")
        wanted["motion"] = "paper"
    if args.preset:
        wanted["preset"] = args.preset
    return wanted


def frames_slice(text: str | None) -> slice | None:
    """The part of the time line that "A:B" means, both ends included as everywhere; "A:B:S" in steps."""
    if text is None:
        return None
    from ..util.frames import parse_frames

    frames = parse_frames(text)
    if any(number != int(number) or number < 0 for number in frames):
        raise FastGSError(f"frames of a capture are whole numbers from 0, written A:B, not {text!r}.")
    step = int(frames.numbers[1] - frames.numbers[0]) if len(frames) > 1 else 1
    return slice(int(frames.numbers[0]), int(frames.numbers[-1]) + 1, step)
