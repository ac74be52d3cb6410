# SPDX-License-Identifier: GPL-3.0-or-later
"""time the stages of rendering a frame

Without FILE it draws a cloud of random moving Gaussians (Fourier, order 5).  Times are medians in milliseconds; the first
frame is reported separately, because it may compile the renderer.
"""
from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..util.errors import FastGSError
from .shared import add_backend, chosen_backend, image_size, print_json, say, use_threads

if TYPE_CHECKING:
    from ..cameras.camera import Camera
    from ..model.gaussians import GaussianModel


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", nargs="?", metavar="FILE", help="a model to time (default: a synthetic one)")
    parser.add_argument("--gaussians", type=int, default=300_000, metavar="N", help="size of the synthetic model (default: 300000)")
    parser.add_argument("--size", default="1352x1014", metavar="WxH", help="image size (default: 1352x1014)")
    parser.add_argument("--camera", metavar="CAMERAS.json", help="cameras to look from (default: one that sees all of the model)")
    parser.add_argument("--view", default="0", metavar="NAME", help="which of them (default: the first)")
    parser.add_argument("--repeat", type=int, default=5, metavar="N", help="frames to time (default: 5)")
    add_backend(parser)


def run(args: argparse.Namespace) -> None:
    from .. import formats
    from ..cameras.cameras_json import choose, resized
    from ..cameras.opening import overview
    from .sight import sight

    if not (1 <= args.gaussians <= 100_000_000 and 1 <= args.repeat <= 10_000):
        raise FastGSError("--gaussians must be from 1 to 100000000 and --repeat from 1 to 10000.")
    use_threads(args.threads)
    size = image_size(args.size)
    model = formats.load(args.model) if args.model else synthetic(args.gaussians)
    if args.camera:
        camera = resized(choose(sight(args.camera).views, args.view, args.camera).camera, *size)
    else:
        camera = overview(model, *size)
    result = measure(model, camera, chosen_backend(args), args.repeat)
    if args.json:
        print_json(result)
        return
    say(f"{result['gaussians']} Gaussians, {size[0]} x {size[1]} pixels, {result['threads']} threads, backend {result['backend']}")
    if "visible" in result:
        say(f"{result['visible']} visible")
    say(f"first frame {result['first_frame_ms']:.0f} ms")
    whole = result["milliseconds"]["whole frame"]
    for stage, value in result["milliseconds"].items():
        say(f"{stage:<22}{value:9.1f} ms {100 * value / whole:6.0f} %")


def synthetic(count: int) -> GaussianModel:
    """A cloud of moving Gaussians in a ball, the same for the same count."""
    import numpy as np

    from ..model.appearance import SH
    from ..model.gaussians import Clip, GaussianModel
    from ..model.motion import Fourier, Polynomial
    from ..model.temporal import Radial

    rng = np.random.default_rng(1)
    basis, turn = Fourier(), Polynomial(1)
    draw = rng.standard_normal
    direction = draw((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return GaussianModel(
        position=direction * rng.uniform(0, 1, (count, 1)) ** (1 / 3), rotation=draw((count, 4)),
        scale=np.log(0.5 * count ** (-1 / 3)) - 0.7 + 0.4 * draw((count, 3)), opacity=0.5 + draw(count), features=0.5 * draw((count, 12)),
        motion=0.01 * draw((count, basis.terms, 3)), rotation_motion=0.1 * draw((count, 1, 4)), mu_tau=rng.uniform(0, 1, count),
        temporal=rng.uniform(0, 3, (count, 1)), basis=basis, rotation_basis=turn, temporal_kind=Radial(), appearance=SH(1),
        clip=Clip(60, 30))


def measure(model: GaussianModel, camera: Camera, backend: str, repeat: int) -> dict:
    """Median milliseconds of the stages and of the whole frame, at the middle of the clip."""
    import numpy as np

    from ..rendering.api import render
    from ..rendering.instances import Instance
    from ..util.backends import load_backend, real_name
    from ..util.threads import thread_count

    backend = real_name(backend)

    def frame() -> None:
        render(model, camera, 0.5, backend=backend)

    first = _milliseconds(frame)
    stages, counts = {}, {}
    if backend != "reference":
        kernels = load_backend(backend)
        stages, visible = kernels.measure_stages(Instance(model, np.eye(4), 0.5).viewed(camera), camera, repeat)
        counts = {"visible": visible}
    stages["whole frame"] = statistics.median(_milliseconds(frame) for _ in range(repeat))
    return {"gaussians": len(model), "width": camera.width, "height": camera.height, "backend": backend, "threads": thread_count(),
            **counts, "first_frame_ms": round(first, 3), "milliseconds": {name: round(ms, 3) for name, ms in stages.items()}}


def _milliseconds(work: Callable[[], None]) -> float:
    start = time.perf_counter()
    work()
    return 1000 * (time.perf_counter() - start)
