# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene light on analytic scenes: what a lamp sends to a wall, and what stands in its way."""
from dataclasses import replace

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.model.appearance import SH_C0
from fastgs_blender.model.edits import Edit
from fastgs_blender.rendering import spots
from fastgs_blender.rendering.colour import srgb_to_linear
from fastgs_blender.rendering.exposure import Exposure
from fastgs_blender.rendering.instances import Instance, Moment, ObjectSettings
from fastgs_blender.rendering.lamps import Lamp, cone, dome, flat, panorama
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.rendering.relight import SceneLight
from fastgs_blender.rendering.shadow import Light
from fastgs_blender.util.backends import load_backend

LIT = ObjectSettings(captured_light=0.0, lamp_light=1.0, shadows=1.0)
GREY = 0.6
CAMERA = fg.Camera(64, 64, 64, 64, 32, 32, np.eye(4))


def wall(depth=4.0, half=2.2, step=0.05, appearance=None, features=None):
    """Grey discs in a square at a depth, facing the camera."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.arange(-half, half, step)] * 2))
    n = len(x)
    return fg.GaussianModel(
        position=np.stack([x, y, np.full(n, depth)], 1), rotation=np.tile([1.0, 0, 0, 0], (n, 1)), opacity=np.full(n, 6.0),
        scale=np.log(np.tile([0.7 * step, 0.7 * step, 1e-4], (n, 1))),
        features=np.full((n, 3), GREY) if features is None else features(n), appearance=appearance or fg.RGB())


def lit(model, lamps, look=LIT, camera=CAMERA, meshes=None, clear=None, **options):
    """The straight scene-linear picture [h, w, 3] of a model under lamps."""
    light = SceneLight(tuple(lamps), meshes, clear=clear or {})
    instances = [each if isinstance(each, Instance) else Instance(each, np.eye(4), 0.0, look) for each in np.atleast_1d(model)]
    images = fg.render(instances, camera, settings=PassSettings(light=light), **options)
    return srgb_to_linear(images["rgb"] / np.maximum(images["alpha"], 1e-6)[..., None])


def middle(picture):
    return picture[28:36, 28:36].mean((0, 1))


def board(x, y, z, half):
    """Two triangles: a square around a place, facing the camera."""
    a, b, c, d = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half + [x, y, z]
    return np.array([[a, b, c], [a, c, d]], np.float32)


ALBEDO = float(srgb_to_linear(np.array(GREY)))


@pytest.mark.parametrize("angle", [0.0, 0.6, 1.2])
def test_a_sun_lights_by_the_cosine(angle):
    sun = Lamp(Light.sun((np.sin(angle), 0, -np.cos(angle))), (2.0, 1.0, 0.5))
    assert np.allclose(middle(lit(wall(), [sun])), ALBEDO / np.pi * np.cos(angle) * np.array([2, 1, 0.5]), rtol=0.01)


def test_lamps_fall_off_with_the_square_of_the_distance():
    for distance in (1.0, 2.0):
        lamp = Lamp(Light([(0, 0, 4 - distance)]), (3.0, 3.0, 3.0))
        assert np.allclose(lit(wall(), [lamp])[31:33, 31:33], ALBEDO / np.pi * 3 / distance**2, rtol=0.03)


def test_a_lamp_behind_the_wall_does_not_light_it():
    assert lit(wall(), [Lamp(Light([(0, 0, 5.0)]), (9.0, 9.0, 9.0))]).max() < 1e-3


def test_the_world_lights_as_much_as_it_shines():
    """Half of a uniform world of radiance 1 is before a wall: it has its own colour."""
    assert np.allclose(middle(lit(wall(), [dome((1.0, 1.0, 1.0), 64)])), ALBEDO, rtol=0.03)


def haze(count=6000):
    """Faint discs that face the camera, near a wall's depth: none makes much of a pixel."""
    rng, n = np.random.default_rng(3), count
    return fg.GaussianModel(
        position=rng.uniform([-2.2, -2.2, 3.98], [2.2, 2.2, 4.02], (n, 3)), rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, -4.0), scale=np.log(np.tile([0.2, 0.2, 1e-4], (n, 1))), features=np.full((n, 3), GREY), appearance=fg.RGB())


