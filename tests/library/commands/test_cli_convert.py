# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs convert --antialias."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

import fastgs_blender as fg


def test_convert_for_viewers_that_antialias(run, rng, make_model, tmp_path):
    """One camera sees all Gaussians from 1000 away with a focal length of 500: a pixel is 2 wide; each variance grows by 0.3 * 2^2."""
    model = make_model(rng, 30, basis=fg.Fourier(3), temporal="radial", appearance="sh1", clip=fg.Clip(50, 25.0, 7))
    path, plain, soft = (tmp_path / name for name in ("model.safetensors", "plain.ply", "soft.ply"))
    fg.save(model, path)
    assert run("convert", path, soft, "--at", "12", "--antialias")[0] == 2 and "annotate" in run(
        "convert", path, soft, "--at", "12", "--antialias")[2]
    camera = fg.Viewpoint(width=640, height=480, fx=500, fy=500, cx=320, cy=240, position=(0, 0, -1000))
    fg.save(replace(model, surroundings=fg.Surroundings(cameras=(camera,))), path)
    for target, options, said in ((tmp_path / "a.ply", (), "--at"), (tmp_path / "a.splat", ("--at", "12"), ".spz")):
        code, _, told = run("convert", path, target, "--antialias", *options)
        assert code == 2 and said in told and not target.exists()
    assert run("convert", path, plain, "--at", "12")[0] == run("convert", path, soft, "--at", "12", "--antialias")[0] == 0
    before, after = fg.load(plain), fg.load(soft)
    assert after.raster.antialiased and not before.raster.antialiased
    np.testing.assert_allclose(np.exp(2.0 * after.scale), np.exp(2.0 * before.scale) + 1.2, rtol=0.03)
