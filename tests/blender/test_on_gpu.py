# SPDX-License-Identifier: GPL-3.0-or-later
"""The GPU backend in real Blenders, on Mesa's GPU in software: from the zip alone, without torch and without a network."""
from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import library_camera, psnr, read_png

import fastgs_blender as fg

pytestmark = pytest.mark.newest
GPU, STEPS = "llvmpipe", 75


@pytest.fixture(scope="module")
def story(user):
    return user.story("on_gpu.from_scene_to_shot", gpu=GPU, steps=STEPS)


def test_capture_train_and_f12_work_from_the_zip_alone(story):
    assert not story["torch"], "these Blenders have none, so none was used"
    assert story["filmed"] == story["trained"] == ['FINISHED'] and story["kind"] == 'FINISHED', story["text"]
    assert story["python"][0] == story["python"][1], "Blender's own Python trains"
    assert story["steps"] == STEPS


def test_the_gpu_trained_and_drew(story, user):
    trained_on = json.loads((user.folder / "gpu-run" / "report.json").read_text())["device"]
    assert trained_on.startswith(GPU) and "processor" not in trained_on
    assert [GPU in name for name in story["used"]] == [True] and story["failed"] == [""], "F12 has opened it, and it has not failed"


def test_f12_shows_what_was_filmed(story, user):
    """F12 of the model is what the library's CPU draws of the file, and like F12 of the scene."""
    found, truth = (read_png(user.folder / f"gpu-{name}.png") for name in ("model", "truth"))
    model = fg.load(user.folder / "gpu-run" / "model.safetensors")
    out = fg.render([(model, np.array(story["matrix"]), model.clip.t_of_frame(1))], library_camera(story["camera"]))
    wanted = np.concatenate([out["rgb"], out["alpha"][..., None]], -1)
    solid = wanted[..., 3] > 0.5
    print(f"GPU in Blender against the library on the CPU: {psnr(found, wanted):.1f} dB; against the scene where splats are: "
          f"{psnr(found[solid][:, :3], truth[solid][:, :3]):.1f} dB")
    assert solid.mean() > 0.1 and psnr(found, wanted) > 45
    assert psnr(found[solid][:, :3], truth[solid][:, :3]) > 18
