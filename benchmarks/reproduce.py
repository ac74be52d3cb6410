# SPDX-License-Identifier: GPL-3.0-or-later
"""Trains and measures a data set as published work does, beside the paper's figures.

    python benchmarks/reproduce.py n3v|immersive|technicolor FOLDER --out DIR [--scenes NAME,NAME] [--json]

FOLDER has a folder for each scene, as the data set is published, or as Spacetime Gaussians prepares it: points of each frame in
colmap_0, colmap_1 ... are used then. Each scene is trained into a folder of --out, and a run that has ended is not repeated; one that was
stopped goes on. First a few steps are timed, and a line says how long all of it will take. The table, and reproduce.json, have what was
measured, what the paper prints, and what the paper prints for Spacetime Gaussians. docs/paper.md says what differs from both.
"""
from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fastgs_blender import formats
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.capture import Capture, Points, Shot
from fastgs_blender.captures.layouts import technicolor
from fastgs_blender.captures.pixels.store import FrameStore, Pixels
from fastgs_blender.commands.shared import FAILED, add_device, complain, note, print_json, say_table, use_threads
from fastgs_blender.commands.train import frames_slice
from fastgs_blender.evaluation.evaluate import evaluate
from fastgs_blender.training.core.presets import PRESETS, SCENES
from fastgs_blender.training.core.settings import Settings, option_from_text, settings
from fastgs_blender.training.core.spans import spans, steps_of
from fastgs_blender.training.core.start import Start
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.first_model import model_from_points
from fastgs_blender.training.run import launch
from fastgs_blender.training.run.files import MODEL, REPORT
from fastgs_blender.training.run.plan import Source, read_plan
from fastgs_blender.util.backends import choose_device, describe_backend
from fastgs_blender.util.errors import FastGSError, printable
from fastgs_blender.util.outputs import replacing
from fastgs_blender.util.reading import read_json
from fastgs_blender.util.remarks import be_quiet

MEASURES = {"psnr": ("PSNR dB", ".2f"), "dssim1": ("DSSIM1", ".4f"), "dssim1_skimage": ("DSSIM1 sk", ".4f"),
            "dssim2": ("DSSIM2", ".4f"), "lpips": ("LPIPS", ".4f"), "flip": ("FLIP", ".4f")}
COSTS = {"fps": ("FPS", ".0f"), "megabytes": ("MB", ".0f"), "minutes": ("minutes", ".1f")}
Row = Mapping[str, float]
"""Published measures of a scene by their names in MEASURES (evaluate.py), and frames per second, megabytes and minutes of training."""


@dataclass(frozen=True)
class Protocol:
    """A data set's protocol.

    scenes    the published scenes, each a folder
    held_out  views that are kept for evaluation; None: those of the layout
    most      frames of a model at most: longer films are cut into fragments of so many
    views     measure each held-out view in a row of its own
    paper, stg  what the paper prints for itself and for Spacetime Gaussians, by scene, or by "scene view" where views have rows
    """

    layout: str
    scenes: tuple[str, ...]
    held_out: tuple[str, ...] | None = None
    most: int = 300
    views: bool = False
    paper: Mapping[str, Row] = field(default_factory=dict)
    stg: Mapping[str, Row] = field(default_factory=dict)


def _rows(**scenes: tuple[float, ...]) -> dict[str, Row]:
    return {scene: dict(zip(("psnr", "dssim1", "dssim2", "lpips"), values)) for scene, values in scenes.items()}


