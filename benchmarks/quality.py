# SPDX-License-Identifier: GPL-3.0-or-later
"""How good are trained models in new views?  Trains the development scenes as users do, and prints one table.

    python benchmarks/make_capture.py --scene robot --out captures/robot          (and procedural, room)
    python benchmarks/refilm.py ../shared/data/splatv/spinach_4.splatv captures/kitchen --frames 50
    python benchmarks/quality.py captures/robot captures/procedural captures/room captures/kitchen ../shared/data/people

A folder's name says which scene it holds (SCENES).  Three cameras are never trained on.  Choices are made by two of them, an inner and an
outer one of the rig; the third is the test camera, which --test measures too.  Every second frame is left out of training, and "between"
is measured at those.  Moving pixels are those in the capture's masks, or where it has none, those that differ from the median over time.
Results go into benchmarks/results/quality.json as they come, under --name, and what is in there is not trained again; --table prints them.
"""
from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
RESULTS = ROOT / "benchmarks" / "results" / "quality.json"
MOVED = 0.05
"""Difference (0..1) of any channel from the median over time, from which on a pixel is moving."""
COLUMNS = {"inner": "inner camera", "inner between": "the same, between frames", "outer": "outer camera", "test": "test camera"}


@dataclass(frozen=True)
class Scene:
    """What is trained on and what is measured: views by their role (inner, outer, test); every `step`-th frame; training options.

    kind  where its pictures are from
    """

    views: dict[str, str]
    step: int = 2
    scale: float | None = None
    options: dict = field(default_factory=dict)
    kind: str = "synthetic"


SCENES = {
    "people": Scene({"test": "cam04"}, step=4, scale=0.25, kind="real"),
    "robot": Scene({"test": "cam00", "inner": "cam06", "outer": "cam01"}),
    "procedural": Scene({"test": "cam00", "inner": "cam06", "outer": "cam01"}, step=1),
    "room": Scene({"test": "cam00", "inner": "cam11", "outer": "cam01"}, options={"masks": "off"}),
    "kitchen": Scene({"test": "cam00", "inner": "cam09", "outer": "cam01"}, kind="refilmed, pictures by this renderer")}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--name", default="defaults", help="under which the results are kept, for example that of a variant")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a training option for all runs")
    parser.add_argument("--scale", type=float, help="factor on the size of all pictures, for quick comparisons")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--test", action="store_true", help="show the test cameras too")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--table", action="store_true", help="print what there is, train nothing")
    options = parser.parse_args()
    unknown = [str(path) for path in options.captures if path.name not in SCENES]
    if unknown:
        parser.error(f"{unknown[0]} is none of the scenes {', '.join(SCENES)}")
    results = json.loads(options.results.read_text("utf-8")) if options.results.exists() else {}
    for path in () if options.table else options.captures:
        for seed in range(options.seeds):
            key = f"{path.name} | {options.name} | seed {seed}"
            if key not in results:
                results[key] = one(path, SCENES[path.name], options, seed)
                write(options.results, results)
                print(key, json.dumps(results[key]), flush=True)
    show(results, options.test)


def one(path: Path, scene: Scene, options, seed: int) -> dict:
    """Train once, in a process of its own, and measure."""
    from fastgs_blender import formats

    scale = scene.scale if options.scale is None else options.scale * (scene.scale or 1.0)
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        given = [f"{name}={value}" for name, value in scene.options.items()] + options.set
        command = [sys.executable, "-m", "fastgs_blender", "train", str(path.resolve()), "--out", str(run), "--quiet", "--json",
                   "--preset", options.preset, "--held-out", ",".join(scene.views.values()), "--seed", str(seed),
                   "--threads", str(options.threads), *(word for text in given for word in ("--set", text))]
        command += ["--scale", str(scale)] if scale else []
        command += ["--frames", f"0:{frame_count(path) - 1}:{scene.step}"] if scene.step > 1 else []
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            raise SystemExit(f"{' '.join(command)}:\n{done.stderr[-3000:]}")
        model = formats.load(run / "model.safetensors")
        size = (run / "model.safetensors").stat().st_size
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"gaussians": len(model), "megabytes": round(size / 1e6, 2), "minutes": round(spent / 60, 1), "preset": options.preset,
            "set": options.set, "scale": scale, **measured(model, path, scene, scale)}


