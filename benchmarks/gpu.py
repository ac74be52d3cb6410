# SPDX-License-Identifier: GPL-3.0-or-later
"""The GPU backend's figures beside the processor's, from one run on whatever adapter is there.

    python benchmarks/gpu.py [--device NAME] [--gaussians 300000 3000000] [--sizes 1352x1014 3840x2160] [--runs 9] [--json FILE]

* stages           of a picture: slice and project, sort, tiles and rasterise; waited for one by one
* 4D frames        a second, from the model (Fourier L = 5, temporal opacity, rotation, features with decoder), each at another time: as
                   pictures in the processor's memory, and, on the GPU, as pictures that stay there
* training step    forward, L1 + D-SSIM, backward, motion penalty, statistics, Adam, as train_step.py has it
* gsplat           where torch with CUDA and gsplat are installed, on the same Gaussians at one time: forward, and a step with the same loss

Software adapters are measured only when they are named (--device llvmpipe), and then say nothing about GPUs: give small numbers.
"""
from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from itertools import count, product
from pathlib import Path

import numpy as np
from raster_cpu import fg, scene, threads
from train_step import TIME, Step

from fastgs_blender.kernels.gpu.adapters import find
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.util.backends import load_backend

AT_ONCE = 8
"""Frames or steps that are handed to the GPU before it is waited for."""


def per_run(work, runs: int, wait=lambda: None) -> float:
    """Milliseconds of work(), the median of `runs` times AT_ONCE of them after as many to warm up; wait() waits for all of it."""
    times = []
    for _ in range(runs + 1):
        begin = time.perf_counter()
        for _ in range(AT_ONCE):
            work()
        wait()
        times.append(1e3 * (time.perf_counter() - begin) / AT_ONCE)
    return statistics.median(times[1:])


def frozen(model: fg.GaussianModel) -> fg.GaussianModel:
    """The model as one that was read from a file: its arrays cannot change, so they stay on a GPU."""
    for array in model.arrays.values():
        array.flags.writeable = False
    return model


def stages(name: str, n: int, width: int, height: int, runs: int) -> dict:
    """Milliseconds of each stage on the GPU and on the processor, in turn."""
    model, camera = scene(n, width, height, "features")
    instance = Instance(frozen(model), np.eye(4), TIME).viewed(camera)
    out = {"Gaussians": n, "size": f"{width} x {height}"}
    for label, backend in (("GPU", name), ("CPU", "cpu")):
        load_backend(backend).measure_stages(instance, camera, 1)
        found, drawn = load_backend(backend).measure_stages(instance, camera, runs)
        out |= {"visible": drawn, **{f"{stage}, {label} ms": value for stage, value in found.items()}}
    return out


