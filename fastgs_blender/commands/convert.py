# SPDX-License-Identifier: GPL-3.0-or-later
"""write a model in another format, or frames of it as static models

The format of OUT follows from its name.  Whatever that format cannot hold is reported at the end, one line each.
With --at FRAME the model is written as it is at that frame, counted from 0; fractions are allowed.  With --at A:B or A:B:S, both ends
included, a file is written for each frame.  OUT then says where the number goes: out_####.ply or out_%04d.ply.
If its name ends in .html, OUT is a web page that plays the model offline.  It holds a compressed file, and takes one as it is.
IN may be a sequence: a folder or a zip of numbered files, or a pattern of their names (take_####.ply).  Without --at one model is fitted
to its frames, which must hold the same Gaussians in the same order; what is lost says how well.
With --chapters a .safetensors file or a web page is read part by part while it plays, so that a clip of any length needs little memory.
--then adds more models, which play after IN.
"""
from __future__ import annotations

import argparse
import contextlib
import re
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..util.documentation import page
from ..util.errors import FastGSError, LossWarning
from ..util.progress import Progress, progress
from . import web_page
from .shared import human_bytes, note, note_frames_outside, print_json, refuse_existing, say

if TYPE_CHECKING:
    from ..model.chapters import Chapters
    from ..model.gaussians import GaussianModel
    from ..model.sequence import Source
    from ..util.frames import Frames