def frame_count(path: Path) -> int:
    from fastgs_blender.captures import open_capture

    return open_capture(path).clip.frame_count


def measured(model, path: Path, scene: Scene, scale: float | None) -> dict:
    """PSNR in dB of each role's view, [whole, moving pixels, still pixels], at the moments that were trained on and between them."""
    from fastgs_blender.captures import open_capture
    from fastgs_blender.captures.pixels.store import FrameStore

    capture = open_capture(path, scale=scale)
    store, found = FrameStore(capture), {}
    for role, view in scene.views.items():
        shots = [shot for shot in capture.shots if shot.view == view]
        pixels = [store.pixels(shot) for shot in shots]
        truths = np.array([p.rgb for p in pixels])
        moving = moving_pixels(truths) if pixels[0].mask is None else np.array([p.mask for p in pixels]) >= 0.5
        for name, rows in ((role, range(0, len(shots), scene.step)),
                           (f"{role} between", [k for k in range(len(shots)) if k % scene.step == scene.step // 2])):
            if scene.step > 1 or name == role:
                found[name] = errors(model, [shots[k] for k in rows], truths[rows], moving[rows], scene.step)
    return found


def moving_pixels(truths: np.ndarray) -> np.ndarray:
    """Where and when pictures of one camera [F, h, w, 3] differ from their median over time: bool [F, h, w]."""
    return (np.abs(truths - np.median(truths, 0)) > MOVED).any(-1)


def errors(model, shots, truths, moving, step: int) -> list[float]:
    """PSNR over all pixels (mean over the frames), and over the moving and the still pixels of all frames together."""
    from fastgs_blender.rendering.api import render

    wholes, sums, counts = [], np.zeros(2), np.zeros(2)
    for shot, truth, moves in zip(shots, truths, moving):
        picture = np.clip(render(model, shot.camera, shot.frame / step / model.clip.frame_count, ("rgb",))["rgb"], 0, 1)
        error = np.square(picture - truth).mean(-1)
        wholes.append(decibels(error.mean()))
        for part, mask in enumerate((moves, ~moves)):
            sums[part] += error[mask].sum()
            counts[part] += mask.sum()
    return [round(float(value), 3) for value in (np.mean(wholes), *decibels(sums / np.maximum(counts, 1)))]


def decibels(error):
    return -10 * np.log10(np.maximum(error, 1e-12))


def write(path: Path, results: dict) -> None:
    from fastgs_blender.util.outputs import replacing

    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing([path]) as (part,):
        part.write_text(json.dumps(dict(sorted(results.items())), indent=1), "utf-8")


def show(results: dict, test: bool) -> None:
    """A Markdown table: for each scene and name, whole / moving / still in dB, mean and deviation over the seeds."""
    columns = {name: title for name, title in COLUMNS.items() if test or name != "test"}
    print(f"\n| scene, run | {' | '.join(columns.values())} | Gaussians | MB | processor minutes | seeds |")
    print("|---" * (len(columns) + 5) + "|")
    groups = dict.fromkeys(key.rpartition(" | ")[0] for key in results)
    for group in sorted(groups, key=lambda group: list(SCENES).index(group.partition(" | ")[0])):
        runs = [run for key, run in results.items() if key.rpartition(" | ")[0] == group]
        cells = [" / ".join(spread([run[name][k] for run in runs]) for k in range(3)) if name in runs[0] else "" for name in columns]
        facts = [f"{np.mean([run['gaussians'] for run in runs]):.0f}", *(f"{np.mean([run[n] for run in runs]):.1f}"
                                                                        for n in ("megabytes", "minutes"))]
        scene, _, run = group.partition(" | ")
        print(f"| {scene}: {SCENES[scene].kind}, {run.replace(' | ', ', ')} | {' | '.join([*cells, *facts, str(len(runs))])} |")


def spread(values) -> str:
    return f"{np.mean(values):.2f}" + (f" ± {np.std(values, ddof=1):.2f}" if len(values) > 1 else "")


if __name__ == "__main__":
    main()