def frames(name: str, n: int, width: int, height: int, runs: int) -> dict:
    """4D frames a second."""
    model, camera = scene(n, width, height, "features")
    model, gpu, times = frozen(model), load_backend(name), (0.01 * k % 1 for k in count())

    def stay():
        instances = [Instance(model, np.eye(4), next(times)).viewed(camera)]
        layout = Layout(instances, False)
        return gpu.colour(gpu.draw(instances, camera, layout, (), lambda share: None), layout, camera)

    found = {"GPU": 1e3 / per_run(lambda: fg.render(model, camera, next(times), backend=name), runs),
             "GPU, pictures stay there": 1e3 / per_run(stay, runs, gpu.device.wait),
             "CPU": 1e3 / per_run(lambda: fg.render(model, camera, next(times), backend="cpu"), max(runs // 3, 1))}
    return {"Gaussians": n, "size": f"{width} x {height}", **{f"{label}, frames a second": value for label, value in found.items()},
            "GPU / CPU": found["GPU"] / found["CPU"]}


def training(name: str, n: int, width: int, height: int, runs: int) -> dict:
    """Milliseconds of a training step."""
    ours, theirs = Step(n, width, height, name), Step(n, width, height)
    gpu, cpu = per_run(ours, runs, ours.backend.device.wait), per_run(theirs, max(runs // 3, 1))
    return {"Gaussians": n, "size": f"{width} x {height}", "GPU ms": gpu, "CPU ms": cpu, "CPU / GPU": cpu / gpu}


def gsplat(n: int, width: int, height: int, runs: int) -> dict | None:
    """gsplat's forward pass, and its step with the same loss and torch's fused Adam, on the Gaussians of one time; None without it."""
    try:
        import torch
        from gsplat import rasterization
    except ImportError:
        return None
    if not torch.cuda.is_available():
        return None
    model, camera = scene(n, width, height, "rgb")
    now = fg.slice_model(model, TIME, cull=False)
    opacities = np.log(now.opacity / (1 - now.opacity))
    given = {"means": now.position, "quats": now.rotation, "scales": np.log(now.scale), "opacities": opacities, "colors": now.features}
    leaves = {key: torch.tensor(value, dtype=torch.float32, device="cuda").requires_grad_() for key, value in given.items()}
    views = torch.tensor(camera.world_to_camera[None], dtype=torch.float32, device="cuda")
    lens = torch.tensor([[[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]], dtype=torch.float32, device="cuda")
    window = torch.exp(-torch.arange(-5, 6, device="cuda") ** 2 / (2 * 1.5**2))
    window = (window / window.sum())[None, None, None]
    optimiser = torch.optim.Adam(leaves.values(), lr=1e-5, fused=True)

    def picture():
        shown = {**leaves, "scales": leaves["scales"].exp(), "opacities": leaves["opacities"].sigmoid()}
        return rasterization(**shown, viewmats=views, Ks=lens, width=width, height=height)[0].permute(0, 3, 1, 2)

    with torch.no_grad():
        target = picture() * 0.95

    def blurred(image):
        across = torch.nn.functional.conv2d(image.transpose(0, 1), window, padding=(0, 5))
        return torch.nn.functional.conv2d(across, window.transpose(2, 3), padding=(5, 0))

    def step():
        optimiser.zero_grad(set_to_none=True)
        x = picture()
        a, b = blurred(x), blurred(target)
        over = (2 * a * b + 1e-4) * (2 * (blurred(x * target) - a * b) + 9e-4)
        under = (a * a + b * b + 1e-4) * (blurred(x * x) - a * a + blurred(target * target) - b * b + 9e-4)
        (0.8 * (x - target).abs().mean() + 0.2 * (1 - over / under).mean()).backward()
        optimiser.step()

    with torch.no_grad():
        forward = per_run(picture, runs, torch.cuda.synchronize)
    return {"Gaussians": n, "size": f"{width} x {height}", "card": torch.cuda.get_device_name(), "forward ms": forward,
            "step ms": per_run(step, runs, torch.cuda.synchronize)}


def main(given: list[str] | None = None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="", metavar="NAME", help="a part of the adapter's name (default: the best GPU)")
    parser.add_argument("--gaussians", type=int, nargs="+", default=[300_000, 3_000_000])
    parser.add_argument("--sizes", nargs="+", default=["1352x1014", "3840x2160"])
    parser.add_argument("--step-gaussians", type=int, default=300_000)
    parser.add_argument("--step-size", default="1352x1014")
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", help="write the figures here as well")
    args = parser.parse_args(given)
    adapter = find(args.device)
    name = f"gpu:{adapter.name}"
    sizes = [tuple(int(value) for value in text.split("x")) for text in args.sizes]
    step = args.step_gaussians, *(int(value) for value in args.step_size.split("x"))
    results: dict = {}

    def found(title: str, figures: dict) -> None:
        """Print figures as soon as they are there: a later part may fail."""
        results[title] = figures
        print(title)
        for label, value in figures.items():
            print(f"    {label:40}{value:14.3f}" if isinstance(value, float) else f"    {label:40}{value:>14}", flush=True)

    found("machine", {"adapter": adapter.name, "kind": adapter.kind, "interface": adapter.interface, "driver": adapter.driver,
                      "processor threads": threads.thread_count()})
    for (width, height), n in product(sizes, args.gaussians):
        title = f"{n} Gaussians, {width} x {height}"
        found(f"stages, {title}", stages(name, n, width, height, args.runs))
        found(f"4D frames, {title}", frames(name, n, width, height, args.runs))
    found("training step", training(name, *step, args.runs))
    found("gsplat", gsplat(*step, args.runs) or {"gsplat": "not installed, or torch has no CUDA"})
    if failed := load_backend(name).failed:
        sys.exit(f"{adapter.name} has failed, so these are no figures: {failed}.")
    if args.json:
        Path(args.json).write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
