# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes on scenes of a few Gaussians whose values are known, on both backends, and Cryptomatte's numbers."""
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_camera
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.rendering import cryptomatte, passes
from fastgs_blender.rendering.instances import Instance, Moment
from fastgs_blender.rendering.passes import PASSES, PassSettings
from fastgs_blender.rendering.quantities import Mist

BACKENDS = ("cpu", "reference")
CAMERA = fg.Camera(32, 24, 40, 40, 16, 12, np.eye(4))


def sheet(z, opacity=30.0, **fields):
    """One Gaussian as wide as the picture, flat along z: opaque but for the rasteriser's limit."""
    model = dict(position=[[0, 0, z]], rotation=[[1, 0, 0, 0]], scale=np.log([[50, 50, 0.01]]), opacity=[opacity],
                 features=[[0.2, 0.4, 0.6]], raster=fg.Raster(alpha_max=0.9999))
    return fg.GaussianModel(**(model | fields))


def of(model, name="", index=0, placement=None, t=0.0, place=None):
    return Instance(model, np.eye(4) if placement is None else placement, t, name=name, index=index, place=place)


def moved(x=0.0, y=0.0, z=0.0):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


@pytest.mark.parametrize("backend", BACKENDS)
def test_three_depths_and_the_count(backend):
    """Alphas 0.4, 0.9 and 0.95 behind one another: nearest, half of the light, and the mean."""
    odds = [np.log(a / (1 - a)) for a in (0.4, 0.9, 0.95)]
    scene = [of(sheet(z, opacity)) for z, opacity in zip((2, 3, 5), odds, strict=True)]
    out = fg.render(scene, CAMERA, passes=("alpha", "depth", "median_depth", "first_depth", "count"), backend=backend)
    weight = np.array([0.4, 0.54, 0.06 * 0.95])
    middle = 12, 16  # the sheets' centres: alpha is their opacity there
    assert out["first_depth"][middle] == 2 and out["median_depth"][middle] == 3 and out["count"][middle] == 3
    assert out["depth"][middle] == pytest.approx((weight @ [2, 3, 5]) / weight.sum(), rel=1e-4)
    empty = fg.render([], CAMERA, passes=tuple(PASSES), backend=backend)
    assert np.isinf(empty["first_depth"]).all() and (empty["mist"] == 1).all()
    assert not any(empty[name].any() for name in ("position", "normal", "vector", "object_index", "cryptomatte_00", "count"))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("falloff", "power"), [('QUADRATIC', 2), ('LINEAR', 1), ('INVERSE_QUADRATIC', 0.5)])
def test_mist_is_that_of_each_splat(backend, falloff, power):
    """By distance from the camera, not by depth; a translucent splat mixes its mist with the fog behind it."""
    model = sheet(8.0, opacity=0.0, scale=np.log([[0.3, 0.3, 0.3]]), position=[[1.5, 0, 8.0]])
    settings = PassSettings(Mist(4, 10, falloff))
    out = fg.render(model, CAMERA, passes=("alpha", "mist"), backend=backend, settings=settings)
    mist = ((np.hypot(1.5, 8) - 4) / 10) ** power
    np.testing.assert_allclose(out["mist"], out["alpha"] * mist + 1 - out["alpha"], atol=1e-5)
    assert out["alpha"].max() > 0.4


