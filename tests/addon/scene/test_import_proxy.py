# SPDX-License-Identifier: GPL-3.0-or-later
"""The light mesh that stands for a model: few points, the right ones, seen in every engine, and no Gaussians in the .blend."""
from dataclasses import replace
from pathlib import Path

import bpy
import by_hand
import numpy as np
import pytest

SRGB_HALF = 0.21404114  # linear value of sRGB 0.5 (IEC 61966-2-1)


@pytest.fixture
def choose(module):
    return module("scene.splats.proxy_points").choose


def points(obj):
    """(positions [n, 3], colours [n, 4]) of an object's mesh."""
    mesh = obj.data
    position, colour = np.empty(3 * len(mesh.vertices), np.float32), np.empty(4 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", position)
    mesh.color_attributes["Color"].data.foreach_get("color", colour)
    return position.reshape(-1, 3), colour.reshape(-1, 4)


def test_a_large_model_makes_a_small_blend(fg, make_model, model_file, tmp_path):
    path = model_file(make_model(200_000, basis=fg.Fourier(5), motion=np.zeros((200_000, 10, 3)), clip=fg.Clip(10, 24)))
    bpy.ops.import_scene.fastgs(filepath=path)
    mesh = bpy.context.object.data
    assert 19_000 <= len(mesh.vertices) <= 20_004 and len(mesh.edges) == len(mesh.polygons) == 0
    blend = tmp_path / "small.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), compress=False)
    assert blend.stat().st_size < 2e6 < Path(path).stat().st_size / 10


@pytest.mark.parametrize("limit", [0, 1, 6, 7, 500])
def test_the_limit_is_kept(choose, make_model, limit):
    model = make_model(3000, seed=4)
    chosen = choose(model, limit)
    assert len(chosen.position) <= limit
    assert len(chosen.position) >= min(limit, 400)
    again = choose(model, limit)
    assert np.array_equal(chosen.position, again.position) and np.array_equal(chosen.colour, again.colour)


def test_models_without_anything_to_see(choose, make_model):
    assert len(choose(make_model(0)).position) == 0
    assert len(choose(make_model(20, opacity=np.full(20, -30.0))).position) == 0
    far = choose(make_model(20, features=np.full((20, 3), 1e30)))
    assert np.isfinite(far.colour).all()


def test_colours(fg, make_model, model_file, choose):
    n = 50
    grey = dict(srgb=dict(features=np.full((n, 3), 0.5)), linear=dict(features=np.full((n, 3), 0.5), colour_space="linear"),
                sh=dict(features=np.zeros((n, 48)), appearance=fg.SH(3)),
                decoded=dict(features=np.zeros((n, 9)), appearance=fg.Features(w2=np.ones((3, 6)), w1=np.ones((6, 12)))))
    for kind, fields in grey.items():
        colour = choose(make_model(n, **fields)).colour
        assert np.allclose(colour, 0.5 if kind == "linear" else SRGB_HALF, atol=1e-6), kind
    red = choose(make_model(n, features=np.tile([9.0, -9.0, 0.0], (n, 1)), appearance=fg.SH(0))).colour
    assert (red[:, 0] > 1).all() and (red[:, 1] == 0).all()

    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(n, features=np.full((n, 3), 0.5))))
    mesh = bpy.context.object.data
    assert np.allclose(points(bpy.context.object)[1][:n], [SRGB_HALF] * 3 + [1], atol=1e-6)
    attribute = mesh.color_attributes.active_color
    assert (attribute.name, attribute.data_type, attribute.domain) == ("Color", 'FLOAT_COLOR', 'POINT')
    assert mesh.color_attributes.render_color_index == mesh.color_attributes.find("Color")


def test_important_points_come_first_but_from_everywhere(choose, make_model):
    """Two equal halves of space, one with nearly all of the Gaussians; and large opaque ones among faint small ones."""
    rng = np.random.default_rng(1)
    position = rng.uniform(0, 1, (20_000, 3))
    position[:1000, 0] -= 1
    important = np.arange(20_000) % 20 == 0
    model = make_model(
        20_000, position=position, scale=np.where(important, -3.0, -6.0)[:, None] * np.ones(3), opacity=np.where(important, 3.0, -3.0))
    chosen = choose(model, 1000)
    left = (chosen.position[:, 0] < 0).mean()
    assert left > 0.25  # 5 % of the Gaussians, half of the space
    sparse = make_model(5000, position=rng.uniform(0, 0.02, (5000, 3)), scale=model.scale[:5000], opacity=model.opacity[:5000])
    kept = choose(sparse, 128)
    big = {tuple(p) for p in sparse.position[important[:5000]]}
    assert np.mean([tuple(p) in big for p in kept.position]) > 0.9


def test_bounds_hold_the_motion_and_not_the_strays(choose, fg, make_model):
    """One in a hundred moves 8 units away within the clip; three strays lie 10 000 units off."""
    n = 3000
    motion = np.zeros((n, 1, 3))
    motion[::100, 0, 0] = 8
    position = np.random.default_rng(0).uniform(-4, 4, (n, 3))
    position[[5, 6, 7]] = [[1e4, 0, 0], [0, -1e4, 0], [0, 0, 1e4]]
    model = make_model(n, position=position, motion=motion, basis=fg.Polynomial(1), mu_tau=np.zeros(n), clip=fg.Clip(50, 30))
    chosen = choose(model, 500)
    low, high = chosen.box
    assert ((chosen.position >= low) & (chosen.position <= high)).all()
    assert (np.abs(low) < 5).all() and (high < [13, 5, 5]).all()
    rest = model.take(np.setdiff1d(np.arange(n), [5, 6, 7]))
    for t in (0, 24 / 50, 49 / 50):
        shown = fg.slice_model(rest, t).position
        assert (shown >= low - 1e-4).all() and (shown <= high + 1e-4).all()


