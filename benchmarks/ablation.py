# SPDX-License-Identifier: GPL-3.0-or-later
"""Does it help?  The paper's comparisons on our captures: kind of motion, density control, and motion regulariser.

    python benchmarks/make_capture.py --scene procedural --out captures/procedural --size 240x180 --cameras 18 --frames 24
    python benchmarks/ablation.py captures/procedural

All runs on a capture have the same starting points, steps and most Gaussians.  Each row of a table gets the same search over its RATES, one
after the other: three times as high or as low, and on in the direction that gains, judged by the moving pixels (masks) of the camera
VALIDATION.  The best rates are repeated with two more seeds, and measured in the camera TEST and in pictures that were trained on.  Results
go into benchmarks/results/ablation.json as they come, and what is in there is not run again; --table prints the tables and draws
ablation.png.
"""
from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
RESULTS = ROOT / "benchmarks" / "results" / "ablation.json"

SEEDS = (0, 1, 2)
RATES = ("motion_rate", "position_rate")
"""The settings that the search changes, in this order; the first one is that of a basis's coefficients."""
STEP, MOST = 3.0, 27.0
"""Factor between two rates of the search, and the farthest factor on the default."""
TEST, VALIDATION = "cam00", "cam06"
COMMON = dict(iterations=10_000, max_gaussians=4000, init_points=2500, densify_every=100, motion_weight=0.01, preview_every=0)
SCALE = 1 / 3
PAPER = dict(motion="paper", order=5)
COSINES = dict(motion="cosine", order=10)
TABLES = {
    "kind of motion (lambda 0.01)": {
        "Fourier, period 1, L = 5 (the paper's)": PAPER,
        "cosines, 10": COSINES,
        "polynomial, cubic": dict(motion="polynomial", order=3),
        "Fourier + linear, L = 5": dict(motion="fourier+linear", order=5),
        "keyframes, 11": dict(motion="keyframes", order=11)},
    "density control (cosines, 10)": {
        "clone, split, prune": COSINES,
        "MCMC": {**COSINES, "density": "mcmc"}},
    "motion regulariser lambda (Fourier, L = 5)": {f"lambda = {x:g}": {**PAPER, "motion_weight": x} for x in (0.01, 0.1, 0)},
}
"""Tables of runs; the same settings in two tables are one run."""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="rows side by side, with one thread each")
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="of the best rate; 1: do not repeat it")
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
            prepare(capture, common)
            rows = {name_of(settings): settings for rows in TABLES.values() for settings in rows.values()}
            with ThreadPoolExecutor(options.jobs) as pool:  # all searches, then further seeds of what they found
                for seeds in (SEEDS[:1], SEEDS[1:options.seeds]):
                    list(pool.map(partial(searched, capture, common, results, options.results, seeds), rows.values()))
    show(results, options.results.with_suffix(".png"))


def searched(capture: Path, common: dict, results: dict, path: Path, seeds: tuple[int, ...], row: dict) -> None:
    """The search over one row's rates, and these seeds of the best ones."""
    from fastgs_blender.training.core.settings import settings as make

    usual = vars(make(**{**common, **row}))

    def judged(factors: dict[str, float], seed: int = SEEDS[0]) -> float:
        settings = {**common, **row, **{rate: usual[rate] * factor for rate, factor in factors.items()}, "seed": seed}
        name = key(capture.name, row, factors, seed)
        if results.get(name, {}).get("settings") != settings:
            results[name] = {**launch(capture, settings), "factors": factors}
            write(path, results)
            print(f"{name:90} {results[name]['validation']} {results[name]['seconds']:.0f} s", flush=True)
        return results[name]["validation"][1]

    found: dict[str, float] = {}
    for rate in RATES:
        def at(factor: float, rate=rate) -> float:
            return judged({**found, rate: factor} if factor != 1 or not found else found)

        best = max((1.0, STEP), key=at)
        onward = STEP if best > 1 else 1 / STEP
        while max(best * onward, 1 / (best * onward)) <= MOST and at(best * onward) > at(best):
            best *= onward
        if best != 1 or not found:
            found[rate] = best
    for seed in seeds:
        judged(found, seed)


def name_of(settings) -> str:
    """The row's own name: its settings."""
    return " ".join(f"{name}={value:g}" if not isinstance(value, str) else value for name, value in sorted(
        {"motion_weight": COMMON["motion_weight"], **settings}.items()))


def key(capture: str, row: dict, factors: dict[str, float], seed: int) -> str:
    return f"{capture} | {name_of(row)} | {told(factors)} | seed {seed}"


def told(factors: dict[str, float]) -> str:
    return ", ".join(f"{rate} x {factor:.3g}" for rate, factor in factors.items())


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

    return open_capture(folder, scale=SCALE, held_out=[TEST, VALIDATION])


def points_file(folder: Path, common) -> Path:
    return folder / f".ablation-points-{common['points']}.npz"


