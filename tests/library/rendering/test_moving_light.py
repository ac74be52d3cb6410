# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows of meshes and lamps that move while a shutter is open."""
import numpy as np
import pytest
from test_scene_light import CAMERA, LIT, board, wall

import fastgs_blender as fg
from fastgs_blender.rendering.colour import srgb_to_linear
from fastgs_blender.rendering.exposure import Exposure
from fastgs_blender.rendering.instances import Instance, Moment
from fastgs_blender.rendering.lamps import Lamp, cone
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.rendering.relight import SceneLight
from fastgs_blender.rendering.shadow import Light

SHIFT = np.linspace(-0.3, 0.3, 5)
"""How far things move along x."""
FINE = wall(4.0, 2.4, 0.1)


def lamp_at(x=0.0, samples=1):
    return Lamp(Light.rectangle((x, 0, 2.0), (0.05, 0, 0), (0, 0.05, 0), samples), (3.0, 3.0, 3.0))


def still(x=0.0, lamp=0.0, samples=1):
    """A light with a board at x, before the wall."""
    return SceneLight((lamp_at(lamp, samples),), board(x, 0, 3.0, 0.2))


def picture(light, camera=CAMERA, shutter=True, backend="auto"):
    """The light that comes to the middle row of the wall, in the green channel."""
    moments = tuple(Moment({"wall": Instance(FINE, np.eye(4), 0.0, LIT, place="wall")}, camera) for _ in range(2))
    found = fg.render([Instance(FINE, np.eye(4), 0.0, LIT, place="wall")], camera, settings=PassSettings(light=light), backend=backend,
                      exposure=Exposure(moments=moments, steps=4) if shutter else None)
    return srgb_to_linear(found["rgb"] / np.maximum(found["alpha"], 1e-6)[..., None])[camera.height // 2, :, 1]


def average(lights):
    return np.mean([picture(each, shutter=False) for each in lights], 0)


@pytest.mark.parametrize("samples", [1, 16])
def test_a_board_that_moves_has_a_blurred_shadow(samples):
    """That of the average over many moments, without steps; and not that of the frame's own moment."""
    found = picture(still(samples=samples).exposed([still(x, samples=samples) for x in SHIFT]))
    wanted = average(still(x, samples=4) for x in np.linspace(-0.3, 0.3, 33))
    free = wanted.max()
    assert np.abs(found - wanted).max() < 0.1 * free
    assert np.abs(picture(still(samples=samples)) - wanted).max() > 0.3 * free
    assert np.abs(np.diff(found)).max() < 0.12 * free


def test_the_shutters_curve_counts():
    """A shutter that is open late shows the shadow where the board is then."""
    found = picture(still().exposed([still(x) for x in SHIFT], curve=(0.0, 0.0, 0.0, 0.0, 1.0)))
    assert np.abs(found - average([still(x) for x in np.linspace(0.18, 0.3, 9)])).max() < 0.35 * found.max()
    dark = np.flatnonzero(found < 0.3 * found.max())
    assert dark.mean() > 32 + 5  # 0.2 and more, twice as far away, sixteen pixels to a unit


def test_a_lamp_that_moves_blurs_shadows():
    found = picture(still().exposed([still(lamp=x) for x in SHIFT]))
    wanted = average(still(lamp=x) for x in np.linspace(-0.3, 0.3, 33))
    assert np.abs(found - wanted).max() < 0.1 * wanted.max()
    assert np.abs(picture(still()) - wanted).max() > 0.3 * wanted.max()


def test_a_spot_that_turns_lights_along_its_way():
    def spot(x):
        axis = np.array([x, 0, 2.0])
        return SceneLight((Lamp(Light([(0, 0, 2.0)]), (3.0, 3.0, 3.0), axis / np.linalg.norm(axis), cone(0.4, 0.1)),))

    found = picture(spot(0.0).exposed([spot(2 * x) for x in SHIFT]))
    assert np.abs(found - average(spot(2 * x) for x in np.linspace(-0.3, 0.3, 33))).max() < 0.15 * found.max()


def test_what_stands_still_costs_and_changes_nothing():
    light = still()
    assert light.exposed([]) is light
    same = light.exposed([still() for _ in SHIFT])
    assert same.lamps[0] is light.lamps[0] and not same.moments


def test_what_is_not_the_same_while_the_shutter_is_open_stands_still():
    """Triangles of another number, lamps of another name."""
    light, more = still(), SceneLight((lamp_at(),), np.concatenate([board(0, 0, 3.0, 0.2)] * 2))
    assert not light.exposed([still(0.1), more]).moments
    named = SceneLight((Lamp(Light([(0.5, 0, 2.0)]), (3.0, 3.0, 3.0), name="other"),), light.meshes)
    assert light.exposed([light, named]).lamps[0] is light.lamps[0]


def test_the_brightest_direction_shines_at_most_times():
    """Of a world of which one direction has most of the light; its light stays what it was."""
    world = Lamp(Light(np.eye(3), True), [[100.0] * 3, [1.0] * 3, [2.0, 1, 0]])
    found = world.exposed([world] * 2, (1.0,))
    of = [np.isclose(found.light.points, row).all(1) for row in np.eye(3)]
    assert [each.sum() for each in of] == [8, 1, 1] and np.allclose(found.colour.mean(0), world.colour.mean(0))
    assert np.allclose(found.light.times[of[0]], (np.arange(8) + 0.5) / 8, atol=0.07)


def test_same_bytes_twice():
    light = still().exposed([still(x) for x in SHIFT])
    assert np.array_equal(picture(light), picture(light))