def test_a_backdrop_is_no_part_of_the_proxy(module, make_model, model_file):
    """Ninety of a hundred Gaussians are the sky; the box is the subject's, so that Home and Numpad-period frame it."""
    around = module("fastgs_blender.model.surroundings")
    model = make_model(300)
    model.position[30:] *= 50 / np.linalg.norm(model.position[30:], axis=1, keepdims=True)
    known = replace(model, surroundings=around.Surroundings(around.Backdrop(radius=40.0)))
    bpy.ops.import_scene.fastgs(filepath=model_file(known))
    obj = bpy.context.object
    assert len(obj.data.vertices) == 30 + 4 and obj.fastgs.has_backdrop and obj.fastgs.backdrop == 'INSIDE'
    assert max(obj.dimensions) < 4


def test_the_room_around_a_subject_is_shown_and_not_framed(module, fg, make_model, model_file):
    """Cameras look at a subject of 1 in a room of 4: other engines show both, Home, Numpad-period and camera moves go by the subject."""
    around, views = module("fastgs_blender.model.surroundings"), module("fastgs_blender.cameras.viewpoints")
    rng = np.random.default_rng(0)
    position = np.concatenate([rng.uniform(-0.5, 0.5, (200, 3)), 4 * np.sign(rng.normal(size=(400, 3)))])
    eyes = [3 * np.array([np.cos(a), np.sin(a), 0]) for a in np.arange(8)]
    cameras = [views.viewpoint_of(fg.Camera(48, 40, 40, 40, 24, 20, fg.look_at(eye, np.zeros(3))), "", 3.0) for eye in eyes]
    model = replace(make_model(600, position=position), surroundings=around.Surroundings(cameras=tuple(cameras)))
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    obj = bpy.context.object
    assert max(obj.dimensions) > 7 and np.abs(points(obj)[0]).max() > 3
    middle, radius = module("scene.cameras.subjects").middle_and_radius([obj])
    assert middle.length < 0.2 and 0.7 < radius < 1.3
    proxies = module("scene.proxies")
    proxies.hide(True)
    try:
        bpy.context.view_layer.update()
        assert 0.8 < max(obj.dimensions) < 1.2, "the bounds that viewports know while splats are drawn"
    finally:
        proxies.hide(False)


def test_the_most_telling_moment_is_shown(choose, fg, make_model):
    """Everything appears in the clip's last fifth only."""
    n = 400
    window = np.tile([0.8, 1.0, -6.0, -6.0], (n, 1))
    motion = np.tile([[0.0, 0.0, 10.0]], (n, 1, 1))
    model = make_model(n, temporal_kind=fg.Window(), temporal=window, motion=motion, basis=fg.Polynomial(1), mu_tau=np.zeros(n),
                       clip=fg.Clip(100, 30))
    chosen = choose(model)
    assert chosen.t >= 0.8 and len(chosen.position) > 300
    assert chosen.position[:, 2].min() > 6


def test_other_engines_see_coloured_points(scene, make_model, model_file, add_camera, render):
    """Cycles shows the model's own colour where the points are, and most of the surface."""
    n = 4000
    rng = np.random.default_rng(2)
    disc = rng.uniform(-1, 1, (n, 3)) * [1, 0.01, 1]
    path = model_file(make_model(
        n, position=disc, scale=np.full((n, 3), -4.0), opacity=np.full(n, 9.0), features=np.tile([0.8, 0.5, 0.2], (n, 1)), axes="RFU"))
    bpy.ops.import_scene.fastgs(filepath=path)
    add_camera()
    scene.render.engine = 'CYCLES'
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.render.film_transparent = True
    image = render("PNG").astype(float)
    middle = image[18:30, 26:38]
    assert middle[..., 3].mean() > 0.6 * 255
    assert np.allclose(middle[middle[..., 3] > 0][:, :3], np.array([0.8, 0.5, 0.2]) * 255, atol=2)


def test_solid_view_has_faces_with_the_colour(make_model, model_file):
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(100)))
    obj = bpy.context.object
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert len(evaluated.polygons) == 8 * 100
    assert evaluated.color_attributes.active_color.name == "Color"


def test_workbench_draws_greys_as_greys(make_model, model_file):
    """And not as a rainbow of the palette's colours."""
    grey = np.random.default_rng(6).random((200, 1)) * np.ones(3)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(200, opacity=np.full(200, 4.0), features=grey)))
    mesh = bpy.context.object.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    used = np.array([mesh.materials[face.material_index].diffuse_color[:3] for face in mesh.polygons])
    assert len(used) and np.ptp(used, axis=1).max() < 1e-4 and len(np.unique(used.round(3), axis=0)) == 3


def test_workbench_draws_each_point_in_its_colour(make_model, model_file):
    """Workbench knows materials alone: each octahedron has the palette's one that is next to its colour, above or below."""
    rng = np.random.default_rng(5)
    features = rng.random((200, 3))
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(200, opacity=np.full(200, 4.0), features=features)))
    obj = bpy.context.object
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.data
    gaussian = mesh.attributes["Gaussian"].data
    error = []
    for face in mesh.polygons:
        colour = np.array(mesh.materials[face.material_index].diffuse_color[:3])
        error.append(by_hand.srgb(colour) - features[gaussian[face.vertices[0]].value])
    assert len(error) == 8 * 200
    assert np.abs(error).max() < 0.5 + 1e-3 and np.abs(np.mean(error, axis=0)).max() < 0.03
