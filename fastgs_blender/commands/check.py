# SPDX-License-Identifier: GPL-3.0-or-later
"""say what is wrong with a capture before training on it

Looks at a few moments of all cameras, for about a minute.  Are the files whole?  Do the cameras stand where the calibration says?  Do
they run together, equally bright and sharp?  How many of them see which part of the scene?  Which views will be poor whatever the
settings?  How much disk, memory and time will training need?

--out (default: a folder beside the capture) gets check.html, one page of pictures and sentences, and check.json.  The exit code is 1 where
something should be put right before training.
"""
import argparse
from pathlib import Path

from .shared import PROBLEMS, add_status, print_json, say, say_table, stages, use_threads


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", metavar="CAPTURE", help="the capture: a folder or file that `fastgs info` recognises")
    parser.add_argument("--out", metavar="DIR", help="folder for the page (default: CAPTURE-check beside the capture)")
    parser.add_argument("--layout", metavar="NAME", help="the capture's layout, where it is not recognised")
    parser.add_argument("--scale", type=float, metavar="X", help="factor on the pictures' size (default: the layout's)")
    parser.add_argument("--frames", metavar="A:B", help="the part of the capture to look at, frames counted from 0 (default: all)")
    parser.add_argument("--held-out", metavar="NAME,NAME", help="views that will not be trained on (default: the layout's)")
    add_status(parser)
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def run(args: argparse.Namespace) -> int:
    from ..checks import check, page
    from .train import frames_slice

    use_threads(args.threads)
    held_out = None if args.held_out is None else [name for name in args.held_out.split(",") if name]
    place = Path(args.capture).resolve()
    name = place.stem if place.is_file() else place.name or "capture"  # a card's root has no name
    out = Path(args.out) if args.out else place.parent / f"{name}-check"
    with stages("checking", args) as tell:
        report = check(args.capture, scale=args.scale, frames=frames_slice(args.frames), held_out=held_out, layout=args.layout,
                       progress=tell)
    paths = page.write(report, out)
    if args.json:
        print_json({**report.values(), "page": str(paths[0])})
    else:
        say_table(f"{report.text()}\n")
        say(f"The page with pictures: {paths[0]}")
    return PROBLEMS if report.bad else 0
