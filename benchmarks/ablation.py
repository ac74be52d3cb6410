# SPDX-License-Identifier: GPL-3.0-or-later
"""Does it help?  The paper's comparisons on our captures: Fourier order, motion regulariser, kind of motion; and density control.

    python benchmarks/make_capture.py --scene robot --out captures/robot          (and procedural)
    python benchmarks/ablation.py captures/robot captures/procedural

All runs on a capture have the same starting points, steps and most Gaussians, and differ in what the table says alone.  PSNR in the
held-out view, over the whole picture and over the moving subject (masks).  Runs that lie within CLOSE of the best of their table get two
more seeds, and the mean of all three counts.  Results go into benchmarks/results/ablation.json as they come, and what is in there is not
run again; --table prints the tables and draws ablation.png.
"""
from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
RESULTS = ROOT / "benchmarks" / "results" / "ablation.json"

CLOSE = 0.3
"""dB in the subject's pixels."""
SEEDS = (0, 1, 2)
COMMON = dict(iterations=3000, max_gaussians=10_000, points=6000, densify_every=100, motion_weight=0.1, backdrop_hold=0.0, preview_every=0)
CAPTURES = {"robot": dict(scale=0.5, frames=slice(0, None, 2)), "procedural": dict(scale=0.75, frames=None)}
"""How much of a capture is used; by the folder's name, others as robot."""
PAPER = dict(motion="paper", order=5)
COSINES = dict(motion="cosine", order=10)
TABLES = {
    "Fourier order L (lambda 0.1)": {f"L = {n}": {**PAPER, "order": n} for n in (1, 3, 5, 7)},
    "motion regulariser lambda (Fourier, L = 5)": {f"lambda = {x:g}": {**PAPER, "motion_weight": x} for x in (0, 0.01, 0.1, 1)},
    "motion regulariser lambda (cosines, 10)": {
        f"lambda = {x:g}": {**COSINES, "motion_weight": x} for x in (0, 0.01, 0.1)},
    "kind of motion (lambda 0.1)": {
        "Fourier, period 1, L = 5 (the paper's)": PAPER,
        "Fourier, longer period, L = 5": dict(motion="fourier", order=5),
        "Fourier + linear, L = 5": dict(motion="fourier+linear", order=5),
        "cosines, 10": COSINES,
        "keyframes, 11": dict(motion="keyframes", order=11),
        "polynomial, cubic": dict(motion="polynomial", order=3),
        "polynomial, degree 10": dict(motion="polynomial", order=10)},
    "kind of motion (lambda 0.01)": {
        "Fourier, period 1, L = 5 (the paper's)": {**PAPER, "motion_weight": 0.01},
        "Fourier + linear, L = 5": dict(motion="fourier+linear", order=5, motion_weight=0.01),
        "cosines, 10": {**COSINES, "motion_weight": 0.01},
        "keyframes, 11": dict(motion="keyframes", order=11, motion_weight=0.01),
        "polynomial, cubic": dict(motion="polynomial", order=3, motion_weight=0.01)},
    "density control (cosines, 10)": {
        "clone, split, prune": COSINES,
        "the same with resets of opacity": {**COSINES, "reset_every": 600},
        "MCMC": {**COSINES, "density": "mcmc"}},
}
"""Tables of runs; the same settings in two tables are one run."""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="runs side by side, with one thread each")
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="of runs that are close; 1: do not repeat any")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a training option for all runs")
    parser.add_argument("--table", action="store_true", help="print and draw what there is, run nothing")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one(**json.loads(options.one))))
        return
    from fastgs_blender.training.core.settings import option_from_text

    common = {**COMMON, **dict(option_from_text(text) for text in options.set)}
    results = json.loads(options.results.read_text("utf-8")) if options.results.exists() else {}
    if not options.table:
        for capture in options.captures:
            work(capture, common, results, options)
    show(results, options.results.with_suffix(".png"))


