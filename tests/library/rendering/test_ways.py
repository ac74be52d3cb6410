# SPDX-License-Identifier: GPL-3.0-or-later
"""Which share of a lamp's light comes past splats and meshes to points."""
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fastgs_blender as fg
from fastgs_blender.kernels.cpu import passing
from fastgs_blender.kernels.cpu.reaching import NOWHERE
from fastgs_blender.rendering.instances import Instance
from fastgs_blender.rendering.shadow import Light
from fastgs_blender.rendering.ways import Side, Ways, view_from
from fastgs_blender.util.backends import load_backend
from fastgs_blender.util.rotations import to_matrices, unit

OPACITY = 0.4


def veil(depth=2.0, opacity=OPACITY, flat=1e-3, turn=(1.0, 0, 0, 0)):
    """One large Gaussian on the way of light along z, of the same alpha all over what the tests look at."""
    return fg.GaussianModel(position=[[0, 0, depth]], rotation=[turn], scale=np.log([[40, 40, flat]]), features=[[0, 0, 0]],
                            opacity=[np.log(opacity / (1 - opacity))])


def past(models, points, light, meshes=None, backend="cpu", size=256, **over):
    """The shares of the light that come past meshes and splats to points, of each point of a lamp the mean."""
    ways = Ways(load_backend(backend), [Instance(model, np.eye(4), 0.0) for model in models], meshes)
    points, found = np.asarray(points, np.float64), np.zeros((2, len(points)))
    sides = ways.sides(light, points.T)
    for k in range(len(light.points)):
        found += np.array(sides.past(k, points.T[:, None], size, **over)) / len(light.points)
    return found


SUN, LAMP = Light.sun((0, 0, -1)), Light([[0.0, 0, 0]])


@pytest.mark.parametrize("light", [SUN, LAMP])
@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_veils_take_their_share_of_the_light_each(light, backend):
    """A translucent splat leaves 1 - alpha; two leave the product; what lies before them keeps all."""
    points = [[0.1, 0, 1.0], [0.1, 0, 2.5], [0.0, 0.1, 4.0]]
    _, splats = past([veil(2.0), veil(3.0)], points, light, backend=backend)
    assert np.allclose(splats, [1, 1 - OPACITY, (1 - OPACITY) ** 2], atol=2e-3)


@pytest.mark.parametrize("angle", [0.0, 0.8, 1.3])
def test_a_flat_surface_does_not_shade_itself(angle):
    """Whatever its angle to the light: places on a wide disc, and its neighbours in the same plane, lie in the light."""
    turn = np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0])
    along = np.array([0, np.cos(angle), np.sin(angle)])
    disc = replace(veil(5.0, 0.99, 1e-4, turn), scale=np.log(np.float32([[0.3, 0.3, 1e-4]])))
    other = replace(disc, position=np.float32([[0, 0, 5] + 0.2 * along]))
    points = np.array([[0, 0, 5] + s * along + [x, 0, 0] for s in (-0.2, 0, 0.2) for x in (-0.1, 0, 0.1)])
    assert past([disc, other], points, LAMP, over_splats=0.02)[1].min() > 0.99
    assert past([disc, other], points + [0, 0, 1], LAMP, over_splats=0.02)[1].min() < 0.1


@given(x=st.floats(-2, 2), y=st.floats(-2, 2), z=st.floats(1.5, 4), parallel=st.booleans())
@settings(max_examples=40, deadline=None)
def test_triangles_stop_light_where_the_ray_meets_them(x, y, z, parallel):
    """Against the intersection of a ray and a triangle in space."""
    corners = np.float32([[-1.03, -0.97, 2], [1.21, -0.8, 2.5], [0.05, 1.1, 1.5]])
    point = np.array([x, y, z])
    direction = np.array([0, 0, 1.0]) if parallel else point
    start = point - 10 * direction if parallel else np.zeros(3)
    u, v = corners[1] - corners[0], corners[2] - corners[0]
    s, a, b = np.linalg.solve(np.stack([direction, -u, -v], 1).astype(float), corners[0] - start)
    reach = (10 - s) if parallel else (1 - s)
    inside = min(a, b, 1 - a - b)
    if min(abs(inside), abs(reach)) < 1e-3:
        return
    expected = 0 if inside > 0 and s > 0 and reach > 0 else 1
    for backend in ("cpu", "reference"):
        assert past([], [point, [0, 0, 9.0]], SUN if parallel else LAMP, corners[None], backend)[0][0] == expected


