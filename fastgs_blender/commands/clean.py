# SPDX-License-Identifier: GPL-3.0-or-later
"""leave out of a model what spoils it beside the cameras: floaters, haze, what was never filmed, stray colours

    fastgs clean run cleaned.safetensors
    fastgs clean model.ply cleaned.ply --strength 0.8 --kinds floaters,colours

MODEL is a model or a training run; the format of OUT follows from its name.  A table says how many Gaussians are left out and why.  Of
what is found, those are left out without which the pictures of the capture's cameras change least.  A file that knows no cameras has no
such bound, and only floaters and stray colours can be judged; fastgs annotate stores the cameras.
"""
import argparse
from pathlib import Path

from ..util.errors import FastGSError
from .shared import human_bytes, model_file, note, print_json, refuse_existing, say, say_table, shares, use_threads


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="the model, or the folder of a training run")
    parser.add_argument("output", metavar="OUT", help="the file to write")
    parser.add_argument("--strength", type=float, default=0.5, metavar="X", help="how much is left out, 0 to 1 (default: 0.5)")
    parser.add_argument("--kinds", metavar="NAME,NAME", help="some of unseen, haze, floaters and colours (default: all)")
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it exists already")
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def run(args: argparse.Namespace) -> None:
    import numpy as np

    from .. import formats
    from ..model.gaussians import GaussianModel
    from ..selecting.clean import KINDS, clean

    use_threads(args.threads)
    out = Path(args.output)
    source = formats.open_source(model_file(args.model))
    if not isinstance(source, GaussianModel):
        raise FastGSError(f"{args.model} is a sequence, whose frames have other Gaussians each; fastgs convert makes one model of it.")
    refuse_existing([out, *formats.written_files(source, out)], args)
    kinds = None if args.kinds is None else args.kinds.split(",")
    with shares("looking", args) as show:
        found = clean(source, args.strength, kinds=kinds, progress=show)
    left = source.take(~found.taken)
    if not len(left):
        raise FastGSError(f"nothing would be left of {args.model}; give a smaller --strength.")
    formats.save(left, out)
    counts = {name: int(bits.sum()) for name, bits in found.found.items()}
    decibels = None if not found.loss else round(-10 * float(np.log10(found.loss)), 1)
    if args.json:
        print_json({"model": args.model, "output": str(out), "gaussians": len(source), "left": len(left), "found": counts,
                    "unjudged": list(found.unjudged), "psnr_of_change": decibels})
    elif not args.quiet:
        say_table("\n".join([*(f"{name:<10}{count:>10}  {KINDS[name].meaning}" for name, count in counts.items()),
                             f"{'left':<10}{len(left):>10}  of {len(source)} Gaussians"]))
        if decibels is not None:
            say(f"The pictures of its cameras change little: {decibels:.1f} dB between before and after.")
        say(f"{out}: {human_bytes(out.stat().st_size)}")
    if found.unjudged:
        note(f"the file knows no cameras of its capture, so {' and '.join(found.unjudged)} cannot be judged, nor what its pictures lose; "
             "fastgs annotate stores the cameras.")
