# SPDX-License-Identifier: GPL-3.0-or-later
"""find the part of a clip that can be played over and over

It compares small pictures of all frames, and how they change, and proposes where to cut.  The end fades into the beginning for a few
frames.  The numbers say how much the picture changes at the seam, by how much it changes from frame to frame.  Where no cut is better, it
proposes the whole clip.

    fastgs loop model.safetensors --least 20 --fade 6

In Blender, Make Loop does it with the object.
"""
import argparse

from .shared import model_file, print_json, say_table, shares, use_threads


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="a model file, or the folder that fastgs train wrote")
    parser.add_argument("--least", type=float, metavar="FRAMES", help="frames that the loop lasts at least (default: half of the clip)")
    parser.add_argument("--fade", type=float, default=8.0, metavar="FRAMES", help="frames over which the end fades into the beginning "
                        "(default: 8)")
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def run(args: argparse.Namespace) -> None:
    from .. import formats
    from ..stitching.loops import find_loop
    from ..util.screen import screen

    use_threads(args.threads)
    source = formats.open_source(model_file(args.model))
    with shares("comparing", args) as show:
        loop = find_loop(source, least=args.least, fade=args.fade, progress=show)
    if args.json:
        print_json({"model": args.model, **vars(loop)})
        return
    cut = "the whole clip, because no cut is better" if loop.uncut else f"frames {loop.start:g} to {loop.start + loop.length:g}"
    say_table(screen([
        ("loop", f"{cut}, {loop.length:g} frames"), ("fade", f"{loop.fade:g} frames"),
        ("seam", f"{loop.cut:.2f} times the usual change, {loop.blended:.2f} with the fade; {loop.whole:.2f} for the whole clip"),
        ("motion", f"alike by {loop.motion:.2f} on both sides"),
        ("in Blender", f"Trim Start {loop.start:g}, End {source.clip.frame_count - loop.end:g}, Loop Fade {loop.fade:g}"),
    ], True))
