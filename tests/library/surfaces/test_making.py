# SPDX-License-Identifier: GPL-3.0-or-later
"""make_mesh(): the surface of a baked mesh, on all frames, is that of the mesh it was baked from."""
from dataclasses import replace

import numpy as np
import pytest
from moving_meshes import distances, sphere, swimming, twisting, walking, waving

import fastgs_blender as fg
from fastgs_blender.cameras.viewpoints import viewpoint_of
from fastgs_blender.model.filmed_from import directions
from fastgs_blender.surfaces.making import make_mesh as make
from fastgs_blender.surfaces.nets import surface_net
from fastgs_blender.surfaces.quads import Mesh

FRAMES = 12


def baked(shape, count=6000, **options):
    frames = np.arange(0, FRAMES - 0.5, 0.5)
    options.setdefault("colours", (0.8, 0.3, 0.2))
    positions = np.stack([shape(f / FRAMES)[0] for f in frames])
    return fg.bake(positions, shape(0)[1], frames=frames, frame_count=FRAMES, count=count, **options)[0]


def off(mesh, shape, t):
    """Mean distances, as shares of the size, at a time: of some of a mesh's vertices from the true surface, and the other way round."""
    points, triangles = shape(t)
    size = np.ptp(points, axis=0).max()
    made = mesh.at(t)
    faces = np.concatenate([made[mesh.quads[:, [0, 1, 2]]], made[mesh.quads[:, [0, 2, 3]]]])
    return distances(made[::25], points[triangles]).mean() / size, distances(points[::17], faces).mean() / size


@pytest.mark.slow
@pytest.mark.parametrize("shape", [twisting, swimming, walking, waving])
def test_one_topology_follows_all_frames_and_sub_frames(shape):
    mesh, = make(baked(shape), 0.25, detail=56)
    assert mesh.times[0] == 0 and mesh.times[-1] == 11 / 12 and mesh.made == 0.25
    assert mesh.at(0.25) == pytest.approx(mesh.rest, abs=3e-3)
    for t in (0, 3.25 / 12, 0.5, 8.75 / 12, 11 / 12):
        there, back = off(mesh, shape, t)
        assert there < 0.005 and back < 0.007
    assert mesh.colours == pytest.approx(np.broadcast_to([0.8, 0.3, 0.2], mesh.colours.shape), abs=0.01)


def test_a_closed_surface_has_an_inside():
    """Every edge belongs to as many faces one way round as the other, and the normals point outwards."""
    mesh, = make(baked(lambda t: sphere(20), 3000), detail=32)
    ahead = np.stack([mesh.quads, np.roll(mesh.quads, -1, 1)], -1).reshape(-1, 2)
    assert sorted(map(tuple, ahead)) == sorted(map(tuple, ahead[:, ::-1]))
    corners = mesh.rest[mesh.quads]
    assert (np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) * corners.mean(1)).sum() > 0
    assert len(mesh.shapes) == 0 and np.linalg.norm(mesh.at(0.7), axis=1) == pytest.approx(1, abs=0.06)


def edges(mesh):
    """The sides of all quads [4 Q, 2], the lesser vertex first."""
    return np.sort(np.stack([mesh.quads, np.roll(mesh.quads, -1, 1)], -1).reshape(-1, 2), 1)


def test_floaters_are_left_out():
    model = baked(lambda t: sphere(20), 3000)
    speck = np.zeros(30, int)
    position = np.random.default_rng(0).normal(size=(30, 3)) * 0.02 + [1.6, 0, 0]
    floater = replace(model.take(speck), position=position, scale=np.full((30, 3), np.log(0.01)))
    both = fg.concatenate([model, floater])
    mesh, = make(both, detail=32)
    assert np.abs(mesh.rest).max() < 1.1


def test_the_open_surface_is_what_cameras_faced():
    model = baked(lambda t: sphere(20), 3000)
    view = fg.Viewpoint(width=64, height=64, fx=64, fy=64, cx=32, cy=32, position=(0, 0, -4), distance=4)
    mesh, = make(replace(model, surroundings=fg.Surroundings(cameras=(view,))), detail=32, closed=False)
    assert mesh.rest[:, 2].max() < 0.0 and mesh.rest[:, 2].min() < -0.95