@pytest.mark.parametrize("radius", [0.0, 0.4])
def test_a_side_of_the_cube_has_all_that_throws_shadows_there(radius):
    """Around a lamp among large and small Gaussians and triangles, which move: what a side leaves out shades none of its points."""
    rng = np.random.default_rng(7)
    n, backend = 2000, load_backend("cpu")
    model = fg.GaussianModel(position=rng.uniform(-3, 3, (n, 3)), rotation=rng.normal(size=(n, 4)), opacity=rng.normal(0, 2, n),
                             scale=rng.uniform(-5, -2, (n, 3)), features=np.zeros((n, 3)))
    corners = (rng.uniform(-3, 3, (60, 1, 3)) + rng.uniform(-0.3, 0.3, (60, 3, 3))).astype(np.float32)
    moments = [corners, corners + np.float32([0.5, 0, -0.2])]
    ways = Ways(backend, [Instance(model, np.eye(4), 0.0)], None, moments=moments)
    light = Light(radius * rng.uniform(-1, 1, (4, 3)) / 2 + 0.1, times=np.array([0, 0.3, 0.7, 1]))
    points = rng.uniform(-2.5, 2.5, (3, 400))
    if not radius:
        points[:, 0] = 0.1  # where the lamp is
    places = points[:, None] + rng.normal(size=(3, 2, 400)) * np.where(np.arange(400) % 40, 0.05, 2.0)  # some of them far from the point
    sides = ways.sides(light, points, np.linalg.norm(places - points[:, None], axis=0).max(0))
    for k in range(4):
        mine, whole = (each.past(k, places, 256) for each in (sides, replace(sides, found=dict.fromkeys(range(6), Side(
            ways.instances, ways.moments)))))
        assert np.array_equal(mine[0], whole[0])
        assert np.abs(mine[1] - whole[1]).max() < 1e-3
    assert len(sides.found) == 6
    assert all(len(side.instances[0].model) < 0.6 * n and len(side.moments[0]) < 40 for side in sides.found.values())


def test_kernels_agree_with_the_oracle():
    """Many splats from a lamp among them, which looks through all sides of a cube, and from a sun."""
    rng = np.random.default_rng(3)
    n = 300
    model = fg.GaussianModel(position=rng.uniform(-2, 2, (n, 3)), rotation=rng.normal(size=(n, 4)), opacity=rng.normal(0, 2, n),
                             scale=rng.uniform(-3.5, -1.5, (n, 3)), features=np.zeros((n, 3)))
    points = rng.uniform(-2.5, 2.5, (200, 3))
    meshes = rng.uniform(-2, 2, (5, 3, 3)).astype(np.float32)
    for light in (Light([[0.1, 0.2, 0.0]]), Light.sun((1, 2, 3))):
        cpu, oracle = (past([model], points, light, meshes, backend) for backend in ("cpu", "reference"))
        assert np.array_equal(cpu[0], oracle[0])
        assert np.abs(cpu[1] - oracle[1]).mean() < 2e-3 and np.mean(np.abs(cpu[1] - oracle[1]) > 0.02) < 0.02


@given(seed=st.integers(0, 10_000), parallel=st.booleans())
@settings(max_examples=15, deadline=None)
def test_what_lies_beside_all_points_or_behind_them_is_left_out_and_changes_nothing(seed, parallel):
    """Points in a few heaps among splats, large ones and small: with all splats, and with those that may lie before a point."""
    rng = np.random.default_rng(seed)
    n = 400
    model = fg.GaussianModel(position=rng.uniform([-3, -3, 0.5], [3, 3, 6], (n, 3)), rotation=rng.normal(size=(n, 4)),
                             opacity=rng.normal(0, 2, n), features=np.zeros((n, 3)),
                             scale=rng.uniform(-5, -2, (n, 3)) + 2 * (rng.random((n, 1)) < 0.1))
    heaps = rng.uniform([-2, -2, 2], [2, 2, 5], (4, 3))
    points = (heaps[rng.integers(0, 4, 300)] + 0.1 * rng.normal(size=(300, 3))).T
    light = SUN if parallel else LAMP
    eye = view_from(parallel, light.points[0], points, points.T, 512, load_backend("cpu"))
    viewed = [Instance(model, np.eye(4), 0.0).viewed(eye)]
    few, sizes = passing.past_splats(viewed, eye, points, np.zeros(300)), []
    with pytest.MonkeyPatch.context() as patch:
        def projected(*args, cells, whole=passing.project_instances):
            sizes.extend(len(whole(*args, cells=each).index) for each in (cells, NOWHERE))
            return whole(*args, cells=NOWHERE)

        patch.setattr(passing, "project_instances", projected)
        every = passing.past_splats(viewed, eye, points, np.zeros(300))
    assert sizes[0] < sizes[1]
    assert np.abs(few - every).max() < 1e-5


def along_rays(model, start, points):
    """The share of light that comes from a place past Gaussians to points, from each one's highest density along the ray."""
    turn = to_matrices(unit(model.rotation.astype(float)))
    whiten = (turn / np.exp(model.scale.astype(float))[:, None]).transpose(0, 2, 1)
    opacity, left = 1 / (1 + np.exp(-model.opacity.astype(float))), []
    from_start = model.position - start
    for towards in points - start:
        a, b = np.einsum("nij,nj->ni", whiten, from_start), whiten @ towards
        far = (a * b).sum(1) / (b * b).sum(1)
        alpha = np.minimum(opacity * np.exp(-0.5 * (np.cross(a, b) ** 2).sum(1) / (b * b).sum(1)), 0.99)
        centre = from_start @ towards / (towards @ towards)
        left.append(np.prod(1 - alpha[(alpha > 1 / 255) & (far > 0) & (np.maximum(far, centre) < 1)]))
    return np.array(left)


