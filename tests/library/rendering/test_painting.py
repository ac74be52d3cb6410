# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of Gaussians in a light: the kernel says what NumPy says, of every appearance."""
import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.painting import bare, seen_colours
from fastgs_blender.util.backends import load_backend

KERNELS, NUMPY = (load_backend(name) for name in ("cpu", "reference"))


def gaussians(rng, appearance="rgb", **settings):
    model = random_model(rng, 200, appearance=appearance, temporal="radial", colour_space="linear" if appearance == "clamp" else "srgb")
    seen = Instance(model, np.eye(4), 0.3, ObjectSettings(captured_light=0.4, shadows=0.8, **settings)).viewed(
        fg.Camera(60, 44, 50, 50, 30, 22, random_pose(rng, 2.5)))
    return seen, np.sort(rng.permutation(200)[:150]), model.position[:150].astype(float)


@pytest.mark.parametrize("lamps", [1, 3])
@pytest.mark.parametrize("appearance", ["rgb", "sigmoid", "clamp", "none", "sh2", fg.Changing(fg.SH(1), fg.Fourier(2))])
def test_kernels_agree_with_numpy(rng, appearance, lamps):
    seen, index, places = gaussians(rng, appearance)
    light = rng.uniform(0, 2, (lamps, 4, 3, 150)).astype(np.float32)
    light[:, 1:] *= rng.uniform(0, 1, (1, 3, 3, 150)) > 0.3
    light[..., :20] = 0
    for unlit in (None, rng.uniform(0.5, 2, (150, 3))):
        for drops in (False, True):
            (got, told), (wanted, tell) = (each.painted(seen, index, places, light, unlit, drops) for each in (KERNELS, NUMPY))
            assert len(got) == len(wanted) == 1 + drops and told.shape == tell.shape == (150 * drops, 5, lamps)
            np.testing.assert_allclose(got, wanted, atol=2e-5, rtol=1e-5)
            np.testing.assert_allclose(told, tell, atol=1e-6, rtol=1e-5)


def test_colours_are_those_seen_times_the_light(rng):
    seen, index, places = gaussians(rng, "clamp", lamp_light=2.0)
    light = np.full((1, 4, 3, 150), 0.5, np.float32)
    (features,), _ = KERNELS.painted(seen, index, places, light, None, False)
    look = bare(seen.model.appearance)
    model = random_model(rng, 150, appearance=look, features=features, colour_space="linear", mu_tau=seen.model.mu_tau[index])
    now = seen_colours(Instance(model, np.eye(4), 0.3).viewed(seen.camera), np.arange(150), places)[1]
    before = seen_colours(seen, index, places)[1]
    np.testing.assert_allclose(now, before * (0.4 + 2 / np.pi * 0.5), atol=1e-5)