def one_sided(count=4000):
    """A ball that moves, before five cameras of one side: nobody knows its back, so whatever lies there is of the training's making."""
    model = baked(lambda t: (sphere(24)[0] + [0.6 * t, 0, 0], sphere(24)[1]), count)
    front, rng = model.take(np.flatnonzero(model.position[:, 2] < 0.15)), np.random.default_rng(3)
    junk = front.take(rng.integers(0, len(front), count // 4))
    place = rng.uniform(-1, 1, (len(junk), 3)) * [0.5, 0.5, 0.5] + [0, 0, 0.5]
    junk = replace(junk, position=place, scale=rng.normal(size=(len(junk), 3)) * 0.4 - 3)
    views = []
    for angle in np.radians([-30, -15, 0, 15, 30]):
        pose = np.array([[np.cos(angle), 0, np.sin(angle), 0], [0, 1, 0, 0], [-np.sin(angle), 0, np.cos(angle), 4.0], [0, 0, 0, 1]])
        views.append(viewpoint_of(fg.Camera(64, 64, 64, 64, 32, 32, pose), distance=4))
    return replace(fg.concatenate([front, junk]), surroundings=fg.Surroundings(cameras=tuple(views)), provenance={})


def test_what_was_filmed_from_one_side_is_one_open_piece_without_holes():
    mesh, = make(one_sided(), detail=40)
    assert not mesh.closed and mesh.times[-1] == 11 / 12
    assert len(np.unique(Mesh.of(mesh.quads, len(mesh.rest)).pieces())) == 1
    sides, count = np.unique(edges(mesh), axis=0, return_counts=True)
    border = sides[count == 1]
    assert len(mesh.rest) - len(sides) + len(mesh.quads) == 1 and len(np.unique(border)) == len(border)  # a disc: no hole, one outline
    for t in (0, 11 / 12):
        place = mesh.at(t) - [0.6 * t, 0, 0]
        assert np.linalg.norm(place, axis=1) == pytest.approx(1, abs=0.06)
        towards = place / np.linalg.norm(place, axis=1, keepdims=True)
        facing = directions(200)
        facing = facing[facing[:, 2] < -0.3]
        assert (facing @ towards.T).max(1).min() > 0.995


def test_a_baked_mesh_has_all_of_its_sides():
    model = one_sided()
    mesh = make(replace(model, provenance={"source": "baked mesh"}), detail=16)[0]
    assert mesh.closed and make(model, detail=16, closed=True)[0].closed


def test_gaussians_that_fade_hand_over():
    """Half of the Gaussians live in the first half of the clip, the others in the second: the mesh is still one."""
    model = baked(swimming, 12_000)
    windows = np.tile([-1.0, 0.55, -6.0, -6.0], (len(model), 1))
    windows[::2, :2] = 0.45, 2.0
    mesh, = make(replace(model, temporal_kind=fg.Window(), temporal=windows), 0.1, detail=56)
    assert mesh.times[-1] == 11 / 12
    for t in (0.1, 0.7, 11 / 12):
        assert off(mesh, swimming, t)[0] < 0.005


@pytest.mark.parametrize("border", [0.0, 0.85])
def test_it_is_made_anew_where_it_tears(border):
    """A ball's half, or its cap, leaves it: from then on other meshes take over, each of which has faces of the usual size."""
    points, triangles = sphere(24)

    def parting(t):
        return points + np.sign(points[:, :1] - border) * [max(0.0, 2 * t - 0.8), 0, 0], triangles

    meshes = make(baked(parting, 5000), 0.0, detail=40)
    assert len(meshes) > 1
    times = np.concatenate([mesh.times for mesh in meshes])
    assert (np.diff(times) > 0).all() and times[0] == 0 and times[-1] == 11 / 12
    last = meshes[-1].at(11 / 12)
    faces = last[meshes[-1].quads]
    assert np.linalg.norm(faces[:, 2] - faces[:, 0], axis=1).max() < 0.3


def test_same_inputs_same_bytes():
    model = baked(twisting, 2000)
    first, second = (make(model, 0.25, detail=24)[0] for _ in range(2))
    assert all(np.array_equal(getattr(first, name), getattr(second, name)) for name in ("quads", "rest", "shapes", "curves", "colours"))


def test_wrong_arguments(tmp_path):
    model = baked(lambda t: sphere(12), 500)
    with pytest.raises(fg.FastGSError, match="detail"):
        make(model, detail=2)
    with pytest.raises(fg.FastGSError, match="nothing is there"):
        make(replace(model, opacity=np.full(len(model), -9)))
    with pytest.raises(fg.FastGSError, match="mesh.*model"):
        make(tmp_path)


def test_progress_can_stop_it():
    def stop(share):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        make(baked(lambda t: sphere(12), 500), detail=16, progress=stop)


def test_the_net_lies_where_the_volume_is_zero():
    grid = np.stack(np.meshgrid(*[np.linspace(-1.2, 1.2, 25)] * 3, indexing="ij"), -1)
    vertices, quads = surface_net((np.linalg.norm(grid, axis=-1) - 1).astype(np.float32))
    assert np.linalg.norm(vertices * 0.1 - 1.2, axis=1) == pytest.approx(1, abs=0.01)
    assert len(vertices) - 2 * len(quads) + len(quads) == 2  # Euler: a sphere