def work(capture: Path, common, results, options):
    """All runs of a capture that have no result yet; then further seeds of those that are close."""
    prepare(capture, common)
    runs = {name_of(settings): settings for rows in TABLES.values() for settings in rows.values()}
    for seeds in (SEEDS[:1], SEEDS[1:options.seeds]):
        chosen = runs if seeds == SEEDS[:1] else close_runs(results, capture.name)
        todo = [(name, settings, seed) for seed in seeds for name, settings in chosen.items()
                if results.get(key(capture.name, name, seed), {}).get("settings") != {**common, **settings, "seed": seed}]
        with ThreadPoolExecutor(options.jobs) as pool:
            for (name, _, seed), result in zip(todo, pool.map(lambda job: launch(capture, {**common, **job[1], "seed": job[2]}), todo)):
                results[key(capture.name, name, seed)] = result
                write(options.results, results)
                print(f"{capture.name:12} {name:36} seed {seed}  {result['psnr']:6.2f} dB  subject {result['subject_psnr']:6.2f} dB"
                      f"  {result['gaussians']} Gaussians  {result['seconds']:.0f} s", flush=True)


def name_of(settings) -> str:
    """The run's own name: its settings."""
    return " ".join(f"{name}={value:g}" if not isinstance(value, str) else value for name, value in sorted(
        {"motion_weight": 0.1, **settings}.items()))


def key(capture, name, seed) -> str:
    return f"{capture} | {name} | seed {seed}"


def close_runs(results, capture) -> dict:
    """The runs of tables in which at least two lie within CLOSE of the best."""
    chosen = {}
    for rows in TABLES.values():
        values = {name_of(s): results[key(capture, name_of(s), SEEDS[0])]["subject_psnr"] for s in rows.values()}
        near = [name for name, value in values.items() if value > max(values.values()) - CLOSE]
        if len(near) > 1:
            chosen |= {name_of(s): s for s in rows.values() if name_of(s) in near}
    return chosen


# One run, in a process of its own