@pytest.mark.parametrize("light", [Light.rectangle([0, 0, 2], [0.8, 0, 0], [0, 0.8, 0], 16), dome((1.0, 1.0, 1.0), 32).light])
def test_what_shows_little_asks_less_and_is_lit_as_much(light, monkeypatch):
    """Without shadows nothing changes, and under a board's the mean stays: single Gaussians know a quarter of the lamp."""
    def pictures():
        for meshes in (None, board(0.3, 0.0, 3.2, 0.4)):
            yield lit(haze(), [Lamp(light, (3.0, 2.0, 1.0))], replace(LIT, casts=False), meshes=meshes)

    (free, dark), _ = list(pictures()), monkeypatch.setattr(spots, "MANY", 10**6)
    every = list(pictures())
    np.testing.assert_allclose(free, every[0], rtol=1e-5)
    assert np.abs(dark - every[1]).max() < 0.05 * dark.max() and abs(dark.mean() / every[1].mean() - 1) < 2e-3
    assert (dark < 0.9 * free).any() and not np.array_equal(dark, every[1])


def test_a_panorama_lights_from_where_it_is_bright():
    """A uniform one lights as a world of one colour.  A small sun in it is one direction, with all of its light."""
    assert np.allclose(middle(lit(wall(), [panorama(np.ones((32, 64, 3)), 64)])), ALBEDO, rtol=0.04)
    assert panorama(np.zeros((32, 64, 3))) is None
    sky, row, column = np.full((64, 128, 3), 0.01), 44, 40
    sky[row, column] = 1e4, 5e3, 1e3
    lamp = panorama(sky, 16)
    brightest = lamp.colour.sum(1).argmax()
    up, turn = np.pi * ((row + 0.5) / 64 - 0.5), 2 * np.pi * ((column + 0.5) / 128 - 0.5)
    assert np.allclose(lamp.light.points[brightest], (np.sin(turn) * np.cos(up), np.cos(turn) * np.cos(up), np.sin(up)), atol=1e-3)
    assert np.allclose(lamp.colour[brightest] / 16, sky[row, column] * np.cos(up) * (np.pi / 64) ** 2, rtol=0.02)
    whole = (sky * np.cos(np.pi * ((np.arange(64) + 0.5) / 64 - 0.5))[:, None, None] * (np.pi / 64) ** 2).sum((0, 1))
    assert len(lamp.colour) == 16 and np.allclose(lamp.colour.mean(0), whole)


def test_beams():
    assert np.allclose(flat()(np.array([1.0, 0.5, -0.5])), [1, 0.5, 0])
    narrow = flat(1.0)(np.cos([0.0, 0.25, 0.6]))
    assert narrow[0] > narrow[1] > 0 == narrow[2]
    spot = cone(1.0, 0.2)
    assert spot(np.cos(np.array([0.0])))[0] == 1 and spot(np.cos(np.array([0.51])))[0] == 0


def test_a_mesh_throws_its_shadow_where_geometry_says():
    """A board halfway between a lamp and the wall has a shadow of twice its size; its edge is sharp within two pixels."""
    picture = lit(wall(), [Lamp(Light([(0, 0, 2.0)]), (3.0, 3.0, 3.0))], meshes=board(0, 0, 3.0, 0.3))[32, :, 0]
    edge = 64 * 0.6 / 4
    dark = 16 + np.flatnonzero(picture[16:48] < 0.5 * picture[32 + 14])
    assert abs(dark.min() - (32 - edge)) <= 2 and abs(dark.max() + 1 - (32 + edge)) <= 2
    assert picture[32] < 1e-3


def test_splats_throw_shadows_on_splats_and_not_on_themselves():
    sun = Lamp(Light.sun((0, -1, -1)), (3.0, 3.0, 3.0))
    free = lit(wall(), [sun])
    assert np.allclose(free[4:60, 4:60], middle(free), rtol=0.02)  # no spots
    leaf = wall(3.0, 0.4)
    both = lit([Instance(wall(), np.eye(4), 0.0, LIT), Instance(leaf, np.eye(4), 0.0, LIT)], [sun])
    assert both[32 + 16, 32, 0] < 0.02 * free[32 + 16, 32, 0]  # one unit lower on the wall
    assert np.allclose(both[32, 32], free[32, 32], rtol=0.02)  # the leaf itself


