# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadows of meshes on splats that are larger than the shadows' edges may be."""
from dataclasses import replace

import numpy as np
import pytest
from test_scene_light import ALBEDO, CAMERA, LIT, board, lit, wall

import fastgs_blender as fg
from fastgs_blender.rendering import seen, shadow_edges
from fastgs_blender.rendering.exposure import Exposure
from fastgs_blender.rendering.instances import Instance, Moment, ObjectSettings
from fastgs_blender.rendering.lamps import Lamp
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.rendering.relight import SceneLight
from fastgs_blender.rendering.shadow import Light
from fastgs_blender.rendering.ways import Sides

COARSE = wall(4.0, 2.4, 0.4)
"""Discs of six pixels."""
POINT = Lamp(Light([(0, 0, 2.0)]), (3.0, 3.0, 3.0))
ABOVE = 64 * 0.6 / 4
"""Pixels from the middle to the edge of the shadow of a board of 0.3, halfway between a lamp and the wall."""


def light_of(picture, free):
    """How much of its light each pixel [h, w] has."""
    return picture[..., 1] / np.maximum(free[..., 1], 1e-6)


def there(radius=ABOVE):
    """Which pixels' middles lie in a square of so many pixels around the middle, and which lie more than a pixel beside its edge."""
    away = np.abs(np.arange(64) + 0.5 - 32)
    away = np.maximum(away, away[:, None])
    return away < radius, np.abs(away - radius) > 1


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_an_edge_is_as_sharp_as_pixels(backend):
    free, shaded = (lit(COARSE, [POINT], meshes=meshes, backend=backend) for meshes in (None, board(0, 0, 3.0, 0.3)))
    dark, clear = there()
    share = light_of(shaded, free)
    assert share[dark & clear].max() < 0.02 and share[~dark & clear].min() > 0.98
    assert np.array_equal(shaded, lit(COARSE, [POINT], meshes=board(0, 0, 3.0, 0.3), backend=backend))


@pytest.mark.parametrize("window", [(int(32 - ABOVE) - 3, 9, 4, 45), (30, int(32 - ABOVE), 1, 1)])
def test_a_part_of_the_picture_has_the_edges_of_the_whole(window):
    """Also a single pixel, and where the part's border runs along an edge."""
    x, y, width, height = window
    for lamp in (POINT, Lamp(Light.rectangle((0, 0, 2.0), (0.5, 0, 0), (0, 0.5, 0), 16), (3.0, 3.0, 3.0))):
        whole, part = (lit(COARSE, [lamp], meshes=board(0, 0, 3.0, 0.3), camera=camera)
                       for camera in (CAMERA, replace(CAMERA, window=window)))
        assert np.allclose(part, whole[y:y + height, x:x + width], atol=1e-4)


def test_a_lamp_of_many_points_throws_thin_shadows():
    """Thinner than the discs, whose own shadows hardly differ there."""
    lamp = Lamp(Light.rectangle((0, 0, 2.0), (0.01, 0, 0), (0, 0.01, 0), 16), (3.0, 3.0, 3.0))
    free, shaded = (lit(COARSE, [lamp], meshes=meshes) for meshes in (None, board(0, 0, 3.0, 0.05)))
    assert light_of(shaded, free)[31:33, 31:33].max() < 0.1


@pytest.mark.parametrize("lamp", [POINT, Lamp(Light.rectangle((0, 0, 2.0), (0.1, 0, 0), (0, 0.1, 0), 16), (3.0, 3.0, 3.0))])
@pytest.mark.parametrize("half", [0.3, 0.03])
def test_pixels_ask_less_where_those_around_them_are_told_the_same(lamp, half, monkeypatch):
    """Also beside a shadow of three pixels.  The picture is the one of pixels that ask everything."""
    camera, meshes, asked, past = fg.Camera(256, 256, 256, 256, 128, 128, np.eye(4)), board(0, 0, 3.0, half), [0], Sides.past

    def counted(self, number, places, *rest):
        asked[0] += 0 if self.ways.instances else places.shape[1] * places.shape[2]
        return past(self, number, places, *rest)

    monkeypatch.setattr(Sides, "past", counted)
    monkeypatch.setattr(seen, "FEW", 0)
    some, count = lit(COARSE, [lamp], meshes=meshes, camera=camera), asked[0]
    monkeypatch.setattr(seen, "FEW", 10**9)
    every = lit(COARSE, [lamp], meshes=meshes, camera=camera)
    assert 0 < count < 0.75 * (asked[0] - count)
    assert np.allclose(some, every, atol=1e-4)


def test_only_surfaces_that_face_a_lamp_ask():
    """A wall at the depth 4, tilted down in its lower half: lamps before it, behind it, above it; suns."""
    rows, columns = (axis.ravel() for axis in np.mgrid[:64, :64])
    below = rows >= 32
    normal = np.array([np.zeros(len(rows)), np.where(below, 0.6, 0), np.where(below, -0.8, -1)])
    wall = seen.Seen(CAMERA, (rows, columns), np.broadcast_to([[4.0], [0], [0]], (3, len(rows))), normal)
    before, behind, above = (Lamp(Light([place]), (1, 1, 1)) for place in ((0, 0, 2.0), (0, 0, 6.0), (0, -9.0, 3.0)))
    sun, lower = (Lamp(Light.sun(towards), (1, 1, 1)) for towards in ((0, 0, -1), (0, 1, 0.1)))
    for lamps, expected in (([before], True), ([behind], False), ([above], ~below), ([sun], True), ([lower], below),
                            ([behind, lower], below)):
        assert (wall.faces(lamps) == expected).all()


