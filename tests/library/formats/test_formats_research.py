# SPDX-License-Identifier: GPL-3.0-or-later
"""Models of research programs against their own formulas in float64: Katsumata's PLY and 4D-Rotor Gaussians' checkpoints.

Transcribed from
* raven38/EfficientDynamic3DGaussian@c79a9f0: the columns of save_ply() (scene/gaussian_model.py, lines 183-219); each row of the quaternion
  normalised by itself (get_rotation, 104-106), their sum not (gaussian_renderer/__init__.py, 63-69 and 90); the rasteriser is
  graphdeco's, see kernel_covariance().
* weify627/4D-Rotor-Gaussians@1ea2ff9: nerfstudio/utils/general_utils.py, build_rotation_from_rotor8 and slice_4d, lines 234-327, of
  quats1 and quats2 as they are (nerfstudio/models/splatfacto.py, 926-938 and 1359-1369; nobody calls get_rotors, 397, which calls
  rotornorm); checkpoints as nerfstudio/engine/trainer.py saves them (436).
"""
from __future__ import annotations

import mutations
import numpy as np
import pytest
import torch
from evaluated import assert_shows, directions, kernel_covariance, spherical, unit

import fastgs_blender as fg

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


@pytest.mark.parametrize("waves", [1, 2, 3, 5])
def test_katsumata(tmp_path, rng, waves):
    names, values, (xyz, turn, dc, more, opacity, scale) = katsumata(rng, waves)
    (tmp_path / "m.ply").write_bytes(as_ply(names, values))
    with pytest.raises(fg.FastGSError, match="open_source"):
        fg.load(tmp_path / "m.ply")
    source = fg.open_source(tmp_path / "m.ply")
    coefficients = np.concatenate([dc[:, None], more.reshape(N, 3, -1).transpose(0, 2, 1)], 1)
    for t in (0.0, 0.31, 0.77, 1.0):
        basis = 2.0 ** np.repeat(np.arange(waves), 2) * np.pi * t
        basis[::2], basis[1::2] = np.sin(basis[::2]), np.cos(basis[1::2])
        position = xyz[:, 0] + (xyz[:, 1:2 * waves + 1] * basis[:, None]).sum(1)
        rotations = unit(turn[:, 0]) + unit(turn[:, 1]) * t
        model, moment = source.moment(t)
        assert_shows(model, moment, position=position, covariance=kernel_covariance(np.exp(scale), rotations),
                     opacity=1 / (1 + np.exp(-opacity[:, 0])), colour=spherical(directions(N), coefficients))


def test_katsumata_as_it_begins_and_with_fewer_waves_than_rows(tmp_path, rng):
    """Rows that were never trained are zeros, and stay zeros where they are normalised; cfg_args says how many waves there are."""
    names, values, (xyz, turn, _, _, _, scale) = katsumata(rng, 5, 0)
    values[:, [i for i, name in enumerate(names) if name.startswith("rot_")][4:]] = 0
    (tmp_path / "m.ply").write_bytes(as_ply(names, values))
    (tmp_path / "cfg_args").write_text("Namespace(approx_l=2)")
    model, _ = fg.open_source(tmp_path / "m.ply").moment(0.25)
    waves = np.array([np.sin(np.pi / 4), np.cos(np.pi / 4), 1, 0])
    np.testing.assert_allclose(model.position, xyz[:, 0] + np.einsum("k,nkd->nd", waves, xyz[:, 1:5]), atol=1e-5)
    np.testing.assert_allclose(kernel_covariance(np.exp(model.scale), model.rotation), kernel_covariance(np.exp(scale), unit(turn[:, 0])),
                               atol=1e-5)


def shown(path) -> None:
    for t in (0.0, 0.4):
        model, _ = fg.open_source(path).moment(t)
        assert all(np.isfinite(array).all() for array in model.arrays.values())


def test_mutated_katsumata(tmp_path, rng):
    names, values, _ = katsumata(rng, 2, 0)
    seeds = {"two waves": {"m.ply": as_ply(names, values)}}
    told = mutations.campaign("katsumata", lambda folder: shown(folder / "m.ply"), seeds, tmp_path)
    assert min(told.values(), default=1) > 0