def launch(capture: Path, settings: dict) -> dict:
    """The result of one run in a process with one thread."""
    single = dict.fromkeys(("FASTGS_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    job = json.dumps({"capture": str(capture), "settings": settings})
    command = [sys.executable, __file__, "--one", job]
    done = subprocess.run(command, env={**os.environ, **single}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{settings}:\n{done.stderr[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def opened(folder):
    from fastgs_blender.captures import open_capture

    return open_capture(folder, **CAPTURES.get(Path(folder).name, CAPTURES["robot"]))


def points_file(folder: Path, common) -> Path:
    return folder / f".ablation-points-{common['points']}.npz"


def prepare(folder: Path, common):
    """The starting points that all runs share, made once."""
    from fastgs_blender.captures.pixels.store import FrameStore
    from fastgs_blender.training.core.settings import settings
    from fastgs_blender.training.initial.backdrop import with_backdrop
    from fastgs_blender.training.initial.points import initial_points
    from fastgs_blender.util.outputs import replacing

    path = points_file(folder, common)
    if path.exists():
        return
    capture = opened(folder)
    store = FrameStore(capture)
    store.fill()
    made = settings(**common)
    points = with_backdrop(capture, store, made, initial_points(capture, store, made))
    with replacing([path]) as (part,), part.open("wb") as file:
        np.savez(file, **{name: array for name, array in vars(points).items() if array is not None})


def one(capture: str, settings: dict) -> dict:
    """Train once and measure in the held-out views."""
    from fastgs_blender.captures.capture import Points
    from fastgs_blender.captures.pixels.store import FrameStore
    from fastgs_blender.training.core.settings import settings as make
    from fastgs_blender.training.core.trainer import Trainer
    from fastgs_blender.training.initial.model import model_from_points

    made = make(**settings)
    filmed = opened(capture)
    store = FrameStore(filmed)
    with np.load(points_file(Path(capture), settings)) as arrays:
        points = Points(**arrays)
    trainer = Trainer(filmed, store, made, model_from_points(points, made, filmed.clip, filmed.axes, filmed.extent), sizes=points.size)
    began = time.process_time()
    losses = [trainer.step()["loss"] for _ in range(made.iterations)]
    seconds = time.process_time() - began
    psnr, subject, _ = trainer.measure(filmed.held_out)
    trained, _, _ = trainer.measure(filmed.training[:: max(1, len(filmed.training) // 40)])
    return {"psnr": round(psnr, 3), "subject_psnr": round(psnr if subject is None else subject, 3), "training_psnr": round(trained, 3),
            "loss": round(float(np.mean(losses[-100:])), 5), "gaussians": len(trainer), "seconds": round(seconds, 1),
            "basis": repr(trainer.template.basis), "settings": settings}


# What came out


def write(path: Path, results):
    from fastgs_blender.util.outputs import replacing

    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing([path]) as (part,):
        part.write_text(json.dumps(dict(sorted(results.items())), indent=1), "utf-8")


def rows_of(results, capture, rows) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """(label, whole-picture PSNR of each seed, subject's PSNR of each seed) of the runs that there are."""
    found = []
    for label, settings in rows.items():
        runs = [results[k] for seed in SEEDS if (k := key(capture, name_of(settings), seed)) in results]
        if runs:
            found.append((label, np.array([r["psnr"] for r in runs]), np.array([r["subject_psnr"] for r in runs])))
    return found


def show(results, picture: Path):
    """Markdown tables, and a plot of all of them."""
    captures = sorted({k.split(" | ")[0] for k in results}, reverse=True)
    for title, rows in TABLES.items():
        heads = " | ".join(f"{c}: whole, subject (dB)" for c in captures)
        print(f"\n**{title}**\n\n| | {heads} |\n|---{'|---' * len(captures)}|")
        found = {c: {label: (whole, subject) for label, whole, subject in rows_of(results, c, rows)} for c in captures}
        for label in rows:
            cells = [f"{found[c][label][0].mean():.2f}, {found[c][label][1].mean():.2f}{spread(found[c][label][1])}"
                     if label in found[c] else "" for c in captures]
            print(f"| {label} | " + " | ".join(cells) + " |")
    if results:
        draw(results, captures, picture)
        print(f"\n{picture}")


def spread(values) -> str:
    return f" ± {values.std(ddof=1):.2f} ({len(values)} seeds)" if len(values) > 1 else ""


def draw(results, captures, path: Path):
    """Bars of the subject's PSNR: a row of panels for each table, a column for each capture."""
    from PIL import Image, ImageDraw

    from fastgs_blender.util.outputs import replacing

    wide, line, label_width = 470, 20, 250
    heights = [34 + line * len(rows) + 14 for rows in TABLES.values()]
    image = Image.new("RGB", (wide * len(captures) + label_width, sum(heights) + 10), "white")
    pen = ImageDraw.Draw(image)
    top = 8
    for height, (title, rows) in zip(heights, TABLES.items()):
        pen.text((8, top), f"{title}: PSNR of the subject in the held-out view", "black")
        for column, capture in enumerate(captures):
            found = rows_of(results, capture, rows)
            left = label_width + column * wide
            pen.text((left, top + 14), capture, (90, 90, 90))
            if not found:
                continue
            values = [subject.mean() for _, _, subject in found]
            low, high = np.floor(min(values) - 1), max(values)
            for i, label in enumerate(rows):
                y = top + 32 + i * line
                if not column:
                    pen.text((8, y), label, "black")
                match = next((subject for name, _, subject in found if name == label), None)
                if match is None:
                    continue
                end = left + (wide - 110) * (match.mean() - low) / max(high - low, 1e-9)
                pen.rectangle((left, y, end, y + line - 6), fill=(52, 110, 160) if match.mean() < high else (200, 110, 40))
                for value in match:
                    x = left + (wide - 110) * (value - low) / max(high - low, 1e-9)
                    pen.line((x, y + 2, x, y + line - 8), fill="black")
                pen.text((end + 6, y), f"{match.mean():.2f} dB", "black")
        top += height
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing([path]) as (part,), part.open("wb") as file:
        image.save(file, format="PNG")


if __name__ == "__main__":
    main()