def test_a_shadow_over_everything_has_no_edge():
    assert lit(COARSE, [POINT], meshes=board(0, 0, 3.0, 9.0)).max() < 1e-3


def test_only_the_light_of_its_lamp_is_taken():
    """Of two lamps one is hidden; captured light stays by its own share."""
    side = Lamp(Light([(0, -6.0, 2.0)]), (30.0, 15.0, 3.0))
    alone, both = (lit(COARSE, lamps, meshes=board(0, 0, 3.0, 0.3)) for lamps in ([side], [POINT, side]))
    dark, clear = there()
    assert np.allclose(both[dark & clear], alone[dark & clear], rtol=0.02, atol=1e-4)
    look = ObjectSettings(shadows=0.5)
    found = lit(COARSE, [POINT], look, meshes=board(0, 0, 3.0, 0.3))
    assert np.allclose(found[dark & clear], 0.5 * ALBEDO, rtol=0.03)


def test_a_soft_shadow_has_no_steps():
    """Under a square lamp of 16 points: from dark to light evenly, by less than a point of the lamp from pixel to pixel."""
    lamp = Lamp(Light.rectangle((0, 0, 2.0), (0.5, 0, 0), (0, 0.5, 0), 16), (3.0, 3.0, 3.0))
    camera = fg.Camera(256, 256, 256, 256, 128, 128, np.eye(4))
    free, shaded = (lit(COARSE, [lamp], meshes=meshes, camera=camera)[128] for meshes in (None, board(1.5, 0, 3.0, 1.5)))
    row = light_of(shaded, free)[60:200]
    slope = -np.diff(row)
    assert row[0] > 0.98 and row[-1] < 0.02 and slope.min() > -0.01 and slope.max() < 1 / 16


def test_where_a_pixel_shows_two_things_each_keeps_its_own_shadow():
    """A fine veil before the shaded wall is lit, and stays so."""
    veil = wall(2.5, 0.5, 0.05)
    veil = fg.GaussianModel(**veil.arrays | {"opacity": np.full(len(veil), -1.2)}, appearance=fg.RGB())
    instances = [Instance(each, np.eye(4), 0.0, LIT) for each in (COARSE, veil)]
    sun = Lamp(Light.sun((0, -1, -0.2)), (3.0, 3.0, 3.0))
    free, shaded = (lit(instances, [sun], meshes=meshes) for meshes in (None, board(0, -2.0, 3.7, 1.2)))
    bare = lit(COARSE, [sun], meshes=board(0, -2.0, 3.7, 1.2))
    assert bare[32, 32, 1] < 0.01 and shaded[32, 32, 1] > 0.3 * free[32, 32, 1]


def test_a_surface_of_many_depths_keeps_the_shadows_of_its_gaussians(rng, monkeypatch):
    """Faint balls at many depths, as a floor filmed from one height: where some agree by chance, no sharp patch stands out."""
    floor = wall(4.0, 2.4, 0.1)
    floor.position[:, 2] += rng.uniform(-0.3, 0.3, len(floor))
    floor.opacity[:], floor.scale[:] = -1.5, np.log(0.08)
    sun = Lamp(Light.sun((0, -1, -0.4)), (3.0, 3.0, 3.0))
    camera = fg.Camera(256, 256, 256, 256, 128, 128, np.eye(4))

    def steps():
        free, shaded = (lit(floor, [sun], camera=camera, meshes=meshes) for meshes in (None, board(0, -1.0, 3.0, 0.8)))
        share = light_of(shaded, free)[64:192, 64:192]
        return (np.abs(np.diff(share, axis=1)) > 0.2).sum()

    found = steps()
    monkeypatch.setattr(shadow_edges, "believed", lambda one, pixels: one)
    assert found < 0.1 * steps()


def test_the_passes_have_the_same_edge():
    settings = PassSettings(light=SceneLight((POINT,), board(0, 0, 3.0, 0.3)))
    names = ("rgb", "mesh_shadow", "lamp_shadow")
    plain = [Instance(COARSE, np.eye(4), 0.0)]
    found = fg.render(plain, CAMERA, passes=names, settings=settings)
    dark, clear = there()
    for name in names[1:]:
        assert found[name][dark & clear].max() < 0.02 and found[name][~dark & clear].min() > 0.98
    assert np.array_equal(found["rgb"], fg.render(plain, CAMERA)["rgb"])


def test_a_still_edge_stays_sharp_while_a_shutter_is_open():
    """Something moves before the wall while the edge stands still."""
    leaf = wall(2.0, 0.1)
    moments = tuple(Moment({"leaf": Instance(leaf, np.diag([1.0, 1, 1, 1]) + np.eye(4, k=3) * x, 0.0, LIT, place="leaf")}, CAMERA)
                    for x in (-0.5, 0.0, 0.5))
    instances = [Instance(COARSE, np.eye(4), 0.0, LIT, place="wall"), moments[1].instances["leaf"]]
    shutter = Exposure(moments=moments, steps=8)
    free, shaded = (lit(instances, [POINT], meshes=meshes, exposure=shutter) for meshes in (None, board(0, 0.6, 3.0, 0.3)))
    share, away = light_of(shaded, free), np.abs(np.arange(64) + 0.5 - 32) < ABOVE - 1
    below = slice(32 + 10, 32 + 28)  # 0.6 halfway to the wall: 1.2, 19.2 pixels, on it
    assert share[below][:, away].max() < 0.05 and share[below][:, :20].min() > 0.95
