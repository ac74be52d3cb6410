# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of bake(): even samples, the choice of an order, tangent frames."""
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_meshes import CUBE, CUBE_TRIANGLES, grid, sphere, turn

from fastgs_blender.model.fitting import SAFE, Fit, choose, motion_families, rotation_families
from fastgs_blender.model.motion import Cosine, Static
from fastgs_blender.surfaces.borders import distance_to_borders, find_borders
from fastgs_blender.surfaces.sampling import near_pairs, sample_surface
from fastgs_blender.surfaces.tangents import tangents


def places(points, triangles, samples):
    return np.einsum("nk,nkd->nd", samples.weights, points[triangles[samples.triangle]])


@given(st.integers(1, 300), st.sampled_from([(CUBE, CUBE_TRIANGLES), grid(1), grid(30), sphere(6)]))
def test_exactly_as_many_as_asked_for(count, mesh):
    samples = sample_surface(*mesh, count)
    assert len(samples) == count
    assert (samples.weights >= 0).all() and np.allclose(samples.weights.sum(1), 1)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [1, 12, 70])
def test_even_whatever_the_mesh(cells):
    """No two places nearer than half the spacing, no gap of 1.4 spacings, on coarse and fine meshes; random places have both."""
    points, triangles = grid(cells)
    samples = sample_surface(points, triangles, 2000)
    at = places(points, triangles, samples)[:, :2]
    distance = np.linalg.norm(at[:, None] - at[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    assert np.quantile(distance.min(1), 0.01) > 0.45 * samples.spacing
    probe = np.random.default_rng(1).random((4000, 2))
    assert np.linalg.norm(probe[:, None] - at[None], axis=-1).min(1).max() < 1.4 * samples.spacing


@pytest.mark.parametrize("sides", [(2, 1), (10, 1), (40, 1)])
def test_large_triangles_have_no_rows_of_gaps(sides):
    """A floor or a strip of two triangles is covered as evenly as a fine mesh."""
    points, triangles = grid(1)
    points = points * (*sides, 1)
    samples = sample_surface(points, triangles, 20_000)
    at = places(points, triangles, samples)
    probe = np.column_stack([np.random.default_rng(1).random((4000, 2)) * 0.9 + 0.05, np.zeros(4000)]) * (*sides, 1)
    i, j = near_pairs(probe, at, 2 * samples.spacing)
    gap = np.full(len(probe), np.inf)
    np.minimum.at(gap, i, np.linalg.norm(probe[i] - at[j], axis=1))
    assert np.quantile(gap, 0.99) < 0.83 * samples.spacing


def test_more_where_the_surface_is_stretched_later():
    points, triangles = grid(10)
    area = np.where(points[triangles].mean(1)[:, 0] < 0.5, 3.0, 1.0)
    samples = sample_surface(points, triangles, 4000, area)
    assert (places(points, triangles, samples)[:, 0] < 0.5).mean() == pytest.approx(0.75, abs=0.01)


def test_what_is_folded_up_gets_its_share():
    points, triangles = grid(10)
    folded = np.where(points[:, :1] < 0.45, points * [0, 1, 1], points)  # at this time the left part has no width
    areas = [0.5 * np.linalg.norm(np.cross(p[triangles][:, 1] - p[triangles][:, 0], p[triangles][:, 2] - p[triangles][:, 0]), axis=1)
             for p in (points, folded)]
    samples = sample_surface(folded, triangles, 3000, np.maximum(*areas))
    assert len(samples) == 3000
    left = (places(points, triangles, samples)[:, 0] < 0.4).mean()
    assert left == pytest.approx(np.maximum(*areas)[points[triangles].mean(1)[:, 0] < 0.4].sum() / np.maximum(*areas).sum(), abs=0.02)


@given(st.integers(0, 60), st.integers(1, 60), st.floats(0.05, 2.0))
def test_near_pairs_are_all_there(m, n, radius):
    rng = np.random.default_rng(m * 61 + n)
    a, b = rng.normal(size=(m + 1, 3)), rng.normal(size=(n, 3))
    truth = {(i, j) for i, j in zip(*np.nonzero(np.linalg.norm(a[:, None] - b, axis=-1) < radius), strict=True)}
    assert {(i, j) for i, j in zip(*near_pairs(a, b, radius), strict=True)} == truth


@given(st.integers(2, 80), st.sampled_from(["auto", "cosine", "fourier", "paper", "keyframes"]), st.integers(0, 12), st.integers(0, 9))
def test_the_order_stays_under_the_nyquist_limit(times, name, max_order, seed):
    """Also for noise, which no order describes."""
    t = np.arange(times) / times
    values = np.random.default_rng(seed).normal(size=(times, 5))

    def error(fit):
        return np.abs(fit(values)[1] - values).mean() / 1e-6

    basis = choose(motion_families(name, t), t, error, max_order)
    assert basis.terms <= max(SAFE * times, 1)
    assert max_order == 0 or getattr(basis, "order", 0) <= max_order
    assert choose(rotation_families(t), t, error, max_order).terms <= max(SAFE * times, 1)


@given(st.integers(1, 12), st.floats(-3, 3))
def test_the_least_order_is_found(order, level):
    t = np.linspace(0, 1, 60)
    values = level + np.cos(np.pi * order * t)[:, None]
    basis = choose(motion_families("cosine", t), t, lambda fit: np.abs(fit(values)[1] - values).max() / 1e-6)
    assert basis == Cosine(order, 1.0, 0.0)
    assert choose(motion_families("cosine", t), t, lambda fit: 0.0) == Static()


def test_coefficients_are_the_least_squares():
    rng = np.random.default_rng(0)
    t = np.sort(rng.random(40))
    values = rng.normal(size=(40, 3, 2))
    fit = Fit.of(Cosine(5), t)
    coefficients, fitted = fit(values)
    truth = np.linalg.lstsq(fit.design, values.reshape(40, -1), rcond=None)[0]
    assert np.allclose(coefficients.reshape(6, -1), truth)
    assert np.abs(np.einsum("sk,snd->knd", fit.design, fitted - values)).max() < 1e-9  # what is left is orthogonal


def test_frames_turn_with_their_triangle_without_jumps_of_sign():
    corner = np.array([[0, 0, 0], [1, 0.2, 0], [0.3, 1, 0]])
    found = tangents(np.stack([corner @ turn(a).T for a in np.linspace(0, 4 * np.pi, 81)])[:, None], 0)
    q = found.rotation[:, 0]
    assert (np.einsum("sd,sd->s", q[1:], q[:-1]) > 0.99).all()
    assert np.allclose(q[0], q[-1]) and np.allclose(q[0], -q[40])  # one turn is half a turn of the quaternion
    assert np.allclose(found.stretch, 1)


def test_x_lies_along_the_stretch():
    corner = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0]])
    squeeze = np.array([[1, 1, 1], [3, 0.5, 1]])
    found = tangents((corner * squeeze[:, None])[:, None], 0)
    assert np.allclose(found.stretch[0], [3, 1])
    assert np.allclose(np.abs(found.rotation[:, 0] @ [1, 0, 0, 0]), 1) or np.allclose(np.abs(found.rotation[:, 0, 3]), 1)


