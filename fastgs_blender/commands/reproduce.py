# SPDX-License-Identifier: GPL-3.0-or-later
"""train and measure a data set as published work does, beside the paper's figures

FOLDER has a folder for each scene, as the data set is published, or as Spacetime Gaussians prepares it: points of each frame in
colmap_0, colmap_1 ... are used then. Each scene is trained into a folder of --out, and a run that has ended is not repeated; one that was
stopped goes on. First a few steps are timed, and a line says how long all of it will take. The table, and reproduce.json, have what was
measured, what the paper prints, and what the paper prints for Spacetime Gaussians. docs/paper.md says what differs from both.
"""
from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from ..training.core.presets import PRESETS, SCENES
from ..util.errors import FastGSError, printable
from .shared import add_device, note, print_json, say_table, use_threads
from .train import frames_slice

if TYPE_CHECKING:
    from ..captures import Capture
    from ..evaluation.protocols import Part, Protocol
    from ..training.run.plan import Source

DATA_SETS = ("n3v", "immersive", "technicolor")
MEASURES = {"psnr": ("PSNR dB", ".2f"), "dssim1": ("DSSIM1", ".4f"), "dssim1_skimage": ("DSSIM1 sk", ".4f"),
            "dssim2": ("DSSIM2", ".4f"), "lpips": ("LPIPS", ".4f"), "flip": ("FLIP", ".4f")}
COSTS = {"fps": ("FPS", ".0f"), "megabytes": ("MB", ".0f"), "minutes": ("minutes", ".1f")}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", choices=DATA_SETS, help="whose protocol: views, size of the pictures, frames")
    parser.add_argument("folder", metavar="FOLDER", help="the folder with the scenes' folders")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the runs and the table")
    parser.add_argument("--scenes", metavar="NAME,NAME", help="the scenes to use (default: the published ones that are there)")
    parser.add_argument("--preset", choices=tuple(PRESETS), default="paper", help="what to train with (default: paper)")
    parser.add_argument("--frames", metavar="A:B", help="a part of each clip, counted from 0 (default: the published frames)")
    parser.add_argument("--scale", type=float, metavar="X", help="factor on the pictures' size (default: the published one)")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="any training option, for a quick trial")
    parser.add_argument("--no-lpips", action="store_true", help="measure neither LPIPS nor FLIP, which take the longest")
    add_device(parser)
    parser.add_argument("--threads", type=int, metavar="N", help="processor threads to use (default: all)")


def run(args: argparse.Namespace) -> None:
    from ..captures import open_capture
    from ..evaluation.protocols import PROTOCOLS, parts, scene_folders

    use_threads(args.threads)
    protocol, out = PROTOCOLS[args.dataset], Path(args.out)
    names = None if args.scenes is None else [name.strip() for name in args.scenes.split(",") if name.strip()]
    todo = []
    for folder in scene_folders(protocol, Path(args.folder), names):
        clip = open_capture(folder, layout=protocol.layout).clip
        todo += parts(protocol, folder, clip.frame_count, clip.start_frame, frames_slice(args.frames))
    if not args.quiet:
        _foretell(args, protocol, todo, out)
    rows = []
    for part in todo:
        rows += _measured(args, protocol, part, out / part.name)
        _write(out / "reproduce.json", {"data_set": args.dataset, "preset": args.preset, "set": args.set, "rows": rows})
    if args.json:
        print_json(rows)
    else:
        say_table(table(rows))


def _source(args: argparse.Namespace, protocol: Protocol, part: Part) -> Source:
    from ..training.run.launch import source_of

    return source_of(part.folder, protocol.layout, args.scale, part.frames, protocol.held_out)


def _wanted(args: argparse.Namespace, part: Part, capture: Capture) -> dict:
    """The training options of a part, by name: the preset's, STG's of this scene, and those of --set."""
    from ..training.core.settings import option_from_text

    scene = SCENES.get(args.dataset, {}).get(part.scene, {}) if args.preset in ("paper", "stg") else {}
    init = {"init": "file"} if capture.points is not None and capture.points.t is not None else {}
    return {"preset": args.preset, **init, **scene, **dict(option_from_text(text) for text in args.set)}


