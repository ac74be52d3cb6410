# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that the viewport's shaders draw, against the library's renders."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gpu_context import draw_offscreen, open_gpu

SIZE = 160, 120
HALF = 5e-4
"""Of numbers up to 1, what half floats lose."""


@pytest.fixture
def gpu_scene(scene):
    open_gpu(scene)
    return scene


@pytest.fixture
def camera(fg):
    """camera(orthographic=False, distance=4.0): looks at the origin from somewhere off the axes, off-centre, wide pixels."""

    def make(orthographic=False, distance=4.0, size=SIZE):
        turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3] = turn * np.sign(np.linalg.det(turn))
        pose[2, 3] = distance
        width, height = size
        focal = (0.2 if orthographic else 0.8) * width
        return fg.Camera(width, height, focal, 1.05 * focal, 0.53 * width, 0.46 * height, pose, orthographic, near=0.1)

    return make


@pytest.fixture
def moving(fg):
    """moving(appearance, basis="static", n=300, seed=0): a random model with temporal opacity, blur and turning Gaussians."""
    bases = {
        "static": fg.Static(), "paper": fg.Fourier(5), "cosine": fg.Cosine(6), "cubic": fg.Polynomial(3),
        "keys": fg.Keyframes((0.0, 0.2, 0.3, 0.5, 0.8, 1.0)), "smooth keys": fg.Keyframes((0.0, 0.2, 0.5, 0.7, 0.9), "catmull-rom"),
    }

    def make(appearance, basis="static", rotation="cubic", temporal=None, n=300, seed=0, **fields):
        rng = np.random.default_rng(seed)
        basis, rotation, temporal = bases[basis], bases[rotation], temporal or fg.Radial()
        begin = rng.uniform(-0.2, 0.7, n)
        features = rng.normal(0.4, 0.2, (n, appearance.width))
        if isinstance(appearance, fg.SH):
            features[:, 3:] -= 0.4
        window = np.stack([begin, begin + rng.uniform(0.05, 0.6, n), *rng.normal(-3, 0.7, (2, n))], -1)
        arrays = dict(
            position=rng.uniform(-1, 1, (n, 3)), rotation=rng.normal(size=(n, 4)), scale=np.log(0.1) + rng.normal(0, 0.7, (n, 3)),
            opacity=rng.normal(1, 2, n), features=features,
            motion=rng.normal(0, 0.2, (n, basis.terms, 3)), rotation_motion=rng.normal(0, 0.3, (n, rotation.terms, 4)),
            mu_tau=rng.uniform(0, 1, n), temporal=window if temporal.width == 4 else rng.normal(2, 1, (n, temporal.width)),
            basis=basis, rotation_basis=rotation, temporal_kind=temporal, appearance=appearance)
        return fg.GaussianModel(**(arrays | fields))

    return make


@pytest.fixture
def drawn(module, gpu_scene):
    """drawn(parts, camera, **resolve): the viewport's picture in scene-linear Rec.709 [h, w, 4]."""
    picture, atlas = module("engine.viewport.picture"), module("engine.viewport.atlas")
    order, listed = module("fastgs_blender.rendering.visibility").order, module("engine.viewport.sorting").listed
    instance = module("fastgs_blender.rendering.instances").Instance

    def draw(parts, camera, depth=None, keep=lambda indices: indices, **look):
        parts = [instance(*part).viewed(camera) for part in parts]
        textures, shown = atlas.Atlas(), picture.Picture()
        textures.upload([part.model for part in parts])

        def resolve(framebuffer):
            kept = keep(order(parts, camera))
            shown.draw(camera, parts, textures, picture.Order(listed(parts, kept), len(kept)), depth)
            shown.resolve(np.eye(3), **look)

        return draw_offscreen(camera.width, camera.height, resolve)

    return draw


def decoder(fg, activation):
    rng = np.random.default_rng(3)
    weights = rng.normal(0, 0.5, (6, 12)), rng.normal(0, 0.5, (3, 6))
    activation, _, way = activation.partition(" ")
    return fg.Features(*weights, activation, way or "normalised")


def expected(module, parts, camera):
    """The same from the final render's code: Combined on transparent film."""
    parts = [module("fastgs_blender.rendering.instances").Instance(*part) for part in parts]
    return module("engine.passes").images(parts, camera, [])["Combined"]


