# SPDX-License-Identifier: GPL-3.0-or-later
"""measure a model against the pictures of a capture

Renders the views that the model was not trained on, as its file says, at every frame; else those that the capture holds out.  What it
measures:

  PSNR      in dB; where the capture has masks, of the foreground alone too
  DSSIM1    (1 - SSIM) / 2 with 3DGS's window at data range 1
  DSSIM2    the same with scikit-image's window at data range 2
  LPIPS     with AlexNet, where its weights are on this machine: as 3DGS
            trainers feed it, and normalised to -1..1 as its authors do
  FLIP      where there is no LPIPS and flip-evaluator is installed
  flicker   how differently picture and truth change from frame to frame

Pixels that a lens or the capture's masks rule out count in no measure.

--out (default: a folder beside the model) gets evaluation.json, evaluation.csv, truth, render and error side by side as PNG, and a
film of each view with the truth beside the render.
"""
from __future__ import annotations

import argparse
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..util.errors import FastGSError, printable
from ..util.outputs import make_folder
from ..util.progress import progress
from ..util.screen import COLUMNS
from .shared import add_backend, chosen_backend, human_bytes, model_file, note, print_json, say_table, use_threads

if TYPE_CHECKING:
    from ..captures import Capture


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="a model file, or the folder that fastgs train wrote")
    parser.add_argument("capture", nargs="?", metavar="CAPTURE", help="the capture to measure it against (default: the training run's)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: MODEL-evaluation, or evaluation in the folder)")
    parser.add_argument("--views", "--held-out", metavar="NAME,NAME", help="the views to use, or all (default: those that the model "
                        "was not trained on)")
    parser.add_argument("--frames", metavar="A:B", help="the frames to use, counted from 0 (default: all that the model's clip covers)")
    parser.add_argument("--layout", metavar="NAME", help="the capture's layout, where it is not recognised")
    parser.add_argument("--scale", type=float, metavar="S", help="factor on the size of the pictures (default: as in training)")
    parser.add_argument("--images", type=int, default=10, metavar="N", help="side-by-side pictures of each view (default: 10)")
    parser.add_argument("--no-lpips", action="store_true", help="do not measure LPIPS, which takes the longest")
    parser.add_argument("--fit-colours", choices=("auto", "on", "off"), default="auto", help="fit a gain and an offset for each channel on "
                        "one half of each picture, for its other half (default: where training evened exposures)")
    add_backend(parser)


def run(args: argparse.Namespace) -> None:
    from .. import formats
    from ..captures import open_capture
    from ..captures.pixels.checks import check
    from ..captures.pixels.store import FrameStore
    from ..evaluation import report
    from ..evaluation.evaluate import chosen, evaluate
    from ..evaluation.training_record import recorded
    from ..util.backends import load_backend

    use_threads(args.threads)
    file = model_file(args.model)
    if file.is_dir():
        raise FastGSError(f"{file}: this folder has no model.safetensors; give a model, or the folder of a finished training run.")
    out = Path(args.out) if args.out else default_folder(Path(args.model), file)
    frames = _frames(args.frames)
    model = formats.load(file)
    known = recorded(model)
    path, layout = _capture(args)
    capture = open_capture(path, scale=known.scale if args.scale is None and known else args.scale, layout=layout)
    views = _views(args.views, capture)
    shots = chosen(capture, views, frames, known)
    check(replace(capture, shots=shots, faults=[]))
    backend = chosen_backend(args)  # last: the first time a GPU is tested, which takes a moment
    load_backend(backend)  # or it says that there is none
    make_folder(out, "results")
    store = FrameStore(capture, 0, whole=known is not None and known.whole)
    try:
        with progress(len(store.missing(shots)), "frame", "decoding", quiet=args.quiet) as bar:
            store.fill(bar.to, shots)
        with progress(len(shots), "frame", "evaluating", quiet=args.quiet) as bar:

            def show(done: int, total: int, row: dict) -> None:
                name = printable(row["view"])
                bar.note(name if row["psnr"] is None else f"{name} {row['psnr']:.2f} dB")
                bar.to(done, total)

            result = evaluate(model, capture, store, views=views, frames=frames, out=out, images=args.images, backend=backend,
                              lpips=not args.no_lpips, fit_colours={"on": True, "off": False}.get(args.fit_colours), progress=show)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; no measures are written to {out}.") from None
    result = {"model": str(file), "file_bytes": file.stat().st_size, **result}
    result["files"] += [str(path) for path in report.write(result, out)]
    for text in result["notes"]:
        note(f"{text}.")
    if args.json:
        print_json(result)
    else:
        say_table(report.table(result))
        for line in (facts(result), _files(out, result["files"])):
            say_table("\n" + textwrap.fill(printable(line), COLUMNS, break_long_words=False, break_on_hyphens=False))


def _capture(args: argparse.Namespace) -> tuple[str, str | None]:
    """The capture and its layout: as given, else those of the training run."""
    if args.capture is not None:
        return args.capture, args.layout
    from ..training.run.plan import read_plan

    plan = read_plan(args.model)
    if plan is None or plan.source.capture is None:
        raise FastGSError(f"{args.model} does not say what it was trained on; name the CAPTURE to measure it against.")
    return plan.source.capture, args.layout or plan.source.layout


def facts(result: dict) -> str:
    """One line on the model and its speed."""
    count = f"{result['gaussians']:,}".replace(",", " ")
    return (f"{count} Gaussians, {human_bytes(result['file_bytes'])} on disk, "
            f"{result['fps']:.1f} frames per second at {result['width']} x {result['height']} on {result['device']}")


def _files(out: Path, files: list[str]) -> str:
    kinds = [Path(path).suffix for path in files]
    counts = {"picture": kinds.count(".png"), "film": kinds.count(".mp4")}
    words = [f"{count} {name}{'s' if count > 1 else ''}" for name, count in counts.items() if count]
    return f"{out}: " + ", ".join([Path(path).name for path in files if Path(path).suffix in {".json", ".csv"}] + words)


def default_folder(given: Path, file: Path) -> Path:
    return given / "evaluation" if given != file else file.with_name(f"{file.stem}-evaluation")


def _views(text: str | None, capture: Capture) -> list[str] | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise FastGSError(f"--views {text!r} names no view; write them as NAME,NAME.")
    return list(capture.views) if names == ["all"] and "all" not in capture.views else names


def _frames(text: str | None) -> list[int] | None:
    from ..util.frames import parse_frames

    if text is None:
        return None
    frames = parse_frames(text)
    if frames.decimals:
        raise FastGSError(f"a capture has whole frames only, so --frames {text!r} cannot be used.")
    return [int(frame) for frame in frames]