def _foretell(args: argparse.Namespace, protocol: Protocol, todo: list[Part], out: Path) -> None:
    """Say how long the training that is still to be done will take on this machine, from a few steps of each kind of run."""
    from ..training.core.settings import settings
    from ..training.run.files import MODEL
    from ..training.run.forecast import gaussians_of, step_seconds, steps_of
    from ..util.backends import choose_device, describe_backend

    left = [part for part in todo if not (out / part.name / MODEL).is_file()]
    if not left:
        return
    backend = choose_device(args.device)[0]
    backend = "cpu" if backend == "auto" else backend
    known, steps, seconds, size = {}, 0, 0.0, ""
    for part in left:
        capture = _source(args, protocol, part).open()
        if not capture.posed:
            return
        chosen = settings(**_wanted(args, part, capture))
        camera = capture.training[0].camera
        assert camera is not None
        size = f"{camera.width} x {camera.height}"
        kind = size, chosen.max_gaussians, chosen.batch, chosen.motion, chosen.order
        if kind not in known:
            known[kind] = step_seconds(capture, chosen, backend)
        steps += steps_of(capture, chosen)
        seconds += steps_of(capture, chosen) * known[kind]
    note(f"training will take about {_length(seconds)} on this machine ({describe_backend(backend)}): {steps} steps, "
         f"{1000 * seconds / steps:.0f} ms each with {gaussians_of(chosen)} Gaussians at {size}, as timed now. "
         "Starting points, pictures and measuring come on top.")


def _length(seconds: float) -> str:
    hours = seconds / 3600
    return f"{seconds:.0f} seconds" if seconds < 100 else f"{seconds / 60:.0f} minutes" if hours < 2 else (
        f"{hours:.0f} hours" if hours < 48 else f"{hours / 24:.1f} days")


def _measured(args: argparse.Namespace, protocol: Protocol, part: Part, out: Path) -> list[dict]:
    """Train a scene or a fragment, unless that has been done, and measure it: a row, or one for each view."""
    from .. import formats
    from ..captures.pixels.store import FrameStore
    from ..evaluation.evaluate import evaluate
    from ..training.run.files import MODEL, REPORT
    from ..training.run.launch import launch
    from ..training.run.plan import read_plan
    from ..util.reading import read_json

    source = _source(args, protocol, part)
    capture = source.open()
    wanted = _wanted(args, part, capture)
    plan = read_plan(out)
    if plan is not None and (out / MODEL).is_file():
        for name, value in wanted.items():
            if getattr(plan.settings, name) != value:
                raise FastGSError(f"{out}: the run there has {name} = {getattr(plan.settings, name)}, not {value}; choose another --out.")
    else:
        note(f"{part.name}: training")
        launch(source, out, wanted, plan is not None, False, args.quiet, note, args.device)
    model = formats.load(out / MODEL)
    store = FrameStore(capture, 0)
    store.fill(shots=capture.held_out)
    result = evaluate(model, capture, store, lpips=not args.no_lpips)
    for text in result["notes"]:
        note(f"{part.name}: {text}.")
    means = {f"{part.scene} {view}": values for view, values in result["views"].items()} if protocol.views else {
        part.scene: result["average"]}
    views = list(result["views"]) if protocol.views else [", ".join(result["views"])]
    report = read_json(out / REPORT) if (out / REPORT).is_file() else {}
    costs = {"fps": result["fps"], "megabytes": (out / MODEL).stat().st_size / 1e6}
    if isinstance(report, dict) and isinstance(report.get("seconds"), (int, float)):
        costs["minutes"] = report["seconds"] / 60
    return [{"scene": part.name, "view": view, "gaussians": len(model), "device": result["device"], "costs": costs,
             "measured": {name: values[name] for name in MEASURES if values.get(name) is not None},
             "paper": dict(protocol.paper.get(key, {})), "stg": dict(protocol.stg.get(key, {}))}
            for view, (key, values) in zip(views, means.items(), strict=True)]


def table(rows: list[dict]) -> str:
    """The rows for people: of each scene what was measured and what it cost, and below what the paper prints."""
    leads = [printable(f"{row['scene']} {row['view']}") for row in rows]
    rows = [{**row, "measured": row["measured"] | row["costs"]} for row in rows]
    formats = MEASURES | COSTS
    names = [name for name in formats if any(name in row[who] for row in rows for who in ("measured", "paper", "stg"))]
    width = max(len("scene"), *map(len, leads)) + 2
    lines = ["scene".ljust(width) + " " * 20 + "".join(f"{formats[name][0]:>10}" for name in names)]
    for row, lead in zip(rows, leads, strict=True):
        for who, title in (("measured", "measured"), ("paper", "the paper"), ("stg", "STG, by the paper")):
            if row[who] or who == "measured":
                cells = (f"{row[who][name]:{formats[name][1]}}" if name in row[who] else "-" for name in names)
                lines.append(lead.ljust(width) + title.ljust(20) + "".join(f"{cell:>10}" for cell in cells))
                lead = ""
    return "\n".join(lines)


def _write(path: Path, values: dict) -> None:
    from ..util.outputs import replacing

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing([path]) as (part,):
            part.write_text(json.dumps(values, indent=1, allow_nan=False) + "\n", "utf-8")
    except OSError as error:
        raise FastGSError(f"{path}: the table cannot be written ({error.strerror}); choose another folder with --out.") from error