PROTOCOLS: dict[str, Protocol] = {
    "n3v": Protocol(
        "n3v", ("coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"),
        paper=_rows(sear_steak=(34.65, 0.0298, 0.0022, 0.0306), flame_steak=(33.09, 0.0195, 0.0165, 0.0399),
                    cook_spinach=(33.49, 0.0211, 0.0131, 0.0338), coffee_martini=(29.98, 0.0367, 0.0167, 0.0583)),
        stg=_rows(sear_steak=(33.40, 0.0351, 0.0064, 0.0309), flame_steak=(33.59, 0.0350, 0.0053, 0.0308),
                  cook_spinach=(33.30, 0.0425, 0.0046, 0.0358), coffee_martini=(28.55, 0.0418, 0.0253, 0.0692))),
    "immersive": Protocol(
        "immersive", ("02_Flames",), ("camera_0010", "camera_0037"), views=True,
        paper={"02_Flames camera_0010": {"psnr": 30.56, "fps": 146, "megabytes": 363, "minutes": 40 + 34 / 60},
               "02_Flames camera_0037": {"psnr": 31.54}},
        stg={"02_Flames camera_0010": {"psnr": 27.97, "fps": 154, "megabytes": 248, "minutes": 34 + 11 / 60},
             "02_Flames camera_0037": {"psnr": 27.64}}),
    "technicolor": Protocol("technicolor", tuple(technicolor.PUBLISHED), most=50),
}


@dataclass(frozen=True)
class Part:
    """A scene, or a fragment of one that is longer than a model: its name in tables and files, its folder, its frames (None: all)."""

    name: str
    scene: str
    folder: Path
    frames: slice | None


def scene_folders(protocol: Protocol, folder: Path, scenes: list[str] | None) -> list[Path]:
    """The folders of these scenes, or of all published scenes that are there; raises FastGSError where there is none."""
    wanted = list(protocol.scenes) if scenes is None else scenes
    found = [path for name in wanted for path in _places(folder, name)]
    lacking = [name for name in wanted if not _places(folder, name)]
    if not found or (scenes is not None and lacking):
        raise FastGSError(f"{folder}: it has no folder of {'the scene ' + lacking[0] if scenes else 'a scene, ' + ', '.join(lacking)}; "
                          "give the folder in which the scenes' folders lie, or name scenes with --scenes.")
    return found


def _places(folder: Path, name: str) -> list[Path]:
    """flame_salmon is published as flame_salmon_1 too."""
    return [path for path in (folder / name, folder / f"{name}_1") if path.is_dir()][:1]


def parts(protocol: Protocol, folder: Path, frame_count: int, start_frame: int, frames: slice | None) -> list[Part]:
    """What is trained for a scene: all of it, the published frames, or fragments of protocol.most frames.

    frames  a part of the clip that is used instead
    """
    scene = folder.name.removesuffix("_1")
    if frames is not None:
        return [Part(folder.name, scene, folder, frames)]
    begin = technicolor.PUBLISHED.get(scene) if protocol.layout == "technicolor" else None
    if begin is not None and start_frame <= begin and begin - start_frame + protocol.most <= frame_count:
        return [Part(folder.name, scene, folder, slice(begin - start_frame, begin - start_frame + protocol.most))]
    if frame_count <= protocol.most:
        return [Part(folder.name, scene, folder, None)]
    starts = range(0, frame_count, protocol.most)
    return [Part(f"{folder.name}-{k + 1}of{len(starts)}", scene, folder, slice(first, min(first + protocol.most, frame_count)))
            for k, first in enumerate(starts)]


SHARE = 0.7
"""Of the largest number of Gaussians, what a run has in the mean."""
STEPS = 2
"""Timed steps, after one that compiles what is to be compiled."""


class _Noise:
    """A FrameStore of pictures that are not on disk."""

    def pixels(self, shot: Shot) -> Pixels:
        """Noise of the shot's size."""
        assert shot.camera is not None
        return Pixels(np.random.default_rng(1).random((shot.camera.height, shot.camera.width, 3), np.float32))


def gaussians_of(settings: Settings) -> int:
    """Gaussians with which its steps are timed."""
    return max(int(SHARE * settings.max_gaussians), 1)