def test_what_came_from_elsewhere_throws_its_shadow_around_a_lamp_of_one_point():
    """A lamp so near to the wall that it looks through the sides of a cube, past a leaf that rests far behind it."""
    lamp, leaf = Lamp(Light([(0, 0, 3.2)]), (3.0, 3.0, 3.0)), wall(3.6, 0.4)
    away = replace(leaf, position=leaf.position - np.float32([0, 9, 0]), basis=fg.Polynomial(1),
                   motion=np.tile(np.float32([0, 9, 0]), (len(leaf), 1, 1)))
    here, moved = (lit([Instance(wall(), np.eye(4), 1.0, LIT), Instance(each, np.eye(4), 1.0, LIT)], [lamp]) for each in (leaf, away))
    assert here[32, 32 + 10, 0] < 0.02 * lit(wall(), [lamp])[32, 32 + 10, 0]
    assert np.abs(moved - here).max() < 1e-3


def test_captured_light_stays_and_shadows_take_from_it():
    """Without lamps' light a mesh's shadow still darkens the captured colour, by as much as is asked for."""
    lamp, look = Lamp(Light([(0, 0, 2.0)]), (3.0, 3.0, 3.0)), ObjectSettings(shadows=0.5)
    picture = lit(wall(), [lamp], look, meshes=board(0, 0, 3.0, 0.3))
    assert np.allclose(picture[32, 32], 0.5 * ALBEDO, rtol=0.01) and np.allclose(picture[32, 60], ALBEDO, rtol=0.01)
    half = lit(wall(), [], ObjectSettings(captured_light=0.5))
    assert np.allclose(middle(half), 0.5 * ALBEDO, rtol=0.01)


def test_light_linking():
    sun = Lamp(Light.sun((0, 0, -1)), (3.0, 3.0, 3.0), name="Sun")
    for lamp, bright in (("Other", True), ("Sun", False)):
        look = replace(LIT, unlit_by=frozenset({lamp}))
        assert (lit(wall(), [sun], look).max() > 0.1) == bright


def test_shadow_linking():
    """What lets a lamp's light through throws no shadow in it, and one in that of others; a mesh's edges do not show either."""
    lamps = [Lamp(Light([(0, 0, 2.0)]), (3.0, 3.0, 3.0), name=name) for name in ("One", "Other")]
    free, boards = lit(wall(), lamps[:1]), np.concatenate([board(0, 0, 3.0, 0.3), board(0.7, 0, 3.0, 0.2)])
    half = len(boards) // 2
    found = lit(wall(), lamps[:1], meshes=boards, clear={"One": np.arange(len(boards)) < half})
    only = lit(wall(), lamps[:1], meshes=boards[half:])
    assert np.array_equal(found, only) and not np.allclose(only, free, atol=0.05)
    leaf = replace(LIT, clear_to=frozenset({"One"}))
    for lamp, shadow in zip(lamps, (False, True), strict=True):
        both = lit([Instance(wall(), np.eye(4), 0.0, LIT), Instance(wall(3.0, 0.3), np.eye(4), 0.0, leaf)], [lamp])
        assert np.allclose(both[32, 40], 0 if shadow else free[32, 40], atol=0.1 * free[32, 40, 0])


def test_every_appearance_is_lit_alike():
    """Harmonics and decoders show the same colour as plain ones do, times the same light."""
    sun = Lamp(Light.sun((0, 0, -1)), (2.0, 1.0, 0.5))
    expected = middle(lit(wall(), [sun]))
    harmonics = np.concatenate([np.full(3, (GREY - 0.5) / SH_C0), np.zeros(9)])
    assert np.allclose(middle(lit(wall(appearance=fg.SH(1), features=lambda n: np.tile(harmonics, (n, 1))), [sun])), expected, rtol=0.01)
    rng = np.random.default_rng(0)
    for activation in ("clamp", "sigmoid"):
        look = fg.Features(rng.normal(0, 0.3, (6, 12)), rng.normal(0, 0.1, (3, 6)), activation)
        model = wall(appearance=look, features=lambda n: np.tile(rng.uniform(0.3, 0.6, 9), (n, 1)))
        bare = lit(model, [], ObjectSettings(captured_light=0.999999))
        assert np.allclose(middle(lit(model, [sun])), middle(bare) * np.array([2, 1, 0.5]) / np.pi, rtol=0.02)