def test_places_far_away_do_not_turn_the_picture_from_the_others():
    """From a lamp at a wall: places in the room get what comes along their rays, whatever a few Gaussians of a backdrop's size ask for."""
    rng = np.random.default_rng(11)
    n = 600
    model = fg.GaussianModel(position=rng.uniform([-2, -2, 2], [2, 2, 5], (n, 3)), rotation=rng.normal(size=(n, 4)),
                             opacity=rng.normal(0, 1, n), scale=rng.uniform(-4, -1.2, (n, 3)), features=np.zeros((n, 3)))
    points = rng.uniform([-2, -2, 3], [2, 2, 5], (500, 3))
    places = points + rng.normal(size=(500, 3)) * np.where(np.arange(500) % 50, 0, 30.0 * 10 ** (np.arange(500) / 25))[:, None]
    ways = Ways(load_backend("cpu"), [Instance(model, np.eye(4), 0.0)], None)
    sides = ways.sides(LAMP, points.T, np.linalg.norm(places - points, axis=1))
    error = (sides.past(0, places.T[:, None], 512)[1] - along_rays(model, np.zeros(3), places))[np.arange(500) % 50 > 0]
    assert np.sqrt((error**2).mean()) < 0.05


@pytest.mark.parametrize(("light", "far"), [(SUN, 3000.0), (LAMP, 8.0)])
def test_a_few_points_far_away_do_not_blur_the_shadows_of_the_others(light, far):
    """Most points lie close together, below small discs: they take the light that they take alone."""
    rng = np.random.default_rng(4)
    places = np.concatenate([rng.uniform(-0.02, 0.02, (200, 2)), np.full((200, 1), 2.0)], 1)
    discs = fg.GaussianModel(position=places, rotation=np.tile([1.0, 0, 0, 0], (200, 1)), features=np.zeros((200, 3)),
                             scale=np.log(np.tile([8e-4, 8e-4, 1e-5], (200, 1))), opacity=np.full(200, 3.0))
    points = np.concatenate([rng.uniform(-0.03, 0.03, (2000, 2)), np.full((2000, 1), 3.0)], 1)
    alone = past([discs], points, light)[1]
    among = past([discs], np.concatenate([points, [[far, 0, 3.0], [0, far, 3.0]]]), light)[1]
    assert 0.1 < alone.mean() < 0.95 and alone.min() < 0.1
    assert np.allclose(among[:2000], alone, atol=0.02) and (among[2000:] > 0.99).all()


@pytest.mark.parametrize("light", [SUN, LAMP])
def test_splats_smaller_than_pixels_hide_as_much_as_in_a_fine_picture(light):
    rng = np.random.default_rng(5)
    places = np.concatenate([rng.uniform(-1, 1, (3000, 2)), np.full((3000, 1), 2.0)], 1)
    discs = fg.GaussianModel(position=places, rotation=np.tile([1.0, 0, 0, 0], (3000, 1)), features=np.zeros((3000, 3)),
                             scale=np.log(np.tile([0.006, 0.006, 1e-4], (3000, 1))), opacity=np.full(3000, 3.0))
    points = np.concatenate([rng.uniform(-1, 1, (2000, 2)), np.full((2000, 1), 3.0)], 1)
    coarse, fine = (past([discs], points, light, size=size)[1].mean() for size in (128, 4096))
    assert fine < 0.95 and abs(coarse - fine) < 0.02


@given(st.integers(0, 2**31), st.booleans())
@settings(max_examples=60, deadline=None)
def test_triangles_beside_a_picture_throw_no_shadow_in_it(seed, parallel):
    """Where Side.throws() says no, no point that the picture shows has any of them before it; and it does say so."""
    rng = np.random.default_rng(seed)
    triangles = (rng.normal(size=3) * 3 + rng.normal(size=(4, 3, 3)) * 0.5).astype(np.float32)
    eye = fg.Camera(64, 48, 60, 60, 32, 24, np.eye(4), orthographic=parallel, far=9.0)
    points = np.stack(np.meshgrid(*[np.linspace(-4, 4, 9)] * 2, np.linspace(0.5, 8.5, 5)), -1).reshape(-1, 3)
    pixels = eye.pixels(points)
    points = points[((pixels >= 0) & (pixels <= [64, 48])).all(1)].T.copy()
    told = load_backend("cpu").past_triangles(triangles, eye, points, np.zeros(points.shape[1]))
    assert Side([], [triangles]).throws(eye) or (told == 1).all()
    assert not Side([], [triangles * np.float32(0.01) - np.float32([9, 0, 0])]).throws(eye) and not Side([], []).throws(eye)
