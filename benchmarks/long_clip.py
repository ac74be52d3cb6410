# SPDX-License-Identifier: GPL-3.0-or-later
"""Long clips in chapters, each of 600 and of 6000 frames: python benchmarks/long_clip.py [--frames 600 6000] [--json FILE]

* mostly still   a still room of 60 000 Gaussians, and 1500 more for each 60 frames, which come, move and go
* looped         the example, again and again
* long bake      4000 Gaussians that stand still and 400 that follow a table of a keyframe for each frame

bytes    of the file
open     seconds until the first frame is there
memory   of a process that shows every frame once, in MB at most, and how much more than with the shorter clip
seam     the largest change of a picture from frame to frame where chapters change, by the largest elsewhere in those chapters
         (where a loop begins anew, the picture jumps as the example does)
"""
from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import fastgs_blender as fg  # noqa: E402
from fastgs_blender.cameras.viewpoints import camera_of  # noqa: E402
from fastgs_blender.formats.sensitivity import resized  # noqa: E402

SIZE = 160, 120
PART = 60


def cloud(seed: int, n: int, frames: int) -> fg.GaussianModel:
    rng = np.random.default_rng(seed)
    return fg.GaussianModel(
        position=rng.uniform(-2, 2, (n, 3)) + [0, 0, 6], rotation=rng.normal(size=(n, 4)), scale=rng.normal(-3.5, 0.4, (n, 3)),
        opacity=rng.normal(0, 2, n), features=rng.normal(0, 0.5, (n, 12)), appearance=fg.SH(1), clip=fg.Clip(frames, 24.0))


def still_room(frames: int) -> fg.Chapters:
    moving = cloud(1, 1500 * frames // PART, frames)
    rng, n = np.random.default_rng(2), len(moving)
    begin = rng.uniform(0, 1, n)
    temporal = np.stack([begin, begin + rng.uniform(10, 60, n) / frames, *np.full((2, n), np.log(8 / frames))], -1)
    moving = replace(moving, motion=rng.normal(0, 0.02 * frames, (n, 1, 3)), basis=fg.Polynomial(1), mu_tau=begin, temporal=temporal,
                     temporal_kind=fg.Window())
    return fg.chapters(fg.concatenate([cloud(0, 60_000, frames), moving]), frames=PART)


def looped(frames: int) -> fg.Chapters:
    example = fg.load(ROOT / "examples" / "fireside.safetensors")
    return fg.chapters(*[example] * -(-frames // example.clip.frame_count))


def long_bake(frames: int) -> fg.Chapters:
    rng = np.random.default_rng(1)
    still, moving = cloud(1, 4000, frames), cloud(2, 400, frames)
    table = fg.Keyframes(tuple(np.linspace(0, 1, frames)))
    walk = np.cumsum(rng.normal(0, 0.01, (400, frames, 3)).astype(np.float32), 1)
    moving = replace(moving, basis=table, motion=walk - walk.mean(1, keepdims=True))
    return fg.chapters(fg.concatenate([still, moving]), frames=PART)


CLIPS = {"mostly still": still_room, "looped": looped, "long bake": long_bake}


def shown(path: str) -> dict:
    """What a process measures that shows every frame of a clip once."""
    example = "looped" in path
    width, height = SIZE
    camera = fg.Camera(width, height, 150, 150, width / 2, height / 2, np.eye(4))
    began = time.perf_counter()
    source = fg.open_source(path)
    if example:
        camera = resized(camera_of(source.surroundings.cameras[0]), width)
    source.moment(0.0)
    opened = time.perf_counter() - began
    count, before = source.clip.frame_count, None
    begins, steps = {chapter.begin for chapter in source.chapters}, {True: [0.0], False: [0.0]}
    looked = {frame + near for frame in sorted(begins)[1:5] for near in range(-8, 8)}
    for frame in range(count):
        if frame in looked or frame % 20 == 0:
            picture = fg.render(source, camera, frame / count)["rgb"]
            if frame in looked and frame - 1 in looked and before is not None:
                steps[frame in begins].append(float(np.sqrt(np.square(picture - before).mean())))
            before = picture
        else:
            source.moment(frame / count)
    status = Path("/proc/self/status").read_text()  # resource's number would be that of the process that began this one
    memory = next(int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmHWM"))
    return {"open": opened, "memory": memory, "seam": max(steps[True]) / max(steps[False]), "chapters": len(begins),
            "seconds": time.perf_counter() - began}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, nargs="+", default=[600, 6000])
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--shown", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.shown:
        print(json.dumps(shown(args.shown)))
        return
    found: dict[str, list[dict]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, make in CLIPS.items():
            for frames in args.frames:
                path = Path(folder) / f"{name}.safetensors"
                fg.save(make(frames), path)
                child = subprocess.run([sys.executable, __file__, "--shown", str(path)], stdout=subprocess.PIPE, text=True, check=True)
                facts = {"frames": frames, "bytes": path.stat().st_size, **json.loads(child.stdout)}
                first = found.setdefault(name, [facts])[0]
                if first is not facts:
                    found[name].append(facts)
                print(f"{name:13} {frames:5} frames in {facts['chapters']:3} chapters: {facts['bytes'] / 1e6:6.1f} MB "
                      f"({facts['bytes'] / first['bytes']:.2f}), open {facts['open']:.2f} s, memory {facts['memory'] / 1e6:4.0f} MB "
                      f"({facts['memory'] / first['memory']:.3f}), seam {facts['seam']:.2f}, {facts['seconds']:.0f} s", flush=True)
    if args.json:
        Path(args.json).write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
