# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of 4DGS real-time and Hybrid 3D-4DGS against their own formulas: covariances, means, opacities and colours at any time.

Transcribed from fudan-zvg/4d-gaussian-splatting@63725f2: diff-gaussian-rasterization/cuda_rasterizer/forward.cu, computeCov3D_conditional,
lines 279-351, and what stands for it without rot_4d, 427-437; computeColorFromSH_4D, 73-184 (temporal bands inside of the third); the
activations of scene/gaussian_model.py, 52-59 and 187-217: quaternions are normalised before the kernel, which does not; capture(), 99-137.
frame_ratio: train.py, 40, and scene/dataset_readers.py, 226.  The hybrid is ohsngjun/3D-4DGS@9528828: scene/gaussian_model.py, capture(),
106-151, and get_static_rotation, 265; opa_threshold: forward.cu, 434.  Both save as torch.save((gaussians.capture(), iteration)).
"""
from __future__ import annotations

import mutations
import numpy as np
import pytest
import torch
from evaluated import colours, directions, kernel_covariance, spherical, unit

import fastgs_blender as fg

N, D = 10, 10.0


def raw(rng, terms=48) -> dict[str, np.ndarray]:
    arrays = {"xyz": rng.normal(size=(N, 3)), "dc": rng.normal(size=(N, 1, 3)), "rest": rng.normal(0, 0.2, (N, terms - 1, 3)),
              "scaling": rng.normal(-1, 0.6, (N, 3)), "rotation": rng.normal(size=(N, 4)), "opacity": rng.normal(1, 1, (N, 1)),
              "t": rng.uniform(0, 10, (N, 1)), "scaling_t": rng.normal(0, 0.7, (N, 1)), "rotation_r": rng.normal(size=(N, 4))}
    arrays["t"][0] = 9.9
    return {key: value.astype(np.float32) for key, value in arrays.items()}


def saved(path, a, rot_4d=True, degree_t=2, static=None, env=(0,), degree=3):
    p = {key: torch.nn.Parameter(torch.tensor(value)) for key, value in a.items()}
    optimiser = {"state": {0: {"step": torch.tensor(1.0), "exp_avg": torch.zeros(N, 3)}},
                 "param_groups": [{"lr": 1e-4, "name": "xyz", "betas": (0.9, 0.999), "params": [0]}]}
    training = [torch.zeros(N), torch.zeros(N, 1), torch.zeros(N, 1), torch.zeros(N, 1), optimiser, np.float64(5.3)]
    values = [degree, p["xyz"], p["dc"], p["rest"], p["scaling"], p["rotation"], p["opacity"], *training,
              p["t"], p["scaling_t"], p["rotation_r"], rot_4d, torch.zeros(env), degree_t]
    if static is not None:
        s = {key: torch.nn.Parameter(torch.tensor(value)) for key, value in static.items()}
        values += [s[key] for key in ("xyz", "dc", "rest", "scaling", "rotation", "opacity")] + [torch.zeros(N)] * 3
    torch.save((tuple(values), 30000), path)


def turn_4d(left, right):
    """R^T of the kernel, lines 312-327, of one Gaussian; glm's matrices are written column by column."""
    (a, b, c, d), (p, q, r, s) = unit(left), unit(right)
    m_l = np.array([[a, b, -c, d], [-b, a, d, c], [c, -d, a, b], [-d, -c, -b, a]]).T
    m_r = np.array([[p, q, -r, -s], [-q, p, s, -r], [r, -s, p, -q], [s, r, q, p]]).T
    return (m_r @ m_l).T


