# SPDX-License-Identifier: GPL-3.0-or-later
"""The textures that hold all models of viewports: uploads after a change, places of models, and what is freed."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from gpu_context import draw_offscreen, open_gpu


@pytest.fixture
def parts(module, scene):
    """The modules of the viewport that these tests use, with a GPU."""
    open_gpu(scene)
    return SimpleNamespace(**{name: module(f"engine.viewport.{name}") for name in (
        "atlas", "eye", "textures", "view", "worker")},
        model_texels=module("fastgs_blender.kernels.gl.model_texels"))


def texels(parts, model) -> np.ndarray:
    """What a model's geometry is in the texture [texels, 4]."""
    out = np.empty((len(model), parts.model_texels.layout_of(model).geometry, 4), np.float32)
    parts.model_texels.write_geometry(model, out)
    return out.reshape(-1, 4)


def held(parts, atlas, model) -> np.ndarray:
    """What the texture holds of it."""
    flat = parts.textures.flat(atlas.geometry.read()).reshape(-1, 4)
    begin = atlas.place(model).geometry
    return flat[begin:begin + len(texels(parts, model))]


def test_of_a_sequence_only_its_own_frame_is_sent(parts, make_model, monkeypatch):
    atlas = parts.atlas.Atlas()
    still, *frames = make_model(60_000), *(make_model(3000 - 10 * seed, seed=seed) for seed in range(1, 5))
    atlas.upload([still, frames[0]])
    texture, version, frame_bytes = atlas.geometry, atlas.version, 16 * (parts.textures.WIDTH * 2 + parts.textures.WIDTH)
    for shown in frames[1:]:
        monkeypatch.setattr(parts.textures.Sent, "bytes", 0)
        atlas.pack([still, shown])
        atlas.upload([still, shown])
        assert 0 < parts.textures.Sent.bytes <= frame_bytes
        assert atlas.geometry is texture and atlas.version > version
        for model in (still, shown):
            np.testing.assert_array_equal(held(parts, atlas, model), texels(parts, model))
        version = atlas.version
    assert atlas.has([still, frames[-1]]) and not atlas.has([frames[0]])


def test_room_is_made_once_for_frames_that_grow_and_given_back(parts, make_model):
    atlas, made = parts.atlas.Atlas(), []
    for count in range(4000, 20_000, 1000):
        model = make_model(count, seed=count)
        atlas.upload([model])
        if not made or made[-1] is not atlas.geometry:
            made.append(atlas.geometry)
        np.testing.assert_array_equal(held(parts, atlas, model), texels(parts, model))
    assert len(made) < 9
    large = atlas.nbytes
    atlas.upload([make_model(10)])
    assert atlas.nbytes < large / 4


def test_two_views_that_are_on_different_frames(parts, make_model):
    atlas = parts.atlas.Atlas()
    one, two, three = (make_model(5000, seed=seed) for seed in range(3))
    atlas.upload([one])
    atlas.upload([two], keep=[one])
    atlas.upload([three], keep=[two])
    assert atlas.has([two, three]) and not atlas.has([one])
    for model in (two, three):
        np.testing.assert_array_equal(held(parts, atlas, model), texels(parts, model))


def test_frames_beside_a_still_object_look_as_they_do_alone(fg, module, parts, make_model, tmp_path):
    """Each frame of a sequence, drawn with what is on the GPU from before, is the picture of a viewport that begins with it."""
    folder = tmp_path / "take"
    folder.mkdir()
    for i in range(3):
        fg.save(make_model(40 + 500 * i, seed=i, appearance=fg.RGB()), folder / f"take_{i:03}.ply")
    fg.save(make_model(300, seed=9), tmp_path / "still.safetensors")
    snapshots, retime = module("scene.snapshot"), module("scene.time").Retime(start_frame=0.0)
    window = np.array([[1.2, 0, 0, 0], [0, 1.8, 0, 0], [0, 0, -1.002, -0.2], [0, 0, -1, 0]])
    camera, _ = parts.eye.eye(96, 64, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -4], [0, 0, 0, 1]]), window)
    worker = parts.worker.Worker()

    def picture(view, frame):
        items = [snapshots.FileInstance(str(path), str(path), np.eye(4), retime) for path in (tmp_path / "still.safetensors", folder)]
        shown, display = snapshots.Snapshot(items, frame, 30.0), parts.view.Display(np.eye(3))
        return draw_offscreen(96, 64, lambda framebuffer: view.draw(shown, camera, display, wait=True))

    view = parts.view.View(parts.atlas.Atlas(), worker)
    try:
        for frame in (0.0, 1.0, 2.0, 0.0):
            fresh = parts.view.View(parts.atlas.Atlas(), worker)
            np.testing.assert_array_equal(picture(view, frame), picture(fresh, frame))
            fresh.free()
    finally:
        view.free()
        worker.stop()
