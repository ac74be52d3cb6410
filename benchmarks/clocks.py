# SPDX-License-Identifier: GPL-3.0-or-later
"""How well clocks are found that are known: a genlocked capture, as it is and with some cameras shifted.

    .venv/bin/python benchmarks/clocks.py CAPTURE [--frames A:B] [--seeds 2]

Every fifth camera is shifted by -3 to 3 frames.  Fractions come from keeping each second or third picture.  Prints for each trial how many
cameras are moved rightly (to 0.1 frames), moved wrongly (by more than 0.1 frames, or not although they were shifted), and called unsure.
"""
from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import fastgs_blender as fg
from fastgs_blender.captures.clocks.find import by_epipolar_planes
from fastgs_blender.util.frames import parse_frames

MOST, RIGHT = 3, 0.1


def shifted(capture, offsets: dict[str, int], step: int):
    """The capture with each `step`-th picture; picture n of a view shows the moment n + offsets[view] / step."""
    shots = {(shot.view, shot.frame): shot for shot in capture.shots}
    count = (capture.clip.frame_count - 1 - 2 * MOST * step) // step
    taken = [(view, n, shots.get((view, (n + MOST) * step + offsets.get(view, 0)))) for n in range(count) for view in capture.views]
    return replace(capture, clip=replace(capture.clip, frame_count=count),
                   shots=[replace(shot, frame=n, t=n / count) for _, n, shot in taken if shot is not None])


def main() -> None:
    """Shift, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture")
    parser.add_argument("--frames", default=None)
    parser.add_argument("--seeds", type=int, default=2)
    args = parser.parse_args()
    part = None
    if args.frames:
        numbers = parse_frames(args.frames).numbers
        part = slice(int(numbers[0]), int(numbers[-1]) + 1)
    capture = fg.open_capture(args.capture, offsets={}, frames=part, held_out=())
    for step in (1, 2, 3):
        for seed in range(args.seeds + 1):
            rng = np.random.default_rng(seed)
            chosen = rng.choice(capture.views, max(1, len(capture.views) // 5), replace=False) if seed else []
            offsets = {view: int(rng.integers(-MOST * step, MOST * step + 1)) for view in chosen}
            began = time.process_time()
            found = by_epipolar_planes(shifted(capture, offsets, step))
            seconds = time.process_time() - began
            truth = np.array([offsets.get(view, 0) / step for view in capture.views])
            truth -= np.median(truth)
            sure = np.array([found is not None and view not in found.lost for view in capture.views])
            told = np.array([0.0 if found is None else found.clocks.offsets[view] for view in capture.views])
            right = sure & (np.abs(told - truth) <= RIGHT)
            print(f"every {step}. picture, {len(offsets)} shifted: {right.sum()} right, {(sure & ~right).sum()} wrong, "
                  f"{(~sure).sum()} unsure; largest error {np.abs(told - truth)[sure].max(initial=0):.2f} frames, "
                  f"{seconds:.0f} s of the processor", flush=True)


if __name__ == "__main__":
    main()