def prepare(folder: Path, common):
    """The starting points that all runs share, made once."""
    from fastgs_blender.captures.pixels.store import FrameStore
    from fastgs_blender.training.core.settings import settings
    from fastgs_blender.training.initial.backdrop import with_backdrop
    from fastgs_blender.training.initial.starting_points import initial_points
    from fastgs_blender.util.outputs import replacing

    path = points_file(folder, common)
    if path.exists():
        return
    capture = opened(folder)
    store = FrameStore(capture)
    store.fill()
    made = settings(**common)
    points, _ = initial_points(capture, store, made)
    points = with_backdrop(capture, store, made, points)
    with replacing([path]) as (part,), part.open("wb") as file:
        np.savez(file, **{name: array for name, array in vars(points).items() if array is not None})


def one(capture: str, settings: dict) -> dict:
    """Train once and measure in the held-out views."""
    from fastgs_blender.captures.capture import Points
    from fastgs_blender.captures.pixels.store import FrameStore
    from fastgs_blender.training.core.settings import settings as make
    from fastgs_blender.training.core.start import Start
    from fastgs_blender.training.core.trainer import Trainer
    from fastgs_blender.training.initial.first_model import depth_of, model_from_points

    made = make(**settings)
    filmed = opened(capture)
    store = FrameStore(filmed)
    with np.load(points_file(Path(capture), settings)) as arrays:
        points = Points(**arrays)
    first = model_from_points(points, made, filmed.clip, filmed.axes, filmed.extent)
    trainer = Trainer(filmed, store, made, Start(first, points.size, depth_of(points, filmed)))
    began = time.process_time()
    losses = [trainer.step()["loss"] for _ in range(made.iterations)]
    seconds = time.process_time() - began
    found = {name: decibels(trainer, [shot for shot in filmed.held_out if shot.view == view])
             for name, view in (("test", TEST), ("validation", VALIDATION))}
    found["training"] = decibels(trainer, filmed.training[:: max(1, len(filmed.training) // 40)])
    return {**found, "loss": round(float(np.mean(losses[-100:])), 5), "gaussians": len(trainer), "seconds": round(seconds, 1),
            "basis": repr(trainer.template.basis), "settings": settings}


def decibels(trainer, shots) -> list[float]:
    """PSNR of the whole pictures and of the moving subject in them."""
    whole, subject, _ = trainer.measure(shots)
    return [round(whole, 3), round(whole if subject is None else subject, 3)]


# What came out


def write(path: Path, results):
    from fastgs_blender.util.outputs import replacing

    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing([path]) as (part,):
        part.write_text(json.dumps(dict(sorted(results.items())), indent=1), "utf-8")


def best_runs(results, capture: str, row: dict) -> list[dict]:
    """The runs of a row's best rate, one a seed; none where it has not been run."""
    runs = [run for name, run in results.items() if name.startswith(f"{capture} | {name_of(row)} | ")]
    if not runs:
        return []
    best = max((run for run in runs if run["settings"]["seed"] == SEEDS[0]), key=lambda run: run["validation"][1])["factors"]
    return [run for run in runs if run["factors"] == best]


def show(results, picture: Path):
    """Markdown tables, and a plot of all of them."""
    captures = sorted({k.split(" | ")[0] for k in results}, reverse=True)
    for capture in captures:
        for title, rows in TABLES.items():
            print(f"\n**{capture}: {title}**\n\n| | best rates | test camera: whole, subject (dB) | pictures trained on | seeds |"
                  "\n|---|---|---|---|---|")
            for label, row in rows.items():
                runs = best_runs(results, capture, row)
                if runs:
                    test, trained = (", ".join(spread([run[name][k] for run in runs]) for k in (0, 1)) for name in ("test", "training"))
                    print(f"| {label} | {told(runs[0]['factors'])} | {test} | {trained} | {len(runs)} |")
    if results:
        draw(results, captures, picture)
        print(f"\n{picture}")


def spread(values) -> str:
    return f"{np.mean(values):.2f}" + (f" ± {np.std(values, ddof=1):.2f}" if len(values) > 1 else "")


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
        pen.text((8, top), f"{title}: PSNR of the subject in the test camera", "black")
        for column, capture in enumerate(captures):
            found = {label: np.array([run["test"][1] for run in best_runs(results, capture, row)]) for label, row in rows.items()}
            found = {label: values for label, values in found.items() if len(values)}
            left = label_width + column * wide
            pen.text((left, top + 14), capture, (90, 90, 90))
            if not found:
                continue
            values = [each.mean() for each in found.values()]
            low, high = np.floor(min(values) - 1), max(values)
            for i, label in enumerate(rows):
                y = top + 32 + i * line
                if not column:
                    pen.text((8, y), label, "black")
                match = found.get(label)
                if match is None:
                    continue
                end = left + (wide - 110) * (match.mean() - low) / max(high - low, 1e-9)
                pen.rectangle((left, y, end, y + line - 6), fill=(52, 110, 160) if match.mean() < high else (200, 110, 40))
                for value in match:
                    x = left + (wide - 110) * (value - low) / max(high - low, 1e-9)
                    pen.line((x, y + 2, x, y + line - 8), fill="black")
                farthest = left + (wide - 110) * (max(match.max(), match.mean()) - low) / max(high - low, 1e-9)
                pen.text((farthest + 6, y), f"{match.mean():.2f} dB", "black")
        top += height
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing([path]) as (part,), part.open("wb") as file:
        image.save(file, format="PNG")


if __name__ == "__main__":
    main()
