# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs in segments: stopped anywhere they give the same file, they hold little, and several processes train them together."""
import json
import os
import subprocess
import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from toy_captures import toy_capture, write_capture

import fastgs_blender as fg
from fastgs_blender.training.core import settings
from fastgs_blender.training.core.spans import spans
from fastgs_blender.training.run import plan, segments, session

ROOT = Path(__file__).resolve().parents[3]
OPTIONS = dict(iterations=40, max_gaussians=120, warm_up=(), segment_frames=8, segment_overlap=3, backdrop=0.0, preview_every=0,
               position_rate=1e-3, motion_rate=2e-3, init_scale=1.0, exposures="off", clocks="off", poses="off")


@pytest.fixture(scope="module")
def capture():
    return toy_capture(frames=14, views=3)


@pytest.fixture(autouse=True)
def known_points(capture, monkeypatch):
    monkeypatch.setattr("fastgs_blender.training.initial.starting_points.initial_points", lambda *rest: (capture[2], rest[1]))


def run(capture, out, resume=False):
    chosen = plan.begin(out, {} if resume else OPTIONS, lambda wanted: settings.settings(**wanted), resume, False)
    return session.run(capture[0], capture[1], chosen, out, quiet=True)


@pytest.fixture(scope="module")
def finished(capture, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fastgs_blender.training.initial.starting_points.initial_points", lambda *rest: (capture[2], rest[1]))
        run(capture, out)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("place", ["segments/000/done.json", "segments/000/segment.safetensors", "segments/001/checkpoint.safetensors",
                                   "segments/001/segment.safetensors", "segments/002/segment.safetensors", "model.safetensors"])
def test_stopped_where_a_file_is_finished_it_gives_the_same_clip(capture, finished, tmp_path, monkeypatch, place, after):
    """At the end of a segment, at the beginning of the next, and while the segments are joined."""
    replaced, target = os.replace, tmp_path / place

    def stopped(source, path):
        if Path(path) == target and not after:
            raise KeyboardInterrupt
        replaced(source, path)
        if Path(path) == target:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", stopped)
        with pytest.raises(KeyboardInterrupt):
            run(capture, tmp_path)
    assert target.exists() == after
    report = run(capture, tmp_path, resume=True)
    assert (tmp_path / "model.safetensors").read_bytes() == (finished / "model.safetensors").read_bytes()
    assert report["held_out_psnr"] == json.loads((finished / "report.json").read_text())["held_out_psnr"]
    assert not list(tmp_path.glob("**/checkpoint.safetensors")) and not list(tmp_path.glob("**/.fastgs-*"))


def test_joining_reads_one_segment_after_another(rng, make_model, tmp_path):
    """However many segments there are, the models of two are in memory, and each is read a few times."""
    from weakref import WeakSet

    models, held, most, reads = WeakSet(), count(), [0], []
    cuts = spans(200, 8, 2)
    first = make_model(rng, 40, "cosine", "line", "radial", "sigmoid")

    def load(i):
        model = fg.GaussianModel(**{**vars(first), "position": first.position + next(held)})
        models.add(model)
        most[0] = max(most[0], len(models))
        reads.append(i)
        return model

    clip = segments.joined_clip(load, cuts, fg.Clip(200), {})
    fg.save(clip, tmp_path / "clip.safetensors")
    assert len(cuts) > 30 and most[0] <= 3 and max(np.bincount(reads)) <= 4
    assert len(fg.load(tmp_path / "clip.safetensors")) == 40 * len(cuts)


@pytest.mark.slow
def test_two_processes_train_segments_as_one_does(tmp_path):
    files = write_capture(tmp_path / "toy", 14, 4)
    chosen = {name: value for name, value in OPTIONS.items() if name not in ("warm_up", "iterations")} | {"iterations": 60}
    options = ["--init", "file", *(word for name, value in chosen.items() for word in ("--set", f"{name}={value}"))]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    for out, command, batch in (("one", [sys.executable], 2), ("two", torchrun, 1)):
        words = [*command, "-m", "fastgs_blender", "train", str(files), "--out", str(tmp_path / out), *options, "--batch", str(batch)]
        ended = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr
    a, b = (fg.load(tmp_path / out / "model.safetensors") for out in ("one", "two"))
    assert len(list(tmp_path.glob("two/segments/*/segment.safetensors"))) == 3 and len(a) == len(b)
    for name, array in a.arrays.items():
        np.testing.assert_allclose(b.arrays[name], array, atol=1e-3, err_msg=name)