@pytest.mark.parametrize("backend", BACKENDS)
def test_position_and_normal_are_in_the_world(backend):
    """A tilted disc in a turned, unevenly scaled object before a camera that is turned as well."""
    rng = np.random.default_rng(3)
    camera = replace(CAMERA, world_to_camera=np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(moved(1, 2, 3)))
    placement = moved(1.1, 2.1, -2.0)
    placement[:3, :3] = np.diag([1.0, 3.0, 1.0]) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    quaternion = rng.normal(size=4)
    model = sheet(0.0, rotation=[quaternion], scale=np.log([[0.3, 1e-4, 0.4]]))
    out = fg.render([of(model, placement=placement)], camera, passes=("alpha", "position", "normal"), backend=backend)
    solid = out["alpha"] > 0.5
    assert solid.any() and not solid.all()
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    first = placement[:3, :3] @ [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    third = placement[:3, :3] @ [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    normal = np.cross(first, third)
    normal /= np.linalg.norm(normal)
    normal *= -np.sign(normal @ (placement[:3, 3] - [1, 2, 3]))
    assert np.abs((out["position"][solid] - placement[:3, 3]) @ normal).max() < 0.02, "in the disc's plane, which is 1.3 wide"
    seen = out["position"][solid] @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    np.testing.assert_allclose(camera.pixels(seen), np.argwhere(solid)[:, ::-1] + 0.5, atol=1e-3)
    np.testing.assert_allclose(out["normal"][solid], np.broadcast_to(normal, (solid.sum(), 3)), atol=1e-5)
    assert not out["normal"][out["alpha"] == 0].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_vectors_have_blenders_sign(backend):
    """The model moves right and the object down between frames, the camera not: previous minus here, here minus next, y up."""
    model = sheet(4.0, basis=fg.Polynomial(1), motion=np.array([[[0.4, 0, 0]]]), clip=fg.Clip(4), scale=np.log([[1, 1, 1e-3]]))
    here = of(model, t=0.25, place="it")
    settings = PassSettings(before=Moment({"it": of(model, placement=moved(y=-0.2), t=0.0)}, CAMERA),
                            after=Moment({"it": of(model, placement=moved(y=0.5), t=0.5)}, CAMERA))
    shift, drop = 40 * 0.1 / 4, np.array([40 * 0.2 / 4, 40 * 0.5 / 4])  # pixels
    out = fg.render([here], CAMERA, passes=("alpha", "vector"), backend=backend, settings=settings)
    np.testing.assert_allclose(out["vector"][12, 16], [-shift, drop[0], -shift, drop[1]], atol=1e-4)
    alone = fg.render([here], CAMERA, passes=("vector",), backend=backend)["vector"]
    np.testing.assert_allclose(alone[12, 16], [-shift, 0, -shift, 0], atol=1e-4)
    turned = replace(CAMERA, cx=20)  # the camera's picture moves, the object is not there in the frame after: it stands still
    out = fg.render([here], CAMERA, passes=("vector",), backend=backend, settings=PassSettings(after=Moment({}, turned)))
    np.testing.assert_allclose(out["vector"][12, 16], [-shift, 0, -4, 0], atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("axis", range(3))
def test_a_turning_gaussian_moves_differently_at_each_of_its_pixels(backend, axis):
    """One disc that turns about each axis of the camera: every pixel's vector is that of the point of the disc that the pixel shows."""
    camera, angle, tilt = fg.Camera(64, 48, 60, 60, 32, 24, np.eye(4)), 0.05, np.array([0.94, 0.24, 0.24, 0.0])
    model = sheet(0.0, rotation=[tilt], scale=np.log([[0.25, 0.2, 1e-4]]))

    def turned(frames):
        a, (i, j) = frames * angle, [each for each in range(3) if each != axis]
        matrix = moved(0.3, -0.2, 4.0)
        matrix[[i, i, j, j], [i, j, i, j]] = np.cos(a), -np.sin(a), np.sin(a), np.cos(a)
        return matrix

    here, before, after = (of(model, placement=turned(frames), place="it") for frames in (0, -1, 1))
    settings = PassSettings(before=Moment({"it": before}, camera), after=Moment({"it": after}, camera))
    out = fg.render([here], camera, passes=("alpha", "vector", "position"), backend=backend, settings=settings)
    solid = out["alpha"] > 0.3
    assert solid.sum() > 40
    shown = np.c_[out["position"][solid], np.ones(solid.sum())]
    now, previous, following = (camera.pixels((shown @ np.linalg.inv(turned(0)).T @ turned(frames).T)[:, :3]) for frames in (0, -1, 1))
    wanted = np.concatenate([previous - now, now - following], 1) * [1, -1, 1, -1]
    assert np.ptp(wanted, axis=0).max() > 0.2, "it does not move as a whole"
    assert np.abs(out["vector"][solid] - wanted).mean() < 0.01


@pytest.mark.parametrize("sorting", ["centre", "pixel"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_vectors_are_those_of_the_middle_half_of_the_light(backend, sorting):
    """A sheet that goes right before an opaque one that goes left: what blocks less than a quarter of the light, or what is left a quarter,
    does not count; alone it does."""
    def going(way, z, alpha):
        motion = np.array([[[way * z, 0, 0]]])
        return of(sheet(z, np.log(alpha / (1 - alpha)), basis=fg.Polynomial(1), motion=motion, clip=fg.Clip(4)), t=0.25)

    def seen(*scene):
        settings = PassSettings(sorting=sorting)
        return fg.render(list(scene), CAMERA, passes=("vector",), backend=backend, settings=settings)["vector"][12, 16, 2]

    far = going(-1, 4.0, 0.9999)
    right, left = seen(going(1, 2.0, 0.9999)), seen(far)
    assert right == pytest.approx(-left) and abs(right) > 5
    for alpha, wanted in ((0.2, left), (0.8, right), (0.5, 0.0)):
        assert seen(going(1, 2.0, alpha), far) == pytest.approx(wanted, abs=0.02), alpha
    assert seen(going(1, 2.0, 0.2)) == pytest.approx(right, rel=1e-4), "what is faint has a vector too"


@pytest.mark.parametrize("backend", BACKENDS)
def test_object_index_and_cryptomatte(backend):
    """Twenty objects, of which more than sixteen at once do not fit into one list: each pixel knows who covers it, and how far."""
    places = [moved(0.3 * (i % 5) - 0.6, 0.25 * (i // 5) - 0.4) for i in range(20)]
    spots = [of(sheet(4.0, opacity=2.0, scale=np.full((1, 3), -3.0)), f"object {i}", 100 + i, at) for i, at in enumerate(places)]
    out = fg.render(spots, CAMERA, passes=("alpha", "object_index", "cryptomatte_00", "cryptomatte_01"), backend=backend)
    for i, spot in enumerate(spots):
        x, y = (CAMERA.pixels(spot.placement[:3, 3] + [0, 0, 4.0])).astype(int)
        assert out["object_index"][y, x] == 100 + i
        assert out["cryptomatte_00"][y, x, 0] == cryptomatte.number(f"object {i}")
    cover = sum(out[f"cryptomatte_{i:02d}"][..., [1, 3]].sum(-1) for i in range(2))
    np.testing.assert_allclose(cover, out["alpha"], atol=1e-5)
    assert ((out["object_index"] > 0) == (out["alpha"] > 0.5)).mean() > 0.97, "what is mostly nothing is 0"
    behind = [of(sheet(3.0, opacity=0.0), "near", 1), of(sheet(5.0, 3.0), "far", 2), of(sheet(6.0, 3.0), "far", 2)]
    out = fg.render(behind, CAMERA, passes=("object_index", "cryptomatte_00"), backend=backend)
    expected = [cryptomatte.number("near"), 0.5, cryptomatte.number("far"), 0.5]
    assert sorted(out["cryptomatte_00"][12, 16].tolist()) == pytest.approx(sorted(expected), abs=2e-3)


def test_cryptomatte_numbers():
    """MurmurHash3 as the specification's sample names have it, and its table of what the numbers mean."""
    texts = b"", b"a", b"hello", b"hello, world", b"The quick brown fox jumps over the lazy dog"
    assert [cryptomatte.murmur3(text) for text in texts] == [0, 0x3c2569b2, 0x248bfa47, 0x149bbb7f, 0x2e4ff723]
    assert all(np.isfinite(cryptomatte.number(f"{i}")) for i in range(5000))
    table = cryptomatte.metadata(["Größe", "b"])
    key = f"cryptomatte/{cryptomatte.murmur3(b'CryptoObject'):08x}"[:19]
    assert table[f"{key}/name"] == "CryptoObject" and table[f"{key}/conversion"] == "uint32_to_float32"
    manifest = json.loads(table[f"{key}/manifest"])
    assert np.uint32(int(manifest["Größe"], 16)).view(np.float32) == cryptomatte.number("Größe")


def test_backends_agree_on_all_passes(rng):
    names = [name for name in PASSES if name not in ("median_depth", "first_depth", "count")]  # flip where alpha is at the cut
    camera = replace(CAMERA, world_to_camera=moved(z=3.0))
    scene = [of(random_model(rng, 40, "paper", "line", "radial", "sh1", size=0.2), f"{i}", i, t=0.3) for i in range(2)]
    fast, exact = (fg.render(scene, camera, passes=tuple(names), backend=backend) for backend in BACKENDS)
    solid = exact["alpha"] > 0.05
    assert solid.mean() > 0.3
    for name in names:
        if name != "normal":  # a sum of opposite normals has no direction
            assert np.isclose(fast[name][solid], exact[name][solid], rtol=1e-3, atol=1e-3).mean() > 0.99, name


def test_a_pass_changes_no_other(rng):
    model, camera = random_model(rng, 60, "paper", "line", "radial", "sh1", size=0.2), random_camera(rng)
    plain, all_of_them = fg.render(model, camera, 0.3), fg.render(model, camera, 0.3, tuple(PASSES))
    assert all(plain[name].tobytes() == all_of_them[name].tobytes() for name in plain)


def test_bands_of_rows_change_no_byte(rng, monkeypatch):
    scene = [of(random_model(rng, 200, "paper", "line", "radial", "sh1"), f"object {k}", k, moved(z=0.2 * k)) for k in range(3)]
    camera = replace(random_camera(rng), window=(3, 2, 17, 13))
    holdout = np.array([[[-9, -9, 3], [9, -9, 3], [0, 9, 3]]], np.float32)
    whole = fg.render(scene, camera, 0.3, tuple(PASSES), holdout=holdout)
    monkeypatch.setattr(passes, "PIXELS", 60)
    banded = fg.render(scene, camera, 0.3, tuple(PASSES), holdout=holdout)
    assert all(np.array_equal(banded[name], whole[name], equal_nan=True) for name in PASSES) and whole["alpha"].any()
