# SPDX-License-Identifier: GPL-3.0-or-later
"""Models of research programs against their own formulas in float64: Katsumata's PLY and 4D-Rotor Gaussians' checkpoints."""
from __future__ import annotations

import mutations
import numpy as np
import pytest
from evaluated import assert_shows, directions, spherical

import fastgs_blender as fg
from fastgs_blender.util import rotations

N = 12


def katsumata(rng, waves: int, degree: int = 3):
    """(names, values [N, columns]) in the order in which their program writes them, and what it means by them."""
    rows, rest = 2 * waves + 1, 3 * ((degree + 1) ** 2 - 1)
    xyz, turn = rng.normal(0, 0.5, (N, rows, 3)), rng.normal(size=(N, rows, 4))
    dc, more, opacity, scale = rng.normal(size=(N, 3)), rng.normal(0, 0.3, (N, rest)), rng.normal(size=(N, 1)), rng.normal(-1, 0.4, (N, 3))
    names = [f"{axis}{row:03}" for row in range(rows) for axis in "xyz"] + ["nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3))]
    names += [*(f"f_rest_{i}" for i in range(rest)), "opacity", *(f"scale_{i}" for i in range(3))]
    names += [f"rot_{row:03}_{i}" for i in range(4) for row in range(rows)]
    values = np.concatenate([xyz.reshape(N, -1), np.zeros((N, 3)), dc, more, opacity, scale, turn.reshape(N, -1)], 1).astype("<f4")
    return names, values, (xyz, turn, dc, more, opacity, scale)


def as_ply(names, values) -> bytes:
    head = "".join(f"property float {name}\n" for name in names)
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {len(values)}\n{head}end_header\n".encode() + values.tobytes()


@pytest.mark.parametrize("waves", [1, 2, 3])
def test_katsumata(tmp_path, rng, waves):
    names, values, (xyz, turn, dc, more, opacity, scale) = katsumata(rng, waves)
    (tmp_path / "m.ply").write_bytes(as_ply(names, values))
    model = fg.load(tmp_path / "m.ply")
    coefficients = np.concatenate([dc[:, None], more.reshape(N, 3, -1).transpose(0, 2, 1)], 1)
    for t in (0.0, 0.31, 0.77, 1.0):
        angle = np.pi * t * 2.0 ** np.repeat(np.arange(waves), 2)
        waves_now = np.where(np.arange(2 * waves) % 2 == 0, np.sin(angle), np.cos(angle))
        position = xyz[:, 0] + np.einsum("k,nkd->nd", waves_now, xyz[:, 1:])
        assert_shows(model, t, position=position, rotation=turn[:, 0] + t * turn[:, 1], scale=np.exp(scale),
                     opacity=1 / (1 + np.exp(-opacity[:, 0])), colour=spherical(directions(N), coefficients))


def test_mutated_katsumata(tmp_path, rng):
    names, values, _ = katsumata(rng, 2, 0)
    seeds = {"two waves": {"m.ply": as_ply(names, values)}}
    told = mutations.campaign("katsumata", lambda folder: fg.load(folder / "m.ply"), seeds, tmp_path)
    assert min(told.values(), default=1) > 0


def rotor(rng) -> dict[str, np.ndarray]:
    return {"xyz": rng.normal(size=(N, 3)), "t": rng.uniform(0, 1, (N, 1)), "scales_xyz": rng.normal(-1, 0.5, (N, 3)),
            "scales_t": rng.normal(-1, 0.5, (N, 1)), "quats1": rng.normal(size=(N, 4)), "quats2": rng.normal(0, 0.4, (N, 4)),
            "features_dc": rng.normal(size=(N, 1, 3)), "features_rest": rng.normal(0, 0.3, (N, 15, 3)),
            "opacities": rng.normal(size=(N, 1))}


def saved(path, arrays) -> None:
    torch = pytest.importorskip("torch")
    pipeline = {f"_model.gauss_params.{k}": torch.nn.Parameter(torch.tensor(v, dtype=torch.float32)) for k, v in arrays.items()}
    torch.save({"step": 30000, "pipeline": {**pipeline, "_model.device_indicator": torch.zeros(0)}, "optimizers": {}, "schedulers": {},
                "scalers": {"scale": 65536.0}}, path)


def wedge_rotation(eight) -> np.ndarray:
    """The rotation of space and time of a rotor, by the algebra itself: R v R~ for the basis vectors e1..e4."""
    blades = [(), (1, 2), (1, 3), (2, 3), (1, 4), (2, 4), (3, 4), (1, 2, 3, 4)]

    def product(one, two):
        out = {}
        for a, x in one.items():
            for b, y in two.items():
                sign, seen = 1.0, list(a)
                for axis in b:
                    sign *= (-1) ** sum(other > axis for other in seen)
                    seen = [other for other in seen if other != axis] if axis in seen else sorted([*seen, axis])
                out[tuple(seen)] = out.get(tuple(seen), 0.0) + sign * x * y
        return out

    element = dict(zip(blades, eight))
    reverse = {blade: value * (-1) ** (len(blade) * (len(blade) - 1) // 2) for blade, value in element.items()}
    images = [product(product(element, {(axis,): 1.0}), reverse) for axis in (1, 2, 3, 4)]
    return np.array([[image.get((axis,), 0.0) for image in images] for axis in (1, 2, 3, 4)])


def test_rotors_are_those_of_the_algebra(rng):
    """Proper rotors: products of two vectors' products; others are projected onto one."""
    from fastgs_blender.formats.rotor import turns

    arrays = rotor(rng)
    found = turns(arrays["quats1"], arrays["quats2"])
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.broadcast_to(np.eye(4), (N, 4, 4)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(found), 1, atol=1e-9)
    half = rng.uniform(0, 1.5, 6)
    for plane, blade in enumerate(((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))):
        eight = np.zeros(8)
        eight[0], eight[1 + plane] = np.cos(half[plane]), np.sin(half[plane])
        own = turns(eight[None, :4], eight[None, 4:])[0]
        np.testing.assert_allclose(own, wedge_rotation(eight), atol=1e-9, err_msg=str(blade))
    plain = np.array([[0.5, -0.5, 0.1, 0.7]])  # without time: the quaternion (s, -b_yz, b_xz, -b_xy)
    plain /= np.linalg.norm(plain)
    s, xy, xz, yz = plain[0]
    np.testing.assert_allclose(turns(plain, np.zeros((1, 4)))[0, :3, :3], rotations.to_matrices(np.array([s, -yz, xz, -xy])), atol=1e-9)


def test_rotor_checkpoints(tmp_path, rng):
    from fastgs_blender.formats.rotor import turns

    arrays = rotor(rng)
    saved(tmp_path / "step-000030000.ckpt", arrays)
    model = fg.load(tmp_path / "step-000030000.ckpt")
    spread = turns(arrays["quats1"], arrays["quats2"]) * np.exp(np.concatenate([arrays["scales_xyz"], arrays["scales_t"]], 1))[:, None]
    sigma = spread @ spread.transpose(0, 2, 1)
    variance = sigma[:, 3, 3]
    covariance = sigma[:, :3, :3] - sigma[:, :3, 3:] @ sigma[:, 3:, :3] / variance[:, None, None]
    coefficients = np.concatenate([arrays["features_dc"], arrays["features_rest"]], 1)
    for t in (0.0, 0.4, 0.95):
        delta = t - arrays["t"][:, 0]
        exponent = 0.5 * delta**2 / variance
        s = fg.slice_model(model, t, cull=False)
        np.testing.assert_allclose(s.position, arrays["xyz"] + sigma[:, :3, 3] / variance[:, None] * delta[:, None], atol=1e-4)
        bell = np.where(exponent < 16, np.exp(-exponent), 0)
        np.testing.assert_allclose(s.opacity, bell / (1 + np.exp(-arrays["opacities"][:, 0])), atol=1e-4)
        own = rotations.to_matrices(s.rotation) * s.scale[:, None]
        np.testing.assert_allclose(own @ own.transpose(0, 2, 1), covariance, atol=1e-4, rtol=1e-4)
    np.testing.assert_allclose(model.features.reshape(N, 16, 3), coefficients, atol=1e-6)


def test_mutated_rotor_checkpoints(tmp_path, rng):
    saved(tmp_path / "m.ckpt", {key: value[:3] for key, value in rotor(rng).items()})
    (tmp_path / "seeds").mkdir()
    told = mutations.campaign("rotor", lambda folder: fg.load(folder / "m.ckpt"), {"three": {"m.ckpt": (tmp_path / "m.ckpt").read_bytes()}},
                              tmp_path / "seeds")
    assert min(told.values(), default=1) > 0
