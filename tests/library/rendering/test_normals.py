# SPDX-License-Identifier: GPL-3.0-or-later
"""Smooth normals on a ball whose Gaussians are tilted at random, as those of a noisy capture are."""
import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.kernels.cpu.thinnest import thinnest as compiled
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.normals import smooth_normals, thinnest
from fastgs_blender.rendering.quantities import Shown
from fastgs_blender.util.backends import load_backend
from fastgs_blender.util.rotations import unit

CAMERA = fg.Camera(64, 64, 64, 64, 32, 32, np.eye(4))
CENTRE = np.array([0.0, 0, 4])


def ball(tilt, count=4000, seed=0):
    """Discs on a ball of radius 1 before the camera, tilted by a normal deviation in radians."""
    rng = np.random.default_rng(seed)
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    out = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)
    half = np.c_[1 + z, -out[:, 1], out[:, 0], np.zeros(count)]  # turns z to `out`
    noise = np.c_[np.ones(count), rng.normal(0, tilt / 2, (count, 3))]
    w, x, y, v = half.T
    a, b, c, d = noise.T
    rotation = np.stack([w * a - x * b - y * c - v * d, w * b + x * a + y * d - v * c, w * c - x * d + y * a + v * b,
                         w * d + x * c - y * b + v * a], 1)
    return fg.GaussianModel(position=CENTRE + out, rotation=unit(rotation), opacity=np.full(count, 4.0),
                            scale=np.log(np.tile([0.04, 0.04, 0.01], (count, 1))), features=np.full((count, 3), 0.5))


def errors(model, **fields):
    """Angles in degrees between the normals of the Gaussians before the camera and the ball's own, away from its outline."""
    instance = Instance(model, np.eye(4), 0.0, **fields).viewed(CAMERA)
    true = model.position - CENTRE
    index = np.flatnonzero(true[:, 2] < -0.4)
    found = smooth_normals(Shown(instance, index), load_backend("cpu"))
    return np.degrees(np.arccos(np.clip((found * true[index]).sum(1), -1, 1)))


def test_the_kernel_is_the_equation():
    rng = np.random.default_rng(3)
    places, root = rng.uniform(-1, 1, (120, 3)), rng.normal(0, 0.1, (120, 3, 3))
    axes = root.transpose(1, 2, 0)
    opacity, turn = rng.uniform(0.1, 1, 120), rng.normal(size=(3, 3))
    for reach, towards in ((0.05, [0, 0, 3, 1]), (0.4, [0.2, -0.1, 0, 1]), (3.0, [1, 2, 3, 0]), (1e-9, [0, 0, 3, 1])):
        args = places, axes, opacity, reach, np.array(towards, float), turn
        one, other = compiled(*args), thinnest(*args)
        np.testing.assert_allclose((one * other).sum(1), 1, atol=1e-6)
        rows = rng.permutation(120)[:40]
        assert np.array_equal(compiled(*args, rows), one[rows])
    assert compiled(places[:0], axes[..., :0], opacity[:0], *args[3:]).shape == (0, 3)


@pytest.mark.parametrize(("tilt", "median", "worst"), [(0.0, 0.1, 0.2), (0.35, 10.0, 17.0)])
def test_tilted_gaussians_have_the_normals_of_their_surface(tilt, median, worst):
    """A tilt of 0.35 is 24 degrees in the median."""
    found = errors(ball(tilt))
    assert np.median(found) < median and np.percentile(found, 90) < worst


def test_a_surface_counts_where_it_agrees():
    """That of the ball makes the normals better; one that stands across them changes nothing."""
    u, v = np.meshgrid(np.linspace(0, np.pi, 40), np.linspace(0, 2 * np.pi, 80), indexing="ij")
    grid = CENTRE + np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    shell = np.concatenate([np.stack(each, -2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))])
    model = ball(0.6)
    own, helped = errors(model), errors(model, surface=shell)
    assert np.median(helped) < 0.5 * np.median(own) and np.percentile(helped, 90) < np.percentile(own, 90)
    across = np.array([[[0, y, z], [0, y + 0.1, z], [0, y, z + 0.1]] for y in np.arange(-1, 1, 0.1) for z in np.arange(3, 5, 0.1)])
    middle = fg.render([Instance(model, np.eye(4), 0.0, surface=across)], CAMERA, passes=("normal",))["normal"][32, 32]
    assert np.array_equal(middle, fg.render([Instance(model, np.eye(4), 0.0)], CAMERA, passes=("normal",))["normal"][32, 32])
