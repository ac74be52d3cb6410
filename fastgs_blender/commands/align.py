# SPDX-License-Identifier: GPL-3.0-or-later
"""find the motion that lays one model on another where both show the same surfaces

It prints the matrix, how far the surfaces are apart, and how much of them overlaps.  Where no fit is sure, it says so.

    fastgs align second.safetensors first.safetensors --scale

In Blender, Align by Overlap moves the object.
"""
import argparse

from ..util.errors import FastGSError
from .shared import model_file, print_json, say_table, shares, use_threads


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("moving", metavar="MOVING", help="the model that is moved")
    parser.add_argument("fixed", metavar="FIXED", help="the model that stays")
    parser.add_argument("--scale", action="store_true", help="let its size change too")
    parser.add_argument("--frames", nargs=2, type=float, default=(0.0, 0.0), metavar=("A", "B"), help="the frames of both at which they "
                        "are compared (default: 0 0)")
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def run(args: argparse.Namespace) -> None:
    import numpy as np

    from .. import formats
    from ..rendering.instances import Instance
    from ..stitching.fitting import align
    from ..util.screen import screen

    use_threads(args.threads)
    pair = []
    for path, frame in zip((args.moving, args.fixed), args.frames, strict=True):
        source = formats.open_source(model_file(path))
        if not 0 <= frame < max(source.clip.frame_count, 1):
            raise FastGSError(f"{path} has the frames 0 to {source.clip.frame_count - 1}, so there is no frame {frame:g}.")
        model, t = source.moment(source.clip.t_of_frame(frame))
        pair.append(Instance(model, np.eye(4), t, name=path))
    with shares("fitting", args) as show:
        found = align(*pair, scale=args.scale, progress=show)
    if args.json:
        print_json({"matrix": found.matrix.tolist(), "scale": found.scale, "residual": found.residual, "overlap": found.overlap,
                    "agreement": found.agreement})
        return
    rows = [("matrix" if k == 0 else "", "  ".join(f"{value:12.6f}" for value in row)) for k, row in enumerate(found.matrix)]
    say_table(screen([*rows, ("scale", f"{found.scale:.5g}"), ("apart", f"{found.residual:.4g} units where they overlap"),
                      ("overlap", f"{found.overlap:.0%} of the smaller one's surface"), ("agreement", f"{found.agreement:.0%}")], True))
