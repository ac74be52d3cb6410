# SPDX-License-Identifier: GPL-3.0-or-later
"""`.4dgs` as we write it: read by us and by its own package."""
from __future__ import annotations

import fourdgs as package
import numpy as np
import pytest
from random_models import random_model

import fastgs_blender as fg

pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")


def model_of(degree: int, temporal="radial", **more) -> fg.GaussianModel:
    model = random_model(np.random.default_rng(4), 60, "line", "static", temporal, f"sh{degree}", extent=3.0,
                         clip=fg.Clip(60, 30.0), **more)
    model.features[:, :3] = np.clip(model.features[:, :3], -1.7, 1.7)
    return model


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("temporal", ["radial", "always"])
def test_what_is_written_is_read(tmp_path, degree, temporal):
    model = model_of(degree, temporal, axes="RUB")
    fg.save(model, tmp_path / "m.4dgs")
    again = fg.load(tmp_path / "m.4dgs")
    assert again.clip == fg.Clip(60, 30.0) and len(again) == 60
    for t in (0.0, 0.35, 0.99):
        a, b = fg.slice_model(model, t, cull=False), fg.slice_model(again, t, cull=False)
        np.testing.assert_allclose(b.opacity, a.opacity, atol=4e-3)
        seen = a.opacity > 0.01
        np.testing.assert_allclose(b.position[seen], (a.position * [1, -1, -1])[seen], atol=1e-3)
        np.testing.assert_allclose(b.scale, a.scale, rtol=3e-3)
    width = min(again.features.shape[1], 3)
    colour = again.features[:, :3] if degree else (again.features - 0.5) / 0.28209479177387814
    np.testing.assert_allclose(colour[:, :width], model.features[:, :3], atol=2e-3)
    if degree:
        assert again.appearance == fg.SH(degree)


def test_its_own_package_sees_the_same(tmp_path):
    model = model_of(2)
    fg.save(model, tmp_path / "m.4dgs")
    theirs, ours = package.read(tmp_path / "m.4dgs"), fg.load(tmp_path / "m.4dgs")
    for time in (0.0, 0.5, 1.9):
        now = theirs.state_at(time)
        seen, opacity = np.asarray(now["indices"], int), np.zeros(60)
        opacity[seen] = now["opacity"]
        for known, tolerance in ((ours, 1e-4), (model, 4e-3)):
            s = fg.slice_model(known, time / 2.0, cull=False)
            np.testing.assert_allclose(s.opacity, opacity, atol=tolerance)
            np.testing.assert_allclose(s.position[seen], now["centers"], atol=5e-3 if known is model else 1e-4)


def test_losses_are_said(tmp_path):
    model = random_model(np.random.default_rng(5), 20, "paper", "line", "window", "sh4", clip=fg.Clip(25, 25.0))
    with pytest.warns(fg.LossWarning, match=r"becomes straight.*rotations.*degree 4 are cut.*steps.*frame rate"):
        fg.save(model, tmp_path / "m.4dgs")
    model.position[0] = np.nan
    with pytest.raises(fg.FastGSError, match="not finite"):
        fg.save(model, tmp_path / "m.4dgs")
