# SPDX-License-Identifier: GPL-3.0-or-later
"""Several objects in one picture: the same as one model of all their Gaussians."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.formats.scenes import as_seen
from fastgs_blender.rendering.filters import Filter, values
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.util import rotations


def placement(rng, stretched):
    matrix = np.eye(4)
    sizes = rng.uniform(0.4, 2.0, 3) if stretched else rng.uniform(0.4, 2.0)
    matrix[:3, :3] = rotations.to_matrices(rotations.unit(rng.normal(size=(1, 4))))[0] * sizes
    matrix[:3, 3] = rng.normal(0, 0.4, 3)
    return matrix


@pytest.mark.parametrize(("appearance", "stretched"), [("rgb", False), ("rgb", True), ("sh2", False)])
def test_overlapping_objects_are_one_merged_model(appearance, stretched):
    """Each turned, scaled and moved, one of them twice, at other times; faint Gaussians never reach the cut, where rounding shows."""
    rng = np.random.default_rng(21)
    raster = fg.Raster(alpha_cut=1e-6)
    models = [random_model(rng, 150, "fourier", "line", "window", appearance, raster=raster) for _ in range(2)]
    instances = [Instance(models[i], placement(rng, stretched), t) for i, t in ((0, 0.2), (1, 0.5), (0, 0.7))]
    merged, _ = as_seen(instances)
    camera = fg.Camera(96, 72, 90, 90, 48, 36, random_pose(rng, 5.0))
    apart, one = fg.render(instances, camera), fg.render(merged, camera)
    assert apart["alpha"].max() > 0.9 and apart["alpha"].mean() > 0.1
    for name in ("rgb", "alpha"):
        assert np.abs(apart[name] - one[name]).max() < 1e-4, name


def test_objects_are_parts_of_the_merged_model():
    """By their names, those of one name together; a single one's own parts stay, and no part is made of too many objects."""
    model = random_model(np.random.default_rng(3), 12, appearance="sh0")
    named = lambda *names: as_seen([Instance(model, np.eye(4), 0.0, name=name) for name in names])[0].parts  # noqa: E731
    assert named("Ball", "Room", "Ball").names == ("Ball", "Room")
    np.testing.assert_array_equal(named("Ball", "Room", "Ball")["Ball"], np.repeat([True, False, True], 12))
    assert named("Ball").names == named(*map(str, range(257))).names == ()
    own = replace(model, parts=fg.Parts.of({"Hat": np.arange(12) < 3}))
    assert as_seen([Instance(own, np.eye(4), 0.0, name="Ball")])[0].parts.names == ("Hat",)


def test_objects_in_two_colour_spaces_become_one_in_srgb():
    """Colours that are the same from everywhere are those of the sRGB curve (IEC 61966-2-1), and the export says so."""
    rng = np.random.default_rng(4)
    linear = random_model(rng, 20, appearance="sh0", colour_space="linear")
    linear.features[:] = (rng.random((20, 3)) - 0.5) / 0.28209479177387814
    plain = random_model(rng, 10, appearance="sh0")
    merged, lost = as_seen([Instance(plain, np.eye(4), 0.0), Instance(linear, np.eye(4), 0.0)])
    assert merged.colour_space == "srgb" and any("linear" in clause and "sRGB" in clause for clause in lost)
    np.testing.assert_array_equal(merged.features[:10], plain.features)
    shown = 0.5 + 0.28209479177387814 * linear.features.astype(np.float64)
    wanted = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * merged.features[10:], wanted, atol=1e-5)
    assert not any("linear" in clause for clause in as_seen([Instance(linear, np.eye(4), 0.0)])[1])


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_parts_of_a_model_with_a_decoder_are_decoded_together(backend):
    """Separated by a filter they look as the whole does; at another place, or with another look, a part has a decoding of its own."""
    rng = np.random.default_rng(8)
    model = random_model(rng, 150, "fourier", "line", "window", "sigmoid")
    camera = fg.Camera(64, 48, 60, 60, 32, 24, random_pose(rng, 4.0))
    speeds = values(model, "SPEED")
    limit = float(np.median(speeds))

    def part(keep, placement=None, **look):
        only = ObjectSettings(filters=[Filter("SPEED", limit, keep=keep)], **look)
        return Instance(model, np.eye(4) if placement is None else placement, 0.4, only)

    def picture(*parts):
        return fg.render(list(parts), camera, backend=backend)["rgb"]

    whole = picture(Instance(model, np.eye(4), 0.4))
    assert 0.2 < (speeds >= limit).mean() < 0.8
    assert np.abs(picture(part(True), part(False)) - whole).max() < 1e-6
    graded = picture(part(True, saturation=0.0), part(False, saturation=0.0))
    assert np.abs(graded - graded.mean(-1, keepdims=True)).max() < 1e-5
    half = picture(part(True), part(False, saturation=0.0))
    assert np.abs(half - whole).max() > 0.05 and np.abs(half - graded).max() > 0.05
    away = np.eye(4)
    away[:3, 3] = 100
    assert np.abs(picture(part(True), part(False, away)) - picture(part(True))).max() < 1e-6


def test_an_export_says_that_scene_light_is_not_kept():
    model = random_model(np.random.default_rng(1), 20, "fourier", "line", "window", "sigmoid")
    for look, told in (({}, False), ({"lamp_light": 1.0}, True), ({"shadows": 0.5}, True)):
        _, lost = as_seen([Instance(model, np.eye(4), 0.4, ObjectSettings(**look))])
        assert any("Scene Light" in text for text in lost) == told