def expected(a, time, rot_4d=True, degree_t=2, prefilter_var=-1.0, threshold=0.05):
    """Mean, covariance, opacity and colour of each Gaussian at a time in seconds."""
    a = {key: value.astype(np.float64) for key, value in a.items()}
    out = []
    for i in range(N):
        t, delta = a["t"][i, 0], time - a["t"][i, 0]
        if rot_4d:
            spread = turn_4d(a["rotation"][i], a["rotation_r"][i]) @ np.diag(np.exp(np.append(a["scaling"][i], a["scaling_t"][i])))
            sigma = spread @ spread.T
            variance, mean = sigma[3, 3], a["xyz"][i] + sigma[:3, 3] / sigma[3, 3] * delta
            covariance = sigma[:3, :3] - np.outer(sigma[:3, 3], sigma[3, :3]) / sigma[3, 3]
        else:
            variance, mean = np.exp(a["scaling_t"][i, 0]), a["xyz"][i]
            covariance = kernel_covariance(np.exp(a["scaling"][i:i + 1]), unit(a["rotation"][i:i + 1]))[0]
        marginal = np.exp(-0.5 * delta**2 / (prefilter_var + variance if prefilter_var > 0 else variance))
        coefficients = np.concatenate([a["dc"][i], a["rest"][i]])
        sh = sum(np.cos(2 * np.pi * k * (t - time) / D) * coefficients[16 * k:16 * k + 16] for k in range(degree_t + 1))
        out.append((mean, covariance, marginal * (marginal > threshold) / (1 + np.exp(-a["opacity"][i, 0])), sh))
    mean, covariance, opacity, sh = (np.array(v) for v in zip(*out))
    return mean, covariance, opacity, spherical(directions(N), sh)


def compare(model, time, told):
    mean, covariance, opacity, colour = told
    s = fg.slice_model(model, time / D, cull=False)
    seen = np.concatenate([opacity, np.ones(len(s.index) - N)]) > 0
    np.testing.assert_allclose(s.opacity[:N], opacity, atol=1e-4)
    np.testing.assert_allclose(s.position[:N][seen[:N]], mean[seen[:N]], atol=1e-4)
    np.testing.assert_allclose(kernel_covariance(s.scale, s.rotation)[:N], covariance, atol=1e-4, rtol=1e-4)
    np.testing.assert_allclose(colours(model.appearance, s.features[:N], directions(N)), colour, atol=1e-4)


TIMES = (0.0, 0.7, 3.33, 6.1, 9.97)


@pytest.mark.parametrize("rot_4d", [True, False])
@pytest.mark.parametrize("degree_t", [0, 1, 2])
def test_checkpoints(tmp_path, rng, rot_4d, degree_t):
    a = raw(rng, 16 * (degree_t + 1))
    saved(tmp_path / "chkpnt.pth", a, rot_4d, degree_t)
    model = fg.load(tmp_path / "chkpnt.pth")
    assert model.clip.duration == pytest.approx(D)
    for time in TIMES:
        compare(model, time, expected(a, time, rot_4d, degree_t))


def test_hybrid(tmp_path, rng):
    a, static = raw(rng, 16), raw(rng, 16)
    saved(tmp_path / "a.pth", a, degree_t=0, static=static)
    model = fg.load(tmp_path / "a.pth")
    for time in TIMES:
        compare(model, time, expected(a, time, degree_t=0))
        s = fg.slice_model(model, time / D, cull=False)
        np.testing.assert_allclose(s.position[N:], static["xyz"], atol=1e-6)
        np.testing.assert_allclose(s.scale[N:], np.exp(static["scaling"]), rtol=1e-5)
        np.testing.assert_allclose(s.opacity[N:], 1 / (1 + np.exp(-static["opacity"][:, 0])), atol=1e-6)
        np.testing.assert_allclose(s.features[N:], np.concatenate([static["dc"], static["rest"]], 1).reshape(N, -1), atol=1e-6)


def test_three_dimensions_and_what_is_left_out(tmp_path, rng):
    a = raw(rng, 16)
    saved(tmp_path / "a.pth", a, env=(3, 4, 4), degree_t=0)
    with pytest.warns(fg.LossWarning, match="environment map"):
        fg.load(tmp_path / "a.pth")
    p = {key: torch.tensor(value) for key, value in a.items()}
    torch.save(((2, p["xyz"], p["dc"], p["rest"], p["scaling"], p["rotation"], p["opacity"], torch.zeros(N), torch.zeros(N, 1),
                 torch.zeros(N, 1), {}, np.float32(1.0)), 7000), tmp_path / "b.pth")
    model = fg.load(tmp_path / "b.pth")
    assert model.appearance == fg.SH(2)
    np.testing.assert_array_equal(model.position, a["xyz"])