def test_a_triangle_without_area_keeps_its_last_frame():
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    shapes = np.stack([corner * 0, corner, corner @ turn(1).T, corner * 0, corner * 0])
    q = tangents(shapes[:, None], 2).rotation[:, 0]
    assert np.isfinite(q).all()
    assert np.allclose(q[0], q[1]) and np.allclose(q[3], q[2]) and np.allclose(q[4], q[2])


def test_borders_are_the_sharp_edges():
    none = np.zeros(12, int)
    borders = find_borders(CUBE, CUBE_TRIANGLES, none)
    assert len(borders.start) == 24  # twelve edges, each of two faces; the diagonals are none
    loose = CUBE[CUBE_TRIANGLES].reshape(-1, 3)  # every face with vertices of its own
    assert len(find_borders(loose, np.arange(36).reshape(-1, 3), none).start) == 24
    points, triangles = grid(4)
    assert len(find_borders(points, triangles, np.zeros(32, int)).start) == 16
    patch = (points[triangles].mean(1)[:, 0] > 0.5).astype(int)
    assert len(find_borders(points, triangles, patch).start) == 16 + 8


def test_distances_to_borders():
    borders = find_borders(*grid(1), np.zeros(2, int))
    at = np.array([[0.1, 0.45, 0], [0.5, 0.5, 0], [0.02, 0.07, 0], [0.1, 0.5, 3]])
    direction, distance = distance_to_borders(borders, at, np.tile([0, 0, 1.0], (4, 1)), 0.2)
    assert np.allclose(direction[0], [1, 0, 0]) and np.allclose(distance[0], [0.1, 0.2])
    assert not direction[1].any() and np.allclose(distance[1], 0.2)
    assert np.allclose(distance[2], [0.02, 0.07])
    assert not direction[3].any()
    assert not distance_to_borders(borders, at, np.tile([0, 0, -1.0], (4, 1)), 0.2)[0].any()  # the other side of a thin plate
