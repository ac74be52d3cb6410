# SPDX-License-Identifier: GPL-3.0-or-later
"""The CPU renderer's figures, from one run.

    python benchmarks/raster_cpu.py [--gaussians 300000] [--size 1352x1014] [--runs 9] [--json FILE]

* beside hand-written  our rasterise stage, and our whole frame, beside AVX2 intrinsics (raster_limit.cpp, if g++ is at hand) on
  AVX2                 identical splats; they run in turn.  On a busy machine the fastest runs say more, with FASTGS_THREADS=1
* whole frame          from a 4D model (Fourier L = 5, temporal opacity, rotation, features with decoder) to the image,
                       and from the same frame sliced beforehand into a static model
* peak memory          of a process that loads 1 M Gaussians and renders a frame, Python and compiled kernels included; and beyond an
                       idle process
* start to first frame of a process: imports, a frame of 10 000 Gaussians, kernels from the cache; the same with none compiled, of which
                       a second process compiles a part, whose processor time is not counted
"""
from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
LIMIT = Path(__file__).with_name("raster_limit.cpp")
INNER = 3
"""Calls of each in a turn, of which the fastest counts."""
sys.path.insert(0, str(ROOT))

from cloud import scene  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.kernels.cpu import raster, rasterise, splats, tile_lists  # noqa: E402
from fastgs_blender.kernels.cpu.project import SCALE  # noqa: E402
from fastgs_blender.rendering.instances import Instance  # noqa: E402
from fastgs_blender.rendering.layout import Layout  # noqa: E402
from fastgs_blender.util import threads  # noqa: E402


def timed(*functions, runs: int) -> list[list[float]]:
    """Milliseconds of each function, called in turn, `runs` times after one warm-up each."""
    times = [[] for _ in functions]
    for run in range(runs + 1):
        for function, out in zip(functions, times):
            begin = time.perf_counter()
            function()
            if run:
                out.append(1e3 * (time.perf_counter() - begin))
    return times


class Stage:
    """The rasterise stage of one frame, ready to run: everything before it is done."""

    def __init__(self, model, camera, t):
        instance = Instance(model, np.eye(4), t).viewed(camera)
        layout = Layout([instance], False)
        self.size = (camera.height, camera.width)
        projected = splats.project_instances([instance], camera, layout)
        self.channels, self.order = projected.channels, projected.order()
        self.geometry, self.attributes = projected.geometry, projected.attributes
        self.columns, self.rows = -(-camera.width // raster.TILE), -(-camera.height // raster.TILE)
        grid = (0, 0, self.columns, self.rows)
        segments, counts = tile_lists.list_spans(self.order, self.geometry, self.attributes, grid, raster.TILE)
        self.starts, self.ids = tile_lists.list_tiles(segments, counts, 0, counts.shape[1])
        self.out, self.alpha = np.zeros((*self.size, self.channels), np.float32), np.zeros(self.size, np.float32)

    def __call__(self):
        kernel, (height, width) = raster.rasteriser(self.channels), self.size
        rest = (self.columns, 0, 0, width, height, 0, 0, self.starts, self.ids, self.geometry, self.attributes, self.out, self.alpha,
                rasterise.NONE, raster.NOTHING, rasterise.NONE, 0.0, 0.0, np.ones(self.columns * self.rows, np.bool_))
        threads.run(lambda first, last: kernel(first, last, *rest), threads.ranges(self.columns * self.rows, rasterise.TILES))

    def write(self, folder: Path) -> list[str]:
        """The same splats and lists as files for raster_limit.cpp.  Rows of Gaussians that are not seen have never been written: zeros."""
        a, b, c = self.geometry[:, 2:].T / SCALE  # the scaled triangle of the inverse covariance, back to conic A, B, C
        conic = np.stack([a * a, a * b, b * b + c * c], 1)
        with np.errstate(all="ignore"):
            splats = np.concatenate([self.geometry[:, :2], conic, np.exp2(self.attributes[:, :1]), self.attributes[:, raster.CHANNEL:]], 1)
        splats[np.setdiff1d(np.arange(len(splats)), self.ids)] = 0
        files = [folder / f"{name}.bin" for name in ("splats", "starts", "ids")]
        for file, array in zip(files, (splats.astype(np.float32), self.starts, self.ids)):
            array.tofile(file)
        return [str(file) for file in files]


class Limit:
    """raster_limit.cpp, compiled here, ready to run on the splats and lists of a stage: hand-written AVX2."""

    def __init__(self, stage: Stage, folder: Path):
        program, self.picture, self.size = folder / "limit", folder / "out.bin", stage.size
        subprocess.run(["g++", "-O3", "-march=native", "-ffast-math", "-fopenmp", str(LIMIT), "-o", str(program)], check=True)
        height, width = stage.size
        self.command = [str(program), *stage.write(folder), str(width), str(height), str(INNER), str(self.picture)]

    def __call__(self) -> float:
        """Milliseconds of the fastest of INNER runs."""
        env = {**os.environ, "OMP_NUM_THREADS": str(threads.thread_count())}
        return float(subprocess.run(self.command, env=env, check=True, capture_output=True, text=True).stdout.split()[0])

    def image(self) -> np.ndarray:
        return np.fromfile(self.picture, np.float32).reshape(*self.size, 4)


def beside_limit(n, width, height, runs) -> dict:
    """Our rasterise stage and our whole frame, RGB, beside raster_limit.cpp on the same splats and the same tile lists, in turn."""
    model, camera = scene(n, width, height)
    stage = Stage(model, camera, 0.4)
    ours = [stage, lambda: fg.render(model, camera, 0.4, backend="cpu")]
    found = {"Gaussians": n, "visible": len(stage.order), "tile entries": len(stage.ids), "threads": threads.thread_count()}
    if not shutil.which("g++"):
        return found | {"rasterise ms": statistics.median(timed(stage, runs=runs)[0])}
    with tempfile.TemporaryDirectory() as folder:
        limit = Limit(stage, Path(folder))
        rows = np.array([[limit(), *(min(times) for times in timed(*ours, runs=INNER))] for _ in range(runs)])
        difference = float(np.abs(limit.image()[..., :3] - stage.out).mean())
    for name, times in zip(("rasterise", "frame"), rows.T[1:]):
        found |= {f"{name} ms": float(np.median(times)), f"{name} / limit, median": float(np.median(times / rows[:, 0])),
                  f"{name} / limit, fastest": float(times.min() / rows[:, 0].min())}
    return found | {"limit ms": float(np.median(rows[:, 0])), "mean difference of the pictures": difference}


def whole_frame(n, width, height, runs, appearance) -> dict:
    """Model to image: a 4D model, the same frame as a static model, and the rasterise stage alone."""
    model, camera = scene(n, width, height, appearance)
    static, stage = fg.freeze(model, 0.4), Stage(model, camera, 0.4)
    frame, still, alone = timed(lambda: fg.render(model, camera, 0.4, backend="cpu"),
                                lambda: fg.render(static, camera, 0.0, backend="cpu"), stage, runs=runs)
    return {"frame ms": statistics.median(frame), "static frame ms": statistics.median(still), "rasterise ms": statistics.median(alone),
            "frame / rasterise": statistics.median(a / b for a, b in zip(frame, alone)),
            "4D / static": statistics.median(a / b for a, b in zip(frame, still))}


def child(code: str, **environment: str) -> dict:
    """Run Python code in a process of its own; what it prints last is JSON.  Python may keep modules compiled, as it does for users."""
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=inherited | environment, check=True, stdout=subprocess.PIPE, text=True)
    end, after = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return json.loads(out.stdout.splitlines()[-1]) | {"process s": end - begin, "its processor time s": spent}


