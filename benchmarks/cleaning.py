# SPDX-License-Identifier: GPL-3.0-or-later
"""What does cleaning change, in held-out cameras and beside the cameras?

    python benchmarks/make_capture.py --scene robot --rig arc --cameras 13 --frames 16 --size 240x180 --out captures/robot
    python benchmarks/make_capture.py --scene robot --rig arc --cameras 6 --frames 16 --only-frames 13 --size 240x180 --beside 50 --depth
        --out captures/robot-beside
    fastgs train captures/robot --out runs/robot --preset draft --scale 1 --frames 0:15:3
    python benchmarks/cleaning.py runs/robot/model.safetensors captures/robot --beside captures/robot-beside --step 3
    python benchmarks/cleaning.py ../shared/data/splatv/spinach_4.splatv --sheet spinach.png

With a capture: PSNR on views that the model was not trained on, before and after.  --beside is the same scene filmed from beside the rig,
with depths: PSNR there, and the share of the light that arrives from at least a tenth nearer than the true surface.  A model without a
capture is given the cameras of refilm.py but for the middle one: how its picture changes, and how much of the light of views from beside
comes from what is taken.
"""
from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import refilm  # noqa: E402

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.viewpoints import viewpoint_of  # noqa: E402
from fastgs_blender.captures.pixels.store import FrameStore  # noqa: E402
from fastgs_blender.evaluation.training_record import recorded  # noqa: E402
from fastgs_blender.model.appearance import RGB  # noqa: E402
from fastgs_blender.model.slicing import positions_at  # noqa: E402
from fastgs_blender.util.backends import load_backend  # noqa: E402
from fastgs_blender.util.picture_files import write_png  # noqa: E402

NEARER = 0.9
"""Share of the true depth below which light hangs before the surface."""
SIDEWAYS = ((-5, 0, 0), (5.5, -0.5, 0), (0, -5, 3), (-7, 0, 9), (7, -1, 9), (0, 0, -6))
"""Eyes beside the rig of refilm.py, and nearer and farther."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("capture", type=Path, nargs="?")
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--step", type=int, default=1, help="every so many of the capture's frames were trained on")
    parser.add_argument("--views", help="held-out views to measure; all by default")
    parser.add_argument("--beside", type=Path)
    parser.add_argument("--strengths", default="0.5,0.75,1")
    parser.add_argument("--sheet", type=Path, help="write pictures from beside: before, and after each strength")
    options = parser.parse_args()
    model = fg.load(options.model)
    if options.capture is None:
        rig = [refilm.camera(place, 480, 360, 500.0) for place in refilm.rig()]
        model = replace(model, surroundings=fg.Surroundings(cameras=tuple(viewpoint_of(camera, distance=16.0) for camera in rig[1:])))
        held = [(rig[0], t, np.clip(fg.render(model, rig[0], t)["rgb"], 0, 1)) for t in (0.1, 0.5, 0.9)]
        sides = [(refilm.camera(np.array(eye, float), 240, 180, 200.0), 0.3, None, None) for eye in SIDEWAYS]
    else:
        held, sides = held_out(model, options), beside(options.beside) if options.beside else []
    start = time.process_time()
    fg.clean(model)
    seconds = time.process_time() - start
    print(f"{options.model}: {len(model)} Gaussians, {len(model.surroundings.cameras)} cameras, {seconds:.1f} s of processor")
    sheet, none = [], np.zeros(len(model), bool)
    for strength in (0.0, *map(float, options.strengths.split(","))):
        found = fg.clean(model, strength) if strength else None
        taken = none if found is None else found.taken
        left = model.take(~taken)
        kinds = {} if found is None else {kind: int(bits.sum()) for kind, bits in found.found.items()}
        print(f"strength {strength}: {taken.sum()} taken {kinds}; held out {psnr(left, held):.3f} dB", end="")
        if sides and sides[0][2] is not None:
            before = 100 * np.mean([nearer(left, *side) for side in sides])
            print(f"; beside {psnr(left, [side[:3] for side in sides]):.3f} dB, {before:.2f} % of the light before the surface", end="")
        elif sides:
            gone = 100 * np.mean([share(model, camera, t, taken) for camera, t, _, _ in sides])
            print(f"; {gone:.1f} % of the light beside is taken", end="")
        print(flush=True)
        sheet.append(np.hstack([np.clip(fg.render(left, camera, t)["rgb"], 0, 1) for camera, t, _, _ in sides[:6]]) if sides else None)
    if options.sheet and sides:
        write_png(options.sheet, (np.vstack(sheet) * 255 + 0.5).astype(np.uint8))


def held_out(model, options) -> list[tuple]:
    """(camera, t, picture [h, w, 3]) of views and frames on which the model was not trained, at times at which it was."""
    capture = fg.open_capture(options.capture, scale=options.scale)
    trained = set(recorded(model).views)
    wanted = set(options.views.split(",")) if options.views else {shot.view for shot in capture.shots} - trained
    shots = [shot for shot in capture.shots if shot.view in wanted and shot.view not in trained and shot.frame % options.step == 0]
    store = FrameStore(capture, 0)
    store.fill(shots=shots)
    return [(shot.camera, shot.frame / options.step / model.clip.frame_count, store.pixels(shot).rgb) for shot in shots]


def beside(folder: Path) -> list[tuple]:
    """(camera, t, picture, depths [h, w]) of what make_capture.py --beside --depth wrote."""
    from PIL import Image

    known, found = json.loads((folder / "cameras.json").read_text("utf-8")), []
    for each in known["cameras"]:
        camera = fg.Camera(*(each[key] for key in ("width", "height", "fx", "fy", "cx", "cy")), np.array(each["world_to_camera"]))
        for file in sorted((folder / each["name"]).glob("*.png")):
            depth = np.load(folder / "depth" / each["name"] / f"{file.stem}.npy")
            found.append((camera, (int(file.stem) - 1) / known["frame_count"], np.asarray(Image.open(file).convert("RGB")) / 255, depth))
    return found


def psnr(model, views) -> float:
    return float(np.mean([fg.psnr(np.clip(fg.render(model, camera, t)["rgb"], 0, 1), truth) for camera, t, truth in views]))


def weights(model, camera, t, columns) -> np.ndarray:
    """The sums [N, 3] of each Gaussian's blending weights over a picture, times columns [h, w, 3]."""
    backend = load_backend("cpu")
    plain = replace(model, features=np.zeros((len(model), 3), np.float32), appearance=RGB())
    picture = backend.forward({name: backend.array(array) for name, array in plain.arrays.items()}, plain, camera, float(t))
    return backend.numpy(backend.backward(picture, backend.array(columns))["features"])


def nearer(model, camera, t, truth, depth) -> float:
    """The share of the pixels that is light of Gaussians before NEARER of the true depth, on the mean of their pixels."""
    columns = np.stack([np.ones_like(depth), 1 / np.maximum(depth, 1e-9), np.zeros_like(depth)], -1).astype(np.float32)
    light, inverse, _ = weights(model, camera, t, columns).T
    own = positions_at(model, t) @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    return float(light[own * inverse < NEARER * light].sum() / depth.size)


def share(model, camera, t, taken) -> float:
    """The share of the light of a picture that comes from some Gaussians [N]."""
    light = weights(model, camera, t, np.ones((camera.height, camera.width, 3), np.float32))[:, 0]
    return float(light[taken].sum() / max(light.sum(), 1e-9))


if __name__ == "__main__":
    main()