def rotor(rng) -> dict[str, np.ndarray]:
    """Parameters as trainings leave them: rotors that are neither unit nor proper, |r| between 0.84 and 1.19."""
    rotors = unit(np.concatenate([rng.normal(size=(N, 4)), rng.normal(0, 0.4, (N, 4))], 1)) * rng.uniform(0.84, 1.19, (N, 1))
    return {"xyz": rng.normal(size=(N, 3)), "t": rng.uniform(0, 1, (N, 1)), "scales_xyz": rng.normal(-1, 0.5, (N, 3)),
            "scales_t": rng.normal(-1, 0.5, (N, 1)), "quats1": rotors[:, :4], "quats2": rotors[:, 4:],
            "features_dc": rng.normal(size=(N, 1, 3)), "features_rest": rng.normal(0, 0.3, (N, 15, 3)),
            "opacities": rng.normal(size=(N, 1))}


def saved(path, arrays) -> None:
    pipeline = {f"_model.gauss_params.{k}": torch.nn.Parameter(torch.tensor(v, dtype=torch.float32)) for k, v in arrays.items()}
    torch.save({"step": 30000, "pipeline": {**pipeline, "_model.device_indicator": torch.zeros(0)}, "optimizers": {}, "schedulers": {},
                "scalers": {"scale": 65536.0}}, path)


def sandwich(eight) -> np.ndarray:
    """The matrix [4, 4] of space and time that eight numbers make: of R v R~ what is a vector, for the basis vectors v, by the algebra.

    build_rotation_from_rotor8() multiplies this out; test_the_algebra_is_what_the_original_multiplies_out() compares some of its entries.
    """
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


def test_the_algebra_is_what_the_original_multiplies_out(rng):
    """Lines 258-281, whose matrix is transposed at the end, 283."""
    a, xy, xz, yz, xw, yw, zw, p = eight = rng.normal(size=8)
    matrix = sandwich(eight)
    assert matrix[0, 0] == pytest.approx(-xy**2 - xz**2 - xw**2 + yz**2 + yw**2 + zw**2 - p**2 + a**2)
    assert matrix[0, 1] == pytest.approx(2 * (xy * a - xz * yz - xw * yw + zw * p))
    assert matrix[3, 0] == pytest.approx(2 * (xy * yw + xz * zw - xw * a - yz * p))
    assert matrix[2, 3] == pytest.approx(2 * (xy * p - xz * xw - yw * yz + zw * a))
    assert matrix[3, 3] == pytest.approx(xy**2 + xz**2 - xw**2 + yz**2 - yw**2 - zw**2 - p**2 + a**2)


@pytest.mark.parametrize("of_unit_length", [False, True])
def test_rotor_checkpoints(tmp_path, rng, of_unit_length):
    arrays = rotor(rng)
    if of_unit_length:
        both = unit(np.concatenate([arrays["quats1"], arrays["quats2"]], 1))
        arrays["quats1"], arrays["quats2"] = both[:, :4], both[:, 4:]
    saved(tmp_path / "step-000030000.ckpt", arrays)
    model = fg.load(tmp_path / "step-000030000.ckpt")
    covariance, speed, w = [], [], []
    for i in range(N):
        sizes = np.exp([*arrays["scales_xyz"][i], *arrays["scales_t"][i]])
        spread = sandwich([*arrays["quats1"][i], *arrays["quats2"][i]]) @ np.diag(sizes)
        sigma = spread @ spread.T
        w.append(1 / sigma[3, 3])
        speed.append(sigma[:3, 3] * w[i])
        covariance.append(sigma[:3, :3] - np.outer(sigma[:3, 3], speed[i]))
    coefficients = np.concatenate([arrays["features_dc"], arrays["features_rest"]], 1)
    for t in (0.0, 0.4, 0.95):
        delta = t - arrays["t"][:, 0]
        tshift = 0.5 * np.array(w) * delta**2
        opacity = np.where(tshift < 16, np.exp(-tshift), 0) / (1 + np.exp(-arrays["opacities"][:, 0]))
        assert_shows(model, t, position=arrays["xyz"] + np.array(speed) * delta[:, None], covariance=np.array(covariance), opacity=opacity,
                     colour=spherical(directions(N), coefficients))


def test_mutated_rotor_checkpoints(tmp_path, rng):
    saved(tmp_path / "m.ckpt", {key: value[:3] for key, value in rotor(rng).items()})
    (tmp_path / "seeds").mkdir()
    told = mutations.campaign("rotor", lambda folder: fg.load(folder / "m.ckpt"), {"three": {"m.ckpt": (tmp_path / "m.ckpt").read_bytes()}},
                              tmp_path / "seeds")
    assert min(told.values(), default=1) > 0