def peak_memory(n, width, height, appearance) -> dict:
    """Resident memory of a process that loads a model from its file and renders one frame, Python and the kernels included; and of an idle
    one, which has drawn a single Gaussian in 16 x 16 pixels.  Pages of libraries count in both, though processes share them.

    From Linux' VmHWM: getrusage would count the parent's memory too.
    """
    def measured(model: str, width: int, height: int) -> dict:
        code = f"""
import sys; sys.path.insert(0, "benchmarks")
import json, raster_cpu as bench, fastgs_blender as fg
camera = bench.scene(1, {width}, {height})[1]
model = {model}
fg.render(model, camera, 0.4, backend="cpu")
peak = 1024 * next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps({{"model": model.nbytes, "peak": peak}}))
"""
        child(code)  # compiles what is not in the cache
        return child(code)

    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "model.safetensors")
        fg.save(scene(n, width, height, appearance)[0], path)
        peak, idle = measured(f"fg.load({path!r})", width, height), measured(f"bench.scene(1, 16, 16, {appearance!r})[0]", 16, 16)
    model = peak["model"]
    return {"model MB": model / 1e6, "peak MB": peak["peak"] / 1e6, "idle MB": idle["peak"] / 1e6, "peak / model": peak["peak"] / model,
            "(peak - idle) / model": (peak["peak"] - idle["peak"]) / model}


def start(runs: int) -> dict:
    """Process start to first frame: with the kernels in the cache, the median of several processes; and with none compiled."""
    code = """
import sys; sys.path.insert(0, "benchmarks")
from cloud import fg, scene
fg.render(*scene(10_000, 640, 360), 0.4, backend="cpu")
print("{}")
"""
    child(code)
    warm = [child(code) for _ in range(runs)]
    with tempfile.TemporaryDirectory() as folder:
        cold = child(code, FASTGS_CACHE_DIR=folder)
    found = {name: statistics.median(run[name] for run in warm) for name in warm[0]}
    return found | {f"none compiled: {name}": cold[name] for name in cold}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=300_000)
    parser.add_argument("--size", default="1352x1014")
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", help="write the figures here as well")
    args = parser.parse_args()
    width, height = (int(v) for v in args.size.split("x"))
    sections = {
        "beside hand-written AVX2": lambda: beside_limit(args.gaussians, width, height, args.runs),
        "whole frame, RGB": lambda: whole_frame(args.gaussians, width, height, args.runs, "rgb"),
        "whole frame, features + decoder": lambda: whole_frame(args.gaussians, width, height, args.runs, "features"),
        "peak memory, 1 M Gaussians": lambda: peak_memory(1_000_000, width, height, "rgb"),
        "peak memory, 1 M Gaussians, features": lambda: peak_memory(1_000_000, width, height, "features"),
        "start to first frame": lambda: start(args.runs),
    }
    results = {}
    for title, measure in sections.items():
        results[title] = measure()
        print(title)
        for name, value in results[title].items():
            print(f"    {name:34}{value:12.3f}" if isinstance(value, float) else f"    {name:34}{value:12}")
    if args.json:
        Path(args.json).write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
