# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of lamps, the estimate of the unlit colour, and what a compositor makes of them."""
from dataclasses import replace

import numpy as np
import pytest
from test_normals import CENTRE, ball
from test_scene_light import CAMERA, board, wall

import fastgs_blender as fg
from fastgs_blender.rendering.colour import linear_to_srgb, srgb_to_linear
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.lamps import Lamp
from fastgs_blender.rendering.passes import PassSettings
from fastgs_blender.rendering.relight import SceneLight
from fastgs_blender.rendering.shadow import Light

POINT, SUN = Lamp(Light([(0, 0, 2.0)]), (3.0, 3.0, 3.0)), Lamp(Light.sun((0, -1, -1)), (1.0, 0.9, 0.8))
PASSES = ("rgb", "alpha", "lamp_light", "lamp_light_2", "mesh_shadow", "mesh_shadow_2", "lamp_shadow", "lamp_shadow_2", "contact")


def of(look, *models):
    return [Instance(model, np.eye(4), 0.0, look) for model in models]


def test_lights_and_shadows_of_each_lamp_for_themselves():
    """A board keeps the point's light from the wall's middle, a leaf the sun's from a part above; each pass tells its own."""
    light = SceneLight((POINT, SUN), board(0, 0, 3.0, 0.3))
    found = fg.render(of(ObjectSettings(), wall(), replace(wall(3.0, 0.4), position=wall(3.0, 0.4).position + [0, -0.9, 0])), CAMERA,
                      passes=PASSES, settings=PassSettings(light=light))
    assert found["lamp_light"][32, 32] == pytest.approx(np.full(3, 3 / 4 / np.pi), rel=0.03)
    assert found["mesh_shadow"][32, 32] < 1e-3 and found["mesh_shadow"][32, 60] > 0.999
    assert found["lamp_light_2"][50, 8] == pytest.approx(np.sqrt(0.5) / np.pi * np.array([1, 0.9, 0.8]), rel=0.02)
    shaded = found["mesh_shadow_2"] - found["lamp_shadow_2"] > 0.9
    assert shaded.any() and not shaded[:16].any()
    assert np.array_equal(found["rgb"], fg.render(of(ObjectSettings(), wall(), replace(wall(3.0, 0.4), position=wall(
        3.0, 0.4).position + [0, -0.9, 0])), CAMERA)["rgb"])  # nothing takes light


def test_without_lamps_the_passes_say_so():
    found = fg.render(of(ObjectSettings(), wall()), CAMERA, passes=PASSES)
    assert not found["lamp_light"].any()
    assert all(np.allclose(found[name], 1, atol=1e-5) for name in ("mesh_shadow", "lamp_shadow", "contact"))


def test_contact_is_dark_where_a_mesh_touches():
    """A board that stands on the wall: dark beside its foot, less farther away, nothing beyond the distance."""
    upright = np.array([[[0, y0, z] for y0, z in side] for side in (((-1, 4.0), (1, 4.0), (1, 3.0)), ((-1, 4.0), (1, 3.0), (-1, 3.0)))],
                       np.float32)
    light = SceneLight((), upright, reach=0.5)
    found = fg.render(of(ObjectSettings(), wall()), CAMERA, passes=("contact",), settings=PassSettings(light=light))["contact"]
    row = found[32]
    assert row[33] < 0.75 and row[33] < row[36] < row[39] <= 1 and np.allclose(row[[20, 44]], 1, atol=1e-3)
    assert row[31] == pytest.approx(row[32], abs=0.05)  # alike on both sides
    assert np.allclose(found[:4], 1, atol=1e-3)


def relit(captured, found, look):
    """What the compositor's group makes of straight linear colours and the passes."""
    lights = [found[name] for name in ("lamp_light", "lamp_light_2")]
    past, shadow = ([found[name][..., None] for name in names] for names in (("mesh_shadow", "mesh_shadow_2"),
                                                                             ("lamp_shadow", "lamp_shadow_2")))
    total = sum(lights) + 1e-6
    share = (sum(each * factor for each, factor in zip(lights, past, strict=True)) + 1e-6) / total
    lamps = sum(each * (1 - look.shadows * (1 - factor)) for each, factor in zip(lights, shadow, strict=True))
    return captured * (look.captured_light * (1 - look.shadows * (1 - share)) + look.lamp_light * lamps)


def test_the_passes_make_what_scene_light_makes():
    """To 1/255 in the median and 10/255 at the worst of edges, in which a pixel mixes splats in light and in shadow."""
    look = ObjectSettings(captured_light=0.3, lamp_light=0.8, shadows=0.7)
    models = wall(), wall(3.0, 0.4)
    settings = PassSettings(light=SceneLight((POINT, SUN), board(0.8, 0, 3.2, 0.2)))
    passes = fg.render(of(ObjectSettings(), *models), CAMERA, passes=PASSES, settings=settings)
    captured = srgb_to_linear(passes["rgb"] / passes["alpha"][..., None])
    wanted = fg.render(of(look, *models), CAMERA, settings=settings)
    off = np.abs(linear_to_srgb(relit(captured, passes, look)) - wanted["rgb"] / wanted["alpha"][..., None])
    assert np.median(off) < 1 / 255 and off.max() < 10 / 255


def lit_ball(tilt=0.2, even=0.15):
    """(a ball of two colours as a sun and even light show it, the same without light)."""
    model = ball(tilt)
    out = model.position - CENTRE
    colour = np.where((np.floor(out * 2.2).sum(1) % 2 == 0)[:, None], [0.6, 0.35, 0.2], [0.2, 0.4, 0.5])
    towards = np.array([0.5, -0.6, -0.6]) / np.linalg.norm([0.5, -0.6, -0.6])
    light = (even + (1 - even) * np.maximum(out @ towards, 0))[:, None] * [1, 0.95, 0.85]
    return tuple(replace(model, features=linear_to_srgb(each).astype(np.float32)) for each in (colour * light, colour))


def psnr(one, other, there):
    return -10 * np.log10(((one - other)[there] ** 2).mean())


def test_the_unlit_colour_of_a_lit_ball():
    """At least 6 dB nearer to the colours without light than the captured ones."""
    lit, plain = lit_ball()
    true, found = fg.render(plain, CAMERA)["rgb"], fg.render(lit, CAMERA, passes=("rgb", "alpha", "unlit"))
    there = found["alpha"] > 0.95
    assert psnr(found["unlit"], true, there) > psnr(found["rgb"], true, there) + 6


def test_lamps_on_the_unlit_colour_are_nearer_to_lamps_on_the_plain_one():
    lit, plain = lit_ball()
    settings = PassSettings(light=SceneLight((Lamp(Light.sun((-1, -0.4, -0.6)), (2.5, 2.5, 2.5)),)))
    look = ObjectSettings(captured_light=0, lamp_light=1)
    true = fg.render(of(look, plain), CAMERA, passes=("rgb", "alpha"), settings=settings)
    captured, estimated = (fg.render(of(replace(look, unlit=share), lit), CAMERA, settings=settings)["rgb"] for share in (0.0, 1.0))
    there = true["alpha"] > 0.95
    assert psnr(estimated, true["rgb"], there) > psnr(captured, true["rgb"], there) + 4


def test_a_model_without_light_in_it_keeps_its_colour():
    """Flat colours, and a wall of one normal: nothing is told, nothing changes."""
    for model in (lit_ball()[1], wall()):
        found = fg.render(model, CAMERA, passes=("rgb", "unlit", "alpha"))
        there = found["alpha"] > 0.95
        assert np.abs(found["unlit"] - found["rgb"])[there].mean() < 0.02