def psnr(a, b):
    """Against the brightest colour of b, at least 1: decoders without activation give any number."""
    return 10 * np.log10(max(b.max(), 1) ** 2 / (np.mean((a.astype(np.float64) - b) ** 2) + 1e-20))


def agree(module, parts, camera, drawn, **options):
    want = expected(module, parts, camera)
    assert want[..., 3].max() > 0.5, "the picture must show something"
    got = drawn(parts, camera, **options)
    assert psnr(got, want) >= 45
    return got, want


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("look", ["rgb", "sh0", "sh1", "sh2", "sh3", "sh4", "sigmoid", "clamp", "none",
                                  *(f"{name} premultiplied" for name in ("sigmoid", "clamp", "none"))])
def test_every_appearance(module, fg, moving, camera, drawn, look, orthographic):
    appearance = fg.RGB() if look == "rgb" else fg.SH(int(look[2])) if look[:2] == "sh" else decoder(fg, look)
    agree(module, [(moving(appearance), np.eye(4), 0.4)], camera(orthographic), drawn)


@pytest.mark.parametrize("look", ["rgb", "sh0", "sh2"])
@pytest.mark.parametrize("basis", ["paper", "cubic", "smooth keys"])
def test_colours_that_change_in_time(module, fg, moving, camera, drawn, look, basis):
    look = fg.RGB() if look == "rgb" else fg.SH(int(look[2]))
    model = moving(fg.Changing(look, moving(look, basis).basis), "paper", temporal=fg.Always())
    first, later = (agree(module, [(model, np.eye(4), t)], camera(), drawn)[1] for t in (0.1, 0.6))
    assert np.abs(first - later).max() > 0.2


@pytest.mark.parametrize("basis", ["paper", "cosine", "cubic", "keys", "smooth keys"])
@pytest.mark.parametrize("t", [-0.1, 0.37, 1.2])
def test_every_basis_of_time(module, fg, moving, camera, drawn, basis, t):
    model = moving(fg.SH(1), basis, rotation="smooth keys" if basis == "keys" else "paper", temporal=fg.Window())
    agree(module, [(model, np.eye(4), t)], camera(), drawn) if t == 0.37 else agree(
        module, [(moving(fg.RGB(), basis, temporal=fg.Always()), np.eye(4), t)], camera(), drawn)


