# SPDX-License-Identifier: GPL-3.0-or-later
"""find how far the clocks of a capture's cameras are from each other

For cameras that are not genlocked.  It listens to the videos' sound.  Where poses are known, it compares what moves in the planes through
each two cameras; else it looks for a flash that most cameras see, or compares how much changes from picture to picture.  A clock is moved
only where two cameras show that it is off; others are called unsure and stay.  Then a short training on small pictures refines the offsets
to a few hundredths of a frame (a minute or two; --quick leaves it out, and a capture without poses has to do without).

The offsets go into sync.json beside the capture.  Training, evaluation and everything else then place each camera's pictures in time by
them.  The picture sync.png shows how much changes from picture to picture in each camera, as filmed and with the clocks set right.
"""
import argparse
from dataclasses import replace
from itertools import pairwise

from ..util.errors import FastGSError
from ..util.progress import estimated, staged
from ..util.screen import screen
from .shared import add_status, note, print_json, say_table, stages, use_threads

WEIGHTS = {"reading pictures": (0.0, 0.06), "comparing pictures": (0.06, 0.12), "comparing clocks": (0.12, 0.25),
           **dict(zip(("reading small pictures", "comparing them", "finding starting points", "training on them"),
                      pairwise((0.25, 0.3, 0.35, 0.55, 0.95)))), "drawing the curves": (0.95, 1.0)}
"""Begin and end of the stages as shares of the whole."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", metavar="CAPTURE", help="the capture: a folder or file that `fastgs info` recognises")
    parser.add_argument("--by", choices=("auto", "sound", "flash", "motion"), default="auto", help="what to compare first (default: sound "
                        "where all cameras have it, else a flash, else motion)")
    parser.add_argument("--quick", action="store_true", help="leave out the short training that refines the offsets")
    parser.add_argument("--frames", metavar="A:B", help="the part of the capture to compare, frames counted from 0 (default: all)")
    parser.add_argument("--layout", metavar="NAME", help="the capture's layout, where it is not recognised")
    add_status(parser)
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def run(args: argparse.Namespace) -> None:
    from ..captures import first_clocks, open_capture
    from ..captures.clocks import files
    from ..captures.clocks.curves import curves
    from ..captures.clocks.find import find_offsets
    from ..captures.clocks.plot import write_plot
    from ..captures.pixels.checks import check
    from ..checks.samples import Inspection, sample
    from ..training.core.costs import estimate, measured_pace
    from ..training.run.clocks import GAUSSIANS, MOST_FRAMES, SIDE, STEPS, refined
    from .train import frames_slice

    use_threads(args.threads)
    part = frames_slice(args.frames)
    if part is not None and part.step != 1:
        raise FastGSError(f"--frames {args.frames} skips frames, and clocks are compared from frame to frame; give A:B without a step.")
    first = first_clocks(args.capture, args.layout)
    capture = open_capture(args.capture, layout=args.layout, offsets=first, frames=part)
    check(capture)
    for text in capture.notes:
        note(f"{text}.")
    refine = capture.posed and not args.quick
    lost: tuple[str, ...] = ()
    pictures = len(capture.views) * min(capture.clip.frame_count, MOST_FRAMES)
    seconds = estimate(SIDE * SIDE, STEPS, GAUSSIANS, pictures, len(capture.views), measured_pace(SIDE * SIDE))[0] if refine else 0.0
    with estimated("refining the clocks", seconds, note), stages("syncing", args) as tell:
        at = staged(WEIGHTS, tell)
        inspection = Inspection(capture, at)
        if capture.posed:
            sample(inspection)
        misplaced = inspection.misplaced
        if misplaced:
            note(f"the pose of {', '.join(misplaced)} is wrong, as other cameras put what is seen there elsewhere: no clock is found by "
                 "it. Calibrate again, then run fastgs sync once more; fastgs check tells how far it is off.")
        try:
            found = find_offsets(capture, args.by, lambda done, of: at("comparing clocks", done / max(of, 1)), misplaced)
            offsets = {view: first.get(view, 0.0) + offset for view, offset in found.clocks.offsets.items()}
            clocks, shown, lost = replace(found.clocks, offsets=offsets), found.curves, found.lost
        except FastGSError as error:
            if not refine or args.by != "auto" or "nothing moves" in str(error) or "one camera" in str(error):
                raise
            note(f"{error} The training begins with equal clocks.")
            clocks, shown = files.Clocks(dict.fromkeys(capture.views, 0.0) | dict(first), {}, "training"), None
            lost = tuple(capture.views)
        if refine:
            clocks, lost = refined(args.capture, clocks, lost, args.layout, frames=part, misplaced=misplaced, progress=at)
            if len(lost) == len(capture.views):
                raise FastGSError(f"{capture.path}: unsure, as no two of its cameras see enough of the same movement for their clocks to "
                                  "be compared. Nothing was written. Film something that moves fast before all of them, or clap or flash "
                                  "a lamp.")
        shown = shown or curves(capture, lambda done, of: at("drawing the curves", done / max(of, 1)))
    path = files.write_clocks(capture.path, clocks)
    picture = path.with_suffix(".png")
    write_plot(picture, shown, {view: o - first.get(view, 0.0) for view, o in clocks.offsets.items()})
    if args.json:
        print_json({"file": str(path), "picture": str(picture), "found_by": clocks.found_by, "offsets": dict(clocks.offsets),
                    "uncertainty": dict(clocks.uncertainty), "lost": list(lost), "misplaced": misplaced})
        return
    fps = capture.clip.fps
    rows = []
    for view, offset in clocks.offsets.items():
        spread = clocks.uncertainty.get(view)
        sure = "" if spread is None else f"+- {spread:.2f}"
        if view in lost:
            sure = "its pose is wrong" if view in misplaced else "unsure"
        rows.append((view, f"{offset:+.2f} frames, {1000 * offset / fps:+.0f} ms  {sure}".rstrip()))
    say_table(screen([*rows, ("found by", clocks.found_by), ("written", str(path)), ("picture", str(picture))], True))
