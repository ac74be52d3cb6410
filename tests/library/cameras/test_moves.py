# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera moves: they pass through their cameras, and position, direction and speed are smooth."""
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fastgs_blender as fg
from fastgs_blender.cameras import moves
from fastgs_blender.util import rotations

S = np.linspace(0, 1, 1201)


def poses(rng, count):
    """Cameras around a middle, at uneven distances and heights, that turn by less than a right angle from one to the next."""
    steps = np.concatenate([rng.normal(size=(count, 3)) * 0.3, np.ones((count, 1))], 1)[:, [3, 0, 1, 2]]
    q = [np.array([1.0, 0, 0, 0])]
    for step in steps[1:]:
        q.append(rotations.multiply(q[-1], step / np.linalg.norm(step)))
    angle = np.cumsum(rng.uniform(0.5, 1.0, count)) * 5 / count
    position = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.cos(2 * angle)], -1) * rng.uniform(3, 4, (count, 1))
    return moves.Path(position, np.array(q), rng.uniform(20, 80, count))


def largest_jump(values) -> float:
    """The largest change of a sampled curve's slope from one step to the next, by its largest slope."""
    slope = np.diff(values, axis=0)
    return np.abs(np.diff(slope, axis=0)).max() / max(np.abs(slope).max(), 1e-12)


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(3, 9), closed=st.booleans())
def test_a_spline_passes_its_cameras_at_even_speed_and_never_jumps(seed, count, closed):
    given = poses(np.random.default_rng(seed), count)
    path = moves.through(S, given, closed)
    for position, rotation, focal in zip(given.position, given.rotation, given.focal):
        nearest = np.linalg.norm(path.position - position, axis=1).argmin()
        spacing = np.linalg.norm(np.diff(path.position, axis=0), axis=1).max()
        assert np.linalg.norm(path.position[nearest] - position) <= 0.51 * spacing + 1e-9
        assert abs(path.rotation[nearest] @ rotation) > 1 - 1e-3 and abs(path.focal[nearest] / focal - 1) < 0.1
    speed = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
    assert speed.max() / speed.min() < 1.2
    np.testing.assert_allclose(np.linalg.norm(path.rotation, axis=1), 1, atol=1e-12)
    assert ((path.rotation[1:] * path.rotation[:-1]).sum(1) > 0.9).all()
    assert largest_jump(path.position) < 0.35 and largest_jump(path.rotation) < 0.35
    if closed:
        np.testing.assert_allclose(path.position[0], path.position[-1], atol=1e-9)


def test_between_two_cameras_it_is_the_straight_line_and_the_slerp(rng):
    given = poses(rng, 2)
    path = moves.through(S, given)
    np.testing.assert_allclose(path.position, given.position[0] + S[:, None] * (given.position[1] - given.position[0]), atol=1e-9)
    angle = np.arccos(np.clip(given.rotation[0] @ given.rotation[1], -1, 1))
    wanted = (np.sin((1 - S) * angle)[:, None] * given.rotation[0] + np.sin(S * angle)[:, None] * given.rotation[1]) / np.sin(angle)
    np.testing.assert_allclose(path.rotation, wanted, atol=1e-9)


def test_one_camera_is_no_path(rng):
    with pytest.raises(fg.FastGSError, match="two cameras"):
        moves.through(S, poses(rng, 1))
    with pytest.raises(fg.FastGSError, match="three cameras"):
        moves.through(S, poses(rng, 2), closed=True)


@pytest.mark.parametrize("elevation", [0.0, 0.5, np.pi / 2, -np.pi / 2])
def test_an_orbit_looks_at_its_centre_and_keeps_its_distance(elevation):
    centre = np.array([1.0, -2.0, 3.0])
    path = moves.orbit(S, centre, 4.0, elevation, 0.3, -1.5, 35.0)
    np.testing.assert_allclose(np.linalg.norm(path.position - centre, axis=1), 4)
    matrices = rotations.to_matrices(path.rotation)
    np.testing.assert_allclose(-matrices[:, :, 2], (centre - path.position) / 4, atol=1e-9)
    np.testing.assert_allclose(matrices[:, 2, 0], 0, atol=1e-9)  # level: the picture's x axis lies in the ground plane
    assert largest_jump(path.position) < 0.05 and largest_jump(path.rotation) < 0.05


def test_a_dolly_zoom_keeps_its_subjects_size(rng):
    path = moves.dolly(S, [0, 0, 0], [1, 0, 0, 0], [0, 0, -2.0], 3.0, 50.0, subject=5.0)
    np.testing.assert_allclose(path.focal / (5 + path.position[:, 2]), 10)
    with pytest.raises(fg.FastGSError, match="dolly zoom"):
        moves.dolly(S, [0, 0, 0], [1, 0, 0, 0], [0, 0, -1.0], 5.0, 50.0, subject=5.0)


@pytest.mark.parametrize("amount", [0.0, 0.3, 1.0])
def test_an_ease_begins_and_ends_at_rest_and_arrives(amount):
    way = moves.ease(S, amount)
    assert way[0] == 0 and abs(way[-1] - 1) < 1e-12 and (np.diff(way) >= 0).all()
    speed = np.diff(way)
    assert np.abs(np.diff(speed)).max() < 0.02 * speed.max()
    assert amount == 0 or speed[0] < 0.02 * speed.max() > speed[-1]


def test_the_region_is_the_hull_of_the_cameras_and_a_margin(rng):
    cube = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T.astype(float)
    points = np.array([[0, 0, 0], [1.05, 0, 0], [1.3, 0, 0], [3.0, 3.0, 3.0]])
    path = moves.Path(points, np.tile([1.0, 0, 0, 0], (4, 1)), np.ones(4))
    beyond = moves.inside(path, cube, 0.1)
    assert beyond[0] == beyond[1] == 0 and np.allclose(beyond[2:], (0.2, np.sqrt(12) - 0.1), atol=2e-3)
    held = moves.clamp_to_hull(path, cube, 0.1)
    np.testing.assert_allclose(held.position[:2], points[:2])
    np.testing.assert_allclose(held.position[2:], [[1.1, 0, 0], np.full(3, 1 + 0.1 / np.sqrt(3))], atol=2e-3)
    flat = cube[cube[:, 2] > 0]  # an arc or a wall of cameras spans a region too
    np.testing.assert_allclose(moves.inside(path, flat, 0.1)[:2], (0.9, np.hypot(0.05, 1) - 0.1), atol=2e-3)


@pytest.mark.parametrize("closed", [False, True])
def test_cameras_are_visited_by_their_places(closed):
    """Of a ring and of a grid in any order: neighbours come after each other, from the first on."""
    rng = np.random.default_rng(3)
    angle = 2 * np.pi * np.arange(23) / (23 if closed else 30)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.cos(5 * angle)], -1)
    mixed = rng.permutation(len(ring))
    first = int(np.flatnonzero(mixed == 0)[0])
    order = mixed[moves.order_by_place(ring[mixed], closed, first)]
    assert order[0] == 0 and set(np.abs(np.diff(order))) <= ({1, 22} if closed else {1})
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(5.0), [0.0]), -1).reshape(-1, 3)[rng.permutation(20)]
    way = grid[moves.order_by_place(grid, closed)]
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() < 19 * 1.2
    assert list(moves.order_by_place(np.zeros((4, 3)), closed)) == [0, 1, 2, 3], "of the same place, as they were"