def test_what_takes_no_light_keeps_every_byte():
    light = SceneLight((Lamp(Light.sun((0, 0, -1)), (2.0, 2.0, 2.0)),))
    plain = fg.render(wall(), CAMERA)["rgb"]
    assert np.array_equal(plain, fg.render([Instance(wall(), np.eye(4), 0.0)], CAMERA, settings=PassSettings(light=light))["rgb"])


def test_the_light_stays_on_what_an_edit_moves_through_the_shutter():
    """An edited model has another model at every moment; each of them is lit."""
    still = wall(3.0, 0.4)

    def picture(look):
        def at(x):
            moved = Edit(0.0, position=still.position + np.float32([x, 0, 0])).applied(still)
            return Instance(moved, np.eye(4), 0.0, look, place="one", origin=still)

        shutter = Exposure(moments=tuple(Moment({"one": at(x)}, CAMERA) for x in (-0.2, 0.0, 0.2)), steps=8)
        return lit(at(0.0), [], look, exposure=shutter)

    free, dimmed = picture(ObjectSettings()), picture(ObjectSettings(captured_light=0.25))
    assert free[32, 32, 0] > 0.2 and np.allclose(dimmed[32, 20:44], 0.25 * free[32, 20:44], rtol=0.01, atol=1e-3)


def test_same_bytes_on_any_number_of_threads():
    from fastgs_blender.util.threads import set_threads

    lamp = Lamp(Light.rectangle((1, -1, 1), (0.3, 0, 0), (0, 0.3, 0), 4), (5.0, 5.0, 5.0), np.array([0, 0, 1.0]), flat())
    pictures = []
    for threads in (1, 2, 3):
        set_threads(threads)
        pictures.append(lit([Instance(wall(), np.eye(4), 0.0, LIT), Instance(wall(3.0, 0.4), np.eye(4), 0.0, LIT)], [lamp]))
    set_threads(0)
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])


def test_the_oracle_agrees():
    sun = Lamp(Light.sun((0.2, -1, -1)), (3.0, 3.0, 3.0))
    camera = fg.Camera(24, 24, 24, 24, 12, 12, np.eye(4))
    models = [Instance(wall(4.0, 2.2, 0.2), np.eye(4), 0.0, LIT), Instance(wall(3.0, 0.4, 0.1), np.eye(4), 0.0, LIT)]
    assert np.allclose(lit(models, [sun], camera=camera), lit(models, [sun], camera=camera, backend="reference"), atol=2e-3)


def test_what_the_picture_does_not_show_is_not_computed():
    """What is behind a wall is left out; the picture is that of all light to 1/255, with specks smaller than pixels too.

    Single specks differ more: their shadows are as blurred as pictures from the lamp, which reach as far as what is lit.
    """
    rng = np.random.default_rng(2)
    dust = replace(wall(3.5, 2.0, 0.1), position=wall(3.5, 2.0, 0.1).position + rng.normal(0, 0.1, (1600, 3)).astype(np.float32),
                   scale=rng.normal(-4.5, 0.8, (1600, 3)).astype(np.float32), opacity=rng.normal(0, 2, 1600).astype(np.float32))
    light = SceneLight((Lamp(Light.sun((0, -1, -1)), (3.0, 3.0, 3.0)),), board(0, 0, 2.0, 0.3))
    instances = [Instance(model, np.eye(4), 0.0, LIT) for model in (wall(), dust, wall(5.0))]
    for camera in (CAMERA, CAMERA.stretched(480, 480)):
        found, whole = (light.lit(instances, camera, load_backend("cpu"), still=still) for still in (True, False))
        if camera is CAMERA:  # nearer by, light comes between the discs of the first wall
            assert not len(found[2].model) and len(whole[2].model)
        one, other = (fg.render(each, camera)["rgb"] for each in (found, whole))
        off = np.abs(one - other).max(-1)
        assert other.max() > 0.2 and (off > 1 / 255).mean() < 1e-3 and off.max() < 4 / 255


def test_wrong_colours_are_told():
    with pytest.raises(fg.FastGSError, match="colour"):
        Lamp(Light([(0, 0, 1)]), (np.nan, 1, 1))
