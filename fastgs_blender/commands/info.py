# SPDX-License-Identifier: GPL-3.0-or-later
"""what a model file, a capture or a training run holds; which GPUs there are

Of a model: the format, the number of Gaussians, how they move, fade and look, the clip, the axes and the bounds.  Of a capture (a folder,
or a file such as transforms.json): the layout, cameras, frames, what is held out, masks, points, and everything that is wrong with its
files.  Of a training run (the folder that fastgs train wrote): how far it is, its capture and its model.

It shows one screen; --all shows the rest: constants of the rasteriser, where the model came from, every problem.  --json gives everything
for scripts.  The exit code is 1 where something is wrong with a capture or a run.

With --devices it lists the GPUs instead: how they are reached, their drivers, and what the self-test said.  The largest array that each
holds is shown because WebGPU does not say how much memory there is.  The self-test compares small pictures with the processor's, and takes
the time of a frame and of a training step on both.  The device auto is a GPU that is faster in both, and otherwise the processor.
"""
import argparse
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..util.errors import FastGSError
from ..util.screen import screen
from .shared import PROBLEMS, human_bytes, is_run, note, print_json, say, say_table

LONG = 100
"""Characters of a record of the model's origin that is shown by --all alone."""
CAPTURE_FILES = (".json", ".npy", ".txt", ".xml")
EACH_FRAME = {"basis": "a model for each frame", "terms": 0, "band_limit_hz": None}
"""The motion of a sequence."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("file", nargs="?", metavar="FILE", help="the model, the capture's folder or file, or the folder of a training run")
    what.add_argument("--devices", action="store_true", help="list the GPUs that --device can name")
    parser.add_argument("--device", default="", metavar="NAME", help="with --devices: only those whose name holds NAME")
    parser.add_argument("--again", action="store_true", help="with --devices: test them once more")
    parser.add_argument("--layout", metavar="NAME", help="a capture's layout, where it is not recognised")
    parser.add_argument("--all", action="store_true", help="show everything, however long it is")


def run(args: argparse.Namespace) -> int:
    if args.devices:
        return _devices(args)
    text: Callable[[dict, bool], str]
    if args.layout is None and is_run(args.file):
        facts, text = describe_run(args.file), run_text
        wrong = facts["state"] == "failed"
    elif args.layout is not None or is_capture(args.file):
        from ..captures import describe as captured
        from ..captures import open_capture

        facts, text = captured.describe(open_capture(args.file, layout=args.layout)), captured.text
        wrong = bool(facts["problems"])
    else:
        facts, text, wrong = describe(args.file), model_text, False
    if args.json:
        print_json(facts)
    else:
        say_table(text(facts, args.all))
    return PROBLEMS if wrong else 0


def _devices(args: argparse.Namespace) -> int:
    """List the GPUs."""
    from ..util.backends import describe_devices
    from ..util.verdicts import read_verdict

    found = describe_devices(args.device, again=args.again, tell=note)
    if args.json:
        print_json(found)
        return 0
    for each in found["devices"]:
        verdict = read_verdict(each)
        say_table(screen([(name, value) for name, value in (
            ("device", each["name"]), ("kind", f"{each['kind']}, through {each['interface']}"), ("driver", each["driver"]),
            ("largest", f"{human_bytes(each['largest_bytes'])} in one array"), ("self-test", each["self_test"] or "passed"),
            *([("pace", verdict.pace)] if verdict and verdict.pace else []))], True, 0))
        say("")
    say(f"--device auto means {found['auto'] or 'cpu'}: {found['reason']}")
    return 0


def is_capture(path: str | Path) -> bool:
    """Whether a path is to be read as a capture: a folder without a sequence of models, and files that a layout of captures knows.

    A capture may have models in folders below it (points of each frame): only of what is no capture these make a sequence.
    """
    path = Path(path)
    if not path.is_dir() and (path.suffix.lower() not in CAPTURE_FILES or not path.is_file()):
        return False
    if path.is_dir() and holds_models(path, below=False):
        return False
    from ..captures import recognised

    return recognised(path) is not None or (path.is_dir() and not holds_models(path))


def holds_models(folder: Path, below: bool = True) -> bool:
    """Whether a folder holds the numbered files of a sequence of models, or stands for one; below: in folders in it, too."""
    from ..formats.sequences import numbered_files, resolved

    try:
        return resolved(folder, below) != folder or bool(numbered_files(folder, below))
    except FastGSError:
        return False


def describe(path: str | Path) -> dict:
    """Everything about the model in a file, as JSON values; raises FastGSError if it cannot be read."""
    from .. import formats
    from ..formats.sequences import resolved, stored_bytes
    from ..model.chapters import Chapters
    from ..model.framing import bounds

    path = resolved(Path(path))
    file_format = formats.identify(path)
    source = formats.open_source(path)
    model, _ = source.moment(0.0)
    long = source if isinstance(source, Chapters) else None
    clip, low, high = source.clip, *bounds(model)
    return {
        "file": str(path),
        "format": getattr(file_format, "name", str(file_format)),
        "file_bytes": 0 if path.is_dir() or formats.FILES.sniff(b"", path) else stored_bytes(path),
        "gaussians": len(long or model),
        "chapters": len(long.chapters) if long else None,
        "memory_bytes": model.nbytes,
        "motion": _basis(model.basis, clip) if source is model or long else EACH_FRAME,
        "rotation": _basis(model.rotation_basis, clip),
        "temporal_opacity": model.temporal_kind.name,
        "appearance": _appearance(model.appearance),
        "clip": {**asdict(clip), "duration_seconds": clip.duration},
        "raster": asdict(model.raster),
        "axes": model.axes,
        "colour_space": model.colour_space,
        "bounds": {"low": low, "high": high},
        "surroundings": asdict(model.surroundings),
        "provenance": model.provenance,
    }


def _basis(basis: Any, clip: Any) -> dict:
    """Name, order and parameters of a basis; its band limit in Hz, None where it has none."""
    values = {key: value for key, value in asdict(basis).items() if key != "times"}
    limit = basis.max_frequency / clip.duration
    return {"basis": basis.name, "terms": basis.terms, **values, "band_limit_hz": limit or None}


def _appearance(appearance: Any) -> dict:
    values = {key: getattr(appearance, key) for key in appearance.recorded}
    return {"kind": appearance.name, "columns": appearance.width, **values}


def model_text(facts: dict, everything: bool) -> str:
    """The facts of a model for people; see util.screen."""
    return screen(*_rows(facts, everything))


def _rows(facts: dict, everything: bool) -> tuple[list[tuple[str, object]], bool, int]:
    """Names and values; `everything`; how many rows are left out."""
    clip, raster, box = facts["clip"], facts["raster"], facts["bounds"]
    sizes = ", ".join([f"{human_bytes(facts['file_bytes'])} on disk"] * bool(facts["file_bytes"])
                      + [f"{human_bytes(facts['memory_bytes'])} in memory"])
    lines = [
        ("file", facts["file"]),
        ("format", f"{facts['format']}, {sizes}"),
        ("Gaussians", f"{facts['gaussians']:,}".replace(",", " ") + (f", in {n} chapters" if (n := facts["chapters"]) else "")),
        ("motion", _motion_text(facts["motion"])),
        ("rotation", _motion_text(facts["rotation"])),
        ("opacity", facts["temporal_opacity"]),
        ("appearance", ", ".join(f"{v}" if k == "kind" else f"{k} {v}" for k, v in facts["appearance"].items())),
        ("clip", f"{clip['frame_count']} frames from {clip['start_frame']} at {clip['fps']:g} fps, {clip['duration_seconds']:.3g} s"),
        ("axes", facts["axes"]),
        ("colour", facts["colour_space"]),
        ("bounds", "none" if box["low"] is None else f"{_vector(box['low'])} to {_vector(box['high'])}"),
        ("around", _around(facts["surroundings"])),
    ]
    origin = [(f"from {key}", value) for key, value in facts["provenance"].items()]
    if not everything:
        short = [row for row in origin if len(row[1]) <= LONG]
        return lines + short, False, 1 + len(origin) - len(short)
    lines.append(("rasteriser", ", ".join(f"{k} {v:.6g}" for k, v in raster.items() if k != "antialiased")
                  + (", antialiased" if raster["antialiased"] else "")))
    return lines + origin, True, 0


def describe_run(folder: str | Path) -> dict:
    """Everything about a training run, as JSON values; "state" is as in status.json, "unknown" where it says nothing."""
    from ..jobs.job import read_status
    from ..training.run.files import MODEL, STATUS
    from ..training.run.plan import read_plan

    folder = Path(folder)
    status, plan, model = read_status(folder / STATUS), read_plan(folder), folder / MODEL
    return {
        "run": str(folder), "state": status.get("state", "finished" if model.is_file() else "unknown"), "status": status,
        **({name: value for name, value in plan.to_dict().items() if name != "fresh"} if plan else {"settings": None, "source": None}),
        "model": describe(model) if model.is_file() else None}


def run_text(facts: dict, everything: bool) -> str:
    """The facts of a training run for people; see util.screen."""
    status, source, settings = facts["status"], facts["source"] or {}, facts["settings"] or {}
    steps = f", {status['iteration']} of {status['iterations']} steps" if {"iteration", "iterations"} <= status.keys() else ""
    quality = f", {status['held_out_psnr']:.2f} dB in the held-out views" if "held_out_psnr" in status else ""
    source = {**source, **({"frames": _range_text(*source["frames"])} if source.get("frames") else {})}
    part = [f"{name.replace('_', ' ')} {', '.join(map(str, value)) if isinstance(value, list) else value}"
            for name, value in source.items() if name != "capture" and value is not None]
    lines = [("run", facts["run"]), ("state", facts["state"] + steps + quality), ("reason", status.get("reason")),
             ("capture", ", ".join([source["capture"], *part]) if source.get("capture") else None)]
    shown = settings if everything else {name: settings[name] for name in ("preset", "motion", "density") if name in settings}
    lines.append(("options", ", ".join(f"{name} {value}" for name, value in shown.items()) or None))
    lines = [line for line in lines if line[1] is not None]
    model, _, hidden = _rows(facts["model"], everything) if facts["model"] else ([], everything, 0)
    return screen(lines + model, everything, hidden)


def _range_text(start: int, stop: int, step: int) -> str:
    """A run's part of its capture as `train --frames` is given it, both ends included; a run begun in Python may name no end."""
    from ..training.run.plan import NO_END

    return (f"{start}:{stop - 1}" if stop < NO_END else f"from {start} on") + (f":{step}" if step > 1 else "")


def _motion_text(motion: dict) -> str:
    parameters = [k if v is True else f"{k} {v:g}" if isinstance(v, float) else f"{k} {v}" for k, v in motion.items()
                  if k not in ("basis", "band_limit_hz", "terms") and v is not False]
    limit = [f"up to {motion['band_limit_hz']:.3g} Hz"] if motion["band_limit_hz"] else []
    terms = [f"{motion['terms']} term{'s' if motion['terms'] > 1 else ''}"] if motion["terms"] else []
    return ", ".join([motion["basis"], *parameters, *terms, *limit])


def _around(known: dict) -> str:
    backdrop, view = known["backdrop"], known["view"]
    parts = [f"{len(known['cameras'])} cameras of the capture"] if known["cameras"] else []
    parts += [f"a backdrop beyond {backdrop['radius']:.4g} from {_vector(backdrop['centre'])}"] if backdrop else []
    parts += [f"a good view{' named ' + view['name'] if view['name'] else ''}"] if view else []
    return ", ".join(parts) or "nothing is known"


def _vector(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in values) + ")"