@pytest.mark.parametrize("kind", ["rgb", "sh2", "sigmoid", "sigmoid premultiplied"])
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_looks(module, fg, moving, camera, drawn, kind, space):
    """Colour, opacity and size of objects: what the viewport draws is what F12 shows, and not what the file says."""
    settings = module("fastgs_blender.rendering.instances").ObjectSettings
    look = settings(exposure=0.5, gamma=1.2, contrast=1.2, saturation=0.5, hue=2.0, tint=(1.0, 0.7, 0.4), opacity=0.6, opacity_cut=0.2,
                    splat_scale=1.5, min_size=0.1, max_size=0.25)
    model = moving({"rgb": fg.RGB(), "sh2": fg.SH(2)}.get(kind) or decoder(fg, kind), "paper", colour_space=space)
    _, want = agree(module, [(model, np.eye(4), 0.4, look)], camera(), drawn)
    assert psnr(want, expected(module, [(model, np.eye(4), 0.4)], camera())) < 30


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sh2", "sigmoid"])
def test_crops_with_soft_edges_and_filters(module, fg, moving, camera, drawn, kind):
    crops, filters = module("fastgs_blender.rendering.crops"), module("fastgs_blender.rendering.filters")
    points = np.array([[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    volume = module("fastgs_blender.rendering.volumes").mesh_volume(
        points, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]), points.min(0), points.max(0))
    model, eye = moving(fg.SH(2) if kind == "sh2" else decoder(fg, kind), "paper"), np.eye(4)
    settings = module("fastgs_blender.rendering.instances").ObjectSettings
    plain = expected(module, [(model, eye, 0.4)], camera())
    for each in (crops.Crop(eye, shape="SPHERE", soft=0.8), crops.Crop(eye, shape=volume, soft=0.5), crops.Crop(eye, True, volume)):
        look = settings(crops=[each], filters=[filters.Filter("SIZE", 0.2, 9)])
        parts = [(model, eye, 0.4, look), (moving(fg.RGB(), n=20, seed=4), eye, 0.2)]
        _, want = agree(module, parts, camera(), drawn)
        assert psnr(want, plain) < 30


def test_parts_of_a_model_are_decoded_together(module, fg, moving, camera, drawn):
    """Separated by a filter, beside another object: as F12 shows them, which is the whole model."""
    filters, settings = module("fastgs_blender.rendering.filters"), module("fastgs_blender.rendering.instances").ObjectSettings
    model, other = moving(decoder(fg, "sigmoid"), "paper"), (moving(fg.RGB(), n=20, seed=4), np.eye(4), 0.2)
    parts = [(model, np.eye(4), 0.4, settings(filters=[filters.Filter("SIZE", 0.2, 9, keep)])) for keep in (True, False)]
    assert all(psnr(expected(module, [(model, np.eye(4), 0.4)], camera()), expected(module, [part], camera())) < 40 for part in parts)
    got, _ = agree(module, [*parts, other], camera(), drawn)
    assert psnr(got, expected(module, [(model, np.eye(4), 0.4), other], camera())) >= 45


def test_antialiased_models_with_constants_of_their_own(module, fg, moving, camera, drawn):
    raster = fg.Raster(blur=0.1, alpha_max=0.8, alpha_cut=0.02, near=0.5, antialiased=True)
    agree(module, [(moving(fg.RGB(), raster=raster), np.eye(4), 0.5)], camera(distance=1.0), drawn)


@pytest.mark.parametrize("orthographic", [False, True])
def test_far_views(module, fg, moving, camera, drawn, orthographic):
    """Splats are as faint as in the final render where the capture's cameras were nearer, or their pictures sharper."""
    eye = camera(orthographic)
    film = module("fastgs_blender.cameras.viewpoints").viewpoint_of(replace(camera(), fx=8 * camera().fx, fy=8 * camera().fy))
    model = replace(moving(fg.RGB()), surroundings=module("fastgs_blender.model.surroundings").Surroundings(cameras=(film,)))
    model.scale[:] -= 2.5
    model.opacity[:] = 4.0
    plain = module("fastgs_blender.rendering.instances").ObjectSettings(antialias=False)
    want = expected(module, [(model, np.eye(4), 0.4)], eye)
    assert psnr(drawn([(model, np.eye(4), 0.4)], eye), want) >= 45
    assert psnr(drawn([(model, np.eye(4), 0.4, plain)], eye), want) < 35


@pytest.mark.parametrize("orthographic", [False, True])
def test_views_in_finer_pixels(module, fg, moving, camera, drawn, orthographic):
    """Splats are as soft as in the final render, each as the cameras of the capture saw it that have it in their picture."""
    eye, viewpoint_of = camera(orthographic), module("fastgs_blender.cameras.viewpoints").viewpoint_of
    films = [replace(camera(distance=distance), fx=camera().fx / k, fy=camera().fy / k) for k, distance in ((4, 4.0), (8, 2.5))]
    around = module("fastgs_blender.model.surroundings").Surroundings(cameras=tuple(map(viewpoint_of, films)))
    model = replace(moving(fg.SH(1), "paper"), surroundings=around)
    model.scale[:] -= 2.5
    model.opacity[:] = 4.0
    plain = module("fastgs_blender.rendering.instances").ObjectSettings(antialias=False)
    want = expected(module, [(model, np.eye(4), 0.4)], eye)
    assert psnr(drawn([(model, np.eye(4), 0.4)], eye), want) >= 45
    assert psnr(drawn([(model, np.eye(4), 0.4, plain)], eye), want) < 35


def test_a_camera_among_the_splats(module, fg, moving, camera, drawn):
    agree(module, [(moving(fg.SH(2), "paper"), np.eye(4), 0.5)], camera(distance=0.3), drawn)
    large = moving(fg.RGB(), n=40, scale=np.random.default_rng(3).uniform(-3, -0.3, (40, 3)), raster=fg.Raster(near=0.05))
    agree(module, [(large, np.eye(4), 0.5)], camera(distance=0.3), drawn)


PAIRS = {"both plain": ("rgb", "sh", "srgb", "srgb"), "a decoder": ("rgb", "features", "srgb", "srgb"),
         "two decoders": ("features", "features", "srgb", "srgb"), "a decoder of sums": ("rgb", "sums", "srgb", "srgb"),
         "two colour spaces": ("rgb", "sh", "srgb", "linear")}


@pytest.mark.parametrize("pair", PAIRS)
def test_objects_that_interpenetrate_are_one_cloud(module, fg, moving, camera, drawn, pair):
    looks = {"rgb": fg.RGB(), "sh": fg.SH(2), "features": decoder(fg, "sigmoid"), "sums": decoder(fg, "sigmoid premultiplied")}
    first, second, *spaces = PAIRS[pair]
    placement = np.array([[0.9, -0.4, 0, 0.2], [0.4, 0.9, 0, 0], [0, 0, 1.3, -0.1], [0, 0, 0, 1]])
    models = [moving(looks[look], "paper", seed=seed, colour_space=space)
              for seed, (look, space) in enumerate(zip((first, second), spaces))]
    parts = [(models[0], np.eye(4), 0.3), (models[1], placement, 0.8), (models[0], placement, 0.6)]
    _, want = agree(module, parts, camera(), drawn)
    alone = expected(module, parts[:1], camera())
    assert psnr(alone, want) < 30


@pytest.mark.parametrize("look", ["rgb", "sigmoid", "sigmoid premultiplied"])
def test_a_selection_is_blended_with_its_object(module, fg, moving, camera, drawn, look):
    """What is selected, refused or neither is one group, and looks as three would: a redraw costs what it costs without a selection."""
    files, pack = module("scene.snapshot"), module("fastgs_blender.rendering.masks").pack_mask
    model = moving(fg.RGB() if look == "rgb" else decoder(fg, look), temporal=fg.Always(), opacity=np.full(300, 4.0))
    x, own = model.position[:, 0], fg.ObjectSettings(exposure=0.3)
    kinds = {-1: x < np.quantile(x, 0.3), 0: (x >= np.quantile(x, 0.3)) & (x <= np.quantile(x, 0.6)), 1: x > np.quantile(x, 0.6)}
    looks = {0: own, 1: own.under(files.SELECTED), -1: own.under(files.REFUSED)}
    parts = [(model, np.eye(4), 0.3, replace(looks[mark], mask=pack(~kinds[mark]))) for mark in (0, 1, -1)]
    eye = camera()
    viewed = [module("fastgs_blender.rendering.instances").Instance(*part).viewed(eye) for part in parts]
    assert [each.settings.mark for each in viewed] == [0, 1, -1]
    assert len(module("engine.viewport.picture").grouped(viewed)[0]) == 1
    want, got, plain = expected(module, parts, eye), drawn(parts, eye), expected(module, [(model, np.eye(4), 0.3, own)], eye)
    assert psnr(got, want) >= (45 if look == "rgb" else 26) and psnr(plain, want) < 20
    np.testing.assert_allclose(got[..., 3], want[..., 3], atol=0.01)


def test_the_order_matters(module, fg, moving, camera, drawn):
    """Otherwise the tests above would prove nothing about sorting."""
    parts, eye = [(moving(fg.RGB(), temporal=fg.Always(), opacity=np.full(300, 3.0)), np.eye(4), 0.0)], camera()
    assert psnr(drawn(parts, eye, keep=lambda indices: indices[::-1]), expected(module, parts, eye)) < 30


def test_background_border_and_opacity(fg, moving, camera, drawn):
    parts, eye = [(moving(fg.RGB(), temporal=fg.Always()), np.eye(4), 0.0)], camera()
    plain = drawn(parts, eye)
    over = drawn(parts, eye, background=(0.1, 0.2, 0.3))
    np.testing.assert_allclose(over[..., :3], plain[..., :3] + (1 - plain[..., 3:]) * np.float32((0.1, 0.2, 0.3)), atol=HALF)
    assert (over[..., 3] == 1).all()
    np.testing.assert_allclose(drawn(parts, eye, opacity=0.25), 0.25 * plain, atol=HALF)
    dark = drawn(parts, eye, frame=(0.0, 0.5, 1.0, 1.0), outside=0.25)
    np.testing.assert_array_equal(dark[:60], plain[:60])
    np.testing.assert_array_equal(dark[60:, :, 3], plain[60:, :, 3])
    assert (dark[60:, :, :3].sum() < 0.25 * plain[60:, :, :3].sum())
    part = drawn(parts, eye, border=(0.25, 0.5, 0.5, 1.0))
    np.testing.assert_array_equal(part[:60, 40:80], plain[:60, 40:80])
    assert plain[60:].any() and not part[60:].any() and not part[:, :40].any() and not part[:, 80:].any()


@pytest.mark.parametrize("orthographic", [False, True])
def test_splats_behind_other_things_are_hidden(module, fg, moving, camera, drawn, orthographic):
    """A wall at z = 4 leaves of the cloud what lies before it, as if the rest were not there."""
    table, picture = module("fastgs_blender.kernels.gl.frame_table"), module("engine.viewport.picture")
    model, eye, wall = moving(fg.RGB(), temporal=fg.Always()), camera(orthographic), 4.0
    depths = table.Depths(0.0, 0.1) if orthographic else table.Depths(1.0, -0.1)
    at = 0.1 * wall if orthographic else 1 - 0.1 / wall
    depth = picture.SceneDepth(np.full((240, 320), at, np.float32), depths)
    z = model.position @ eye.world_to_camera[2, :3] + eye.world_to_camera[2, 3]
    before = model.take(z < wall)
    assert 50 < len(before) < 250
    assert psnr(drawn([(model, np.eye(4), 0.0)], eye, depth=depth), expected(module, [(before, np.eye(4), 0.0)], eye)) >= 45


@pytest.mark.parametrize("orthographic", [False, True])
def test_meshes_hide_splats_as_in_final_renders(module, fg, moving, camera, drawn, orthographic):
    """A slanted triangle through the cloud, which Blender does not draw under our engine: its depth comes from the CPU."""
    table, meshes = module("fastgs_blender.kernels.gl.frame_table"), module("engine.viewport.meshes")
    model, eye = moving(fg.RGB(), temporal=fg.Always()), camera(orthographic)
    corners = np.array([[-3, -2, 3.0], [3, -2, 4.5], [0.3, 0.6, 4.0]])  # before the camera
    to_world = np.linalg.inv(eye.world_to_camera)
    triangles = (corners @ to_world[:3, :3].T + to_world[:3, 3])[None].astype(np.float32)
    depth = meshes.scene_depth(triangles, eye, table.Depths(0.0, 0.1) if orthographic else table.Depths(1.0, -0.1))
    want = fg.render(model, eye, passes=("alpha", "holdout"), holdout=triangles)
    assert 0.1 < (want["holdout"] > 0).mean() < 0.9
    got = drawn([(model, np.eye(4), 0.0)], eye, depth=depth)[..., 3]
    assert psnr(got, want["alpha"]) >= 28 and psnr(got, fg.render(model, eye)["alpha"]) < 25
    assert meshes.scene_depth(triangles - 100 * to_world[:3, 2], eye, table.Depths(1.0, -0.1)) is None


def test_broken_numbers_are_not_drawn(module, fg, moving, camera, drawn):
    good = moving(fg.SH(1), temporal=fg.Always())
    bad = moving(fg.SH(1), temporal=fg.Always(), seed=1, n=20)
    bad.position[0, 1], bad.scale[1, 0], bad.opacity[2], bad.features[3, 5] = np.nan, np.inf, np.nan, np.nan
    bad.rotation[4] = 0
    both = fg.GaussianModel(**{name: np.concatenate([a, bad.arrays[name]]) for name, a in good.arrays.items()},
                            rotation_basis=good.rotation_basis, appearance=good.appearance)
    agree(module, [(both, np.eye(4), 0.0)], camera(), drawn)


def test_nothing_to_draw(fg, moving, camera, drawn):
    assert not drawn([], camera()).any()
    assert not drawn([(moving(fg.RGB(), n=0), np.eye(4), 0.0)], camera()).any()
    left = drawn([], camera(), background=(0.25, 0.5, 1.0), border=(0.0, 0.0, 0.5, 1.0))
    assert np.allclose(left[:, :SIZE[0] // 2], (0.25, 0.5, 1.0, 1.0)) and not left[:, SIZE[0] // 2:].any()