PLACE = re.compile(r"%0?(\d*)d|(#{2,})")
PARTS = 100
"""Steps of the progress of each file."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", metavar="IN", help="the model, or the sequence, to read")
    parser.add_argument("output", metavar="OUT", help="the file to write")
    parser.add_argument("--at", metavar="FRAME", help="write a static model of this frame, or of each frame of A:B")
    parser.add_argument("--compress", metavar="LEVEL", nargs="?", const="fine",
                        help="write .safetensors, or what a page holds, compressed: fine (the default; pictures lose at most 0.1 dB of "
                             "held-out views), small (0.3 dB; takes minutes), or another number of dB")
    parser.add_argument("--chapters", metavar="FRAMES", nargs="?", type=int, const=60,
                        help="write a .safetensors file, or a page, of which only some chapters of so many frames (default 60) are in "
                             "memory; what is in chapters already stays so")
    parser.add_argument("--then", metavar="NEXT", nargs="+", default=[], help="models that play after IN, in chapters of one file")
    parser.add_argument("--prune", metavar="SHARE", nargs="?", type=float, const=0.0,
                        help="leave out Gaussians that are never seen, and this share of those that show least (default 0)")
    parser.add_argument("--antialias", action="store_true", help="make the sampling limit of the capture's cameras a part of static "
                        "Gaussians and mark the file as antialiased: for viewers with Mip-Splatting's mode")
    web_page.add_arguments(parser)
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist already")


def run(args: argparse.Namespace) -> None:
    from .. import formats
    from ..model.chapters import Chapters
    from ..model.gaussians import GaussianModel
    from ..model.pruning import pruned
    from ..model.slicing import freeze
    from ..util.frames import parse_frames

    frames = parse_frames(args.at) if args.at is not None else None
    targets = _targets(args.output, frames)
    refuse_existing(targets, args)
    web_page.check_options(targets[0], args)
    losses: list[str] = []
    with _collected(losses):
        source = formats.open_source(args.input)
        long = args.then or args.chapters is not None
        kept = frames is not None or (isinstance(source, Chapters) and web_page.is_page(targets[0]) and web_page.unchanged(args))
        model = _joined(source, args) if long else source if kept else _one_model(source)
    if frames is not None:
        note_frames_outside(source, frames)
    lines: list[str] = []
    count = len(model)
    page = web_page.is_page(targets[0])
    packs = bool(args.compress) or page
    total = PARTS * len(targets) if packs or len(targets) > 1 else 0
    try:
        with progress(total, "step", "compressing" if packs else "writing", quiet=args.quiet) as bar:
            for done, (target, frame) in enumerate(zip(targets, frames or [None], strict=True)):
                result = model if frame is None else freeze(*source.moment(source.clip.t_of_frame(float(frame))))
                assert isinstance(result, (GaussianModel, Chapters))
                if isinstance(result, GaussianModel):
                    if args.prune is not None:
                        result = pruned(result, args.prune)
                    if args.antialias:
                        with _collected(losses):
                            result = _sampled(result, args.input, target)
                    refuse_existing(formats.written_files(result, target), args)  # a decoder may come to lie beside it
                elif args.prune is not None or args.antialias:
                    raise FastGSError(f"{args.input} is a clip whose chapters no model holds together; convert the models that it was "
                                      "made of.")
                with _collected(losses, str(target), args.output):
                    if page:
                        web_page.write(result, target, args, partial(_move, bar, done))
                    else:
                        formats.save(result, target, args.compress, partial(_move, bar, done))
                bar.to((done + 1) * PARTS)
                count = len(formats.open_source(target) if args.compress and not page else result)  # compression leaves Gaussians out
                lines.append(f"{target}: {count} Gaussians, {human_bytes(target.stat().st_size)}")
    finally:  # once the bar is away
        for line in lines if not (args.json or args.quiet) else ():
            say(line)
    if args.json:
        print_json({"input": args.input, "outputs": [str(t) for t in targets], "gaussians": count, "losses": losses})
    for loss in losses:
        note(f"lost: {loss}")


def _one_model(source: Source) -> Source:
    """The one model of a source; a clip whose chapters no model holds stays as it is."""
    from ..model.chapters import Chapters
    from ..model.from_frames import one_model
    from ..model.sequence import Sequence

    if isinstance(source, Chapters):
        return source.joined() if source.one_time else source
    return one_model(source) if isinstance(source, Sequence) else source


def _joined(source: Source, args: argparse.Namespace) -> Chapters:
    """A clip in chapters of the source and those that play after it."""
    from .. import formats
    from ..model.chapters import Chapters
    from ..model.cutting import FRAMES, chapters

    if args.prune is not None or args.antialias or not args.output.lower().endswith((*formats.Native.extensions, ".html")):
        raise FastGSError("--chapters and --then write a .safetensors file or a page, without --prune and --antialias; do these first.")
    given = [source, *(formats.open_source(path) for path in args.then)]
    models = [each if isinstance(each, Chapters) else _one_model(each) for each in given]
    return chapters(*models, frames=FRAMES if args.chapters is None else args.chapters)  # type: ignore[arg-type]


def _move(bar: Progress, done: int, share: float) -> None:
    bar.to(int((done + share) * PARTS))


def _sampled(model: GaussianModel, source: str, target: Path) -> GaussianModel:
    """The model with the sampling limit in its Gaussians; raises FastGSError where it is not known or the file cannot say so."""
    import numpy as np

    from .. import formats
    from ..formats.scenes import sampled
    from ..rendering.instances import Instance

    captured = Instance(model, np.eye(4), 0.0).captured
    if not captured.known:
        raise FastGSError(f"{source} does not say where its capture's cameras stood; add them with fastgs annotate --capture, or leave out "
                          "--antialias.")
    if not formats.says_antialiased(target):
        raise FastGSError(f"{target} cannot say that it is antialiased; write .ply, .compressed.ply, .spz or .sog.")
    if model.basis.terms or model.rotation_basis.terms:
        raise FastGSError(f"{source} changes over time; --antialias is for static models, so choose a frame with --at.")
    if not model.raster.antialiased:
        warnings.warn(LossWarning("with --antialias, pictures of the training's own size become a bit softer; "
                                  f"{page('passes')} says more."), stacklevel=2)
    return sampled(model, captured)


@contextlib.contextmanager
def _collected(losses: list[str], name: str = "", stands_for: str = "") -> Iterator[None]:
    """Adds what is lost in the block to a list, each thing once: a hundred frames lose the same, under one name."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LossWarning)
        yield
    for w in caught:
        text = str(w.message).replace(name, stands_for)
        if not issubclass(w.category, LossWarning):
            warnings.showwarning(w.message, w.category, w.filename, w.lineno)
        elif text not in losses:
            losses.append(text)


def _targets(output: str, frames: Frames | None) -> list[Path]:
    """The file of each frame, or the one file."""
    folder, name = Path(output).parent, Path(output).name
    place = PLACE.search(name)
    if frames is None:
        return [Path(output)]
    if place is None:
        if len(frames) > 1:
            raise FastGSError(f"{output} must say where the frame's number goes, as in out_####.ply, to hold {len(frames)} frames.")
        return [Path(output)]
    digits = int(place[1] or 1) if place[2] is None else len(place[2])
    return [folder / (name[:place.start()] + frames.label(frame, digits) + name[place.end():]) for frame in frames]