def test_length_from_the_configuration(tmp_path, rng):
    saved(tmp_path / "a.pth", raw(rng))
    (tmp_path / "cfg_args").write_text("Namespace(time_duration=[-1.0, 12.0], sh_degree=3)")
    assert fg.load(tmp_path / "a.pth").clip.duration == pytest.approx(13)


@pytest.mark.parametrize("rot_4d", [True, False])
def test_what_else_the_configuration_says(tmp_path, rng, rot_4d):
    """prefilter_var widens the bell and moves nothing else, frame_ratio divides time, opa_threshold is the hybrid's, without rot_4d."""
    a = raw(rng)
    saved(tmp_path / "a.pth", a, rot_4d)
    (tmp_path / "cfg_args").write_text("Namespace(time_duration=[0.0, 10.0], prefilter_var=0.3, frame_ratio=1)")
    for time in TIMES:
        compare(fg.load(tmp_path / "a.pth"), time, expected(a, time, rot_4d, prefilter_var=0.3))
    saved(tmp_path / "a.pth", raw(rng, 16) | a | {"rest": a["rest"][:, :15]}, rot_4d, 0, static=raw(rng, 16))
    (tmp_path / "cfg_args").write_text("Namespace(time_duration=[0.0, 20.0], opa_threshold=0.4, frame_ratio=2)")
    model = fg.load(tmp_path / "a.pth")
    assert model.clip.duration == pytest.approx(20)
    for time in TIMES:
        told = expected(a | {"rest": a["rest"][:, :15]}, time, rot_4d, 0, threshold=0.05 if rot_4d else 0.4)
        compare(model, time, told)


def test_hybrid_before_anything_stands_still(tmp_path, rng):
    """static_xyz and the others are torch.empty(0) until the first Gaussian becomes static."""
    a = raw(rng, 16)
    saved(tmp_path / "a.pth", a, degree_t=0, static={key: np.zeros(0, np.float32) for key in a})
    compare(fg.load(tmp_path / "a.pth"), 3.3, expected(a, 3.3, degree_t=0))


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_lower_degrees(tmp_path, rng, degree):
    """--sh_degree gives fewer coefficients; of temporal ones the kernel takes no notice then."""
    a, width = raw(rng, 3 * (degree + 1) ** 2), (degree + 1) ** 2
    saved(tmp_path / "a.pth", a, degree=degree, degree_t=2)
    compare(fg.load(tmp_path / "a.pth"), 3.3, expected(a | {"rest": a["rest"][:, :width - 1]}, 3.3, degree_t=0))


@pytest.mark.parametrize(("key", "shape"), [("rotation_r", (N, 3)), ("t", (N, 2)), ("rest", (N, 30, 3)), ("opacity", (N - 1, 1))])
def test_wrong_shapes(tmp_path, rng, key, shape):
    saved(tmp_path / "a.pth", raw(rng) | {key: np.zeros(shape, np.float32)})
    with pytest.raises(fg.FastGSError, match=r"shape"):
        fg.load(tmp_path / "a.pth")


def test_damaged_files(tmp_path, rng):
    saved(tmp_path / "a.pth", raw(rng, 16), degree_t=0)
    saved(tmp_path / "b.pth", raw(rng, 16), degree_t=0, static=raw(rng, 16))
    contents = {name: {"m": (tmp_path / f"{name}.pth").read_bytes()} for name in "ab"}
    mutations.campaign("realtime4dgs", mutations.shows("m"), contents, tmp_path)


def test_a_degree_that_is_something_else_is_told_briefly(tmp_path):
    zeros = [torch.zeros(N, *shape) for shape in ((3,), (1, 3), (15, 3), (3,), (4,), (1,))]
    for degree, said in (("x" * 100_000, "cannot be 'xxx"), (tuple(range(1000)), "a tuple"), (7, "cannot be 7")):
        torch.save(((degree, *zeros, *[0] * 5), 1), tmp_path / "a.pth")
        with pytest.raises(fg.FastGSError, match=said) as error:
            fg.load(tmp_path / "a.pth")
        assert len(str(error.value)) < len(str(tmp_path)) + 150