def step_seconds(capture: Capture, settings: Settings, backend: str) -> float:
    """Seconds of a step: whole pictures, Gaussians around what the cameras film, no density control."""
    cut = spans(capture.clip.frame_count, settings.segment_frames, settings.segment_overlap)[0]
    first = capture.part(cut.first, cut.count)
    rng, count = np.random.default_rng(0), gaussians_of(settings)
    distance = float(np.linalg.norm(first.focus - first.centres(), axis=1).mean())
    points = Points(np.asarray(first.focus + 0.3 * distance * rng.normal(size=(count, 3)), np.float32), rng.random((count, 3)))
    plain = replace(settings, warm_up=(), densify_from=1.0, densify_until=1.0, reset_every=0, moving_weight=1.0, exposures="off",
                    clocks="off", poses="off")
    model = model_from_points(points, plain, first.clip, first.axes, first.extent)
    trainer = Trainer(first, _Noise(), plain, Start(model), backend=backend)
    times = []
    for _ in range(1 + STEPS):
        began = time.perf_counter()
        trainer.step()
        times.append(time.perf_counter() - began)
    return min(times[1:])


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", choices=tuple(PROTOCOLS), help="whose protocol: views, size of the pictures, frames")
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
    parser.add_argument("--json", action="store_true", help="print the result as JSON on standard output")
    parser.add_argument("--quiet", action="store_true", help="show no progress and no remarks, only results and errors")
    return parser


def run(args: argparse.Namespace) -> None:
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
    return launch.source_of(part.folder, protocol.layout, args.scale, part.frames, protocol.held_out)


def _wanted(args: argparse.Namespace, part: Part, capture: Capture) -> dict:
    """The training options of a part, by name: the preset's, STG's of this scene, and those of --set."""
    scene = SCENES.get(args.dataset, {}).get(part.scene, {}) if args.preset in ("paper", "stg") else {}
    init = {"init": "file"} if capture.points is not None and capture.points.t is not None else {}
    return {"preset": args.preset, **init, **scene, **dict(option_from_text(text) for text in args.set)}


def _foretell(args: argparse.Namespace, protocol: Protocol, todo: list[Part], out: Path) -> None:
    """Say how long the training that is still to be done will take on this machine, from a few steps of each kind of run."""
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
        steps += steps_of(capture.clip.frame_count, chosen)
        seconds += steps_of(capture.clip.frame_count, chosen) * known[kind]
    note(f"training will take about {_length(seconds)} on this machine ({describe_backend(backend)}): {steps} steps, "
         f"{1000 * seconds / steps:.0f} ms each with {gaussians_of(chosen)} Gaussians at {size}, as timed now. "
         "Starting points, pictures and measuring come on top.")


def _length(seconds: float) -> str:
    hours = seconds / 3600
    return f"{seconds:.0f} seconds" if seconds < 100 else f"{seconds / 60:.0f} minutes" if hours < 2 else (
        f"{hours:.0f} hours" if hours < 48 else f"{hours / 24:.1f} days")


def _measured(args: argparse.Namespace, protocol: Protocol, part: Part, out: Path) -> list[dict]:
    """Train a scene or a fragment, unless that has been done, and measure it: a row, or one for each view."""
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
        launch.launch(source, out, wanted, plan is not None, False, args.quiet, note, args.device)
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
    shapes = MEASURES | COSTS
    names = [name for name in shapes if any(name in row[who] for row in rows for who in ("measured", "paper", "stg"))]
    width = max(len("scene"), *map(len, leads)) + 2
    lines = ["scene".ljust(width) + " " * 20 + "".join(f"{shapes[name][0]:>10}" for name in names)]
    for row, lead in zip(rows, leads, strict=True):
        for who, title in (("measured", "measured"), ("paper", "the paper"), ("stg", "STG, by the paper")):
            if row[who] or who == "measured":
                cells = (f"{row[who][name]:{shapes[name][1]}}" if name in row[who] else "-" for name in names)
                lines.append(lead.ljust(width) + title.ljust(20) + "".join(f"{cell:>10}" for cell in cells))
                lead = ""
    return "\n".join(lines)


def _write(path: Path, values: dict) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing([path]) as (part,):
            part.write_text(json.dumps(values, indent=1, allow_nan=False) + "\n", "utf-8")
    except OSError as error:
        raise FastGSError(f"{path}: the table cannot be written ({error.strerror}); choose another folder with --out.") from error


def main(argv: list[str] | None = None) -> int:
    """The exit code; what is wrong is told in a sentence."""
    args = parser().parse_args(argv)
    be_quiet(args.quiet)
    try:
        run(args)
    except FastGSError as error:
        complain(str(error))
        return FAILED
    finally:
        be_quiet(False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
