# SPDX-License-Identifier: GPL-3.0-or-later
"""Ex4DGS against its own formulas in float64, Gaussian by Gaussian.

Transcribed from juno181/Ex4DGS@7fac649: the columns of save_ply() (scene/c_gaussian_model.py, lines 473-547); get_static_xyz_at_t,
get_dynamic_xyz_at_t, get_rotation_at_t (lines 178-208: those without keyframes are handed over as they are, no rotation_activation) and
get_motion_opacity_at_t (363); utils/interpolations.py, lines 6-94; near as render.py hands it over (135) to in_frustum() of its
rasteriser (cuda_rasterizer/auxiliary.h, 284), whose computeCov3D does not normalise (forward.cu, 137).
"""
from __future__ import annotations

import math

import mutations
import numpy as np
import pytest
from evaluated import assert_shows, directions, kernel_covariance, spherical

import fastgs_blender as fg

N, M, KEYS, DURATION, INTERVAL, PAD, VAR = 5, 14, 9, 40, 10, 2, 3


def as_ply(columns: dict[str, np.ndarray]) -> bytes:
    values = np.stack(list(columns.values()), 1).astype("<f4")
    head = "".join(f"property float {name}\n" for name in columns)
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {len(values)}\n{head}end_header\n".encode() + values.tobytes()


def named(array: np.ndarray, name: str) -> dict[str, np.ndarray]:
    return {name.format(*np.unravel_index(i, array.shape[1:])): array.reshape(len(array), -1)[:, i] for i in range(array[0].size)}


def files(rng, interpolation="cube") -> tuple[dict[str, bytes], dict[str, np.ndarray]]:
    a = {"xyz": rng.normal(size=(N, 3)), "drift": rng.normal(size=(N, 3)), "dc": rng.normal(size=(N, 3)),
         "rest": rng.normal(0, 0.2, (N, 45)), "opacity": rng.normal(size=N), "scale": rng.normal(-1, 0.3, (N, 3)),
         "rot": rng.normal(size=(N, 4)),
         "place": rng.normal(size=(M, KEYS, 3)), "m_dc": rng.normal(size=(M, 3)), "m_rest": rng.normal(0, 0.2, (M, 45)),
         "m_scale": rng.normal(-1, 0.3, (M, 3)), "m_opacity": rng.normal(size=M), "turn": rng.normal(size=(M, KEYS, 4)),
         "c": rng.uniform(0.5, 5.5, (M, 2)), "v": rng.normal(-0.5, 0.5, (M, 2))}
    a = {key: value.astype(np.float32).astype(np.float64) for key, value in a.items()}
    a["turn"][0, 1] = a["turn"][0, 0]
    static = {**named(a["xyz"], "{}"), "nx": 0 * a["opacity"]}
    static = dict(zip(("x", "y", "z", "nx"), static.values()))
    static |= named(a["dc"], "f_dc_{}") | named(a["rest"], "f_rest_{}") | {"opacity": a["opacity"]} | named(a["scale"], "scale_{}")
    static |= named(a["rot"], "rot_{}") | named(a["drift"], "xyz_disp_{}")
    moving = named(a["place"], "motion_xyz_{}_{}") | named(a["m_dc"], "motion_f_dc_{}") | named(a["m_rest"], "motion_f_rest_{}")
    moving |= named(a["m_scale"], "motion_scale_{}") | {"motion_opacity": a["m_opacity"]} | named(a["c"], "motion_opacity_c_{}")
    moving |= named(a["v"], "motion_opacity_v_{}") | named(a["turn"], "motion_rot_{}_{}")
    settings = (f"Namespace(duration={DURATION}, time_interval={INTERVAL}, time_pad={PAD}, var_pad={VAR}, kernel_size=0.1, near=4.0, "
                f"interp_type='{interpolation}', rot_interp_type='slerp')")
    return {"point_cloud.ply": as_ply(static), "dynamic_point_cloud.ply": as_ply(moving), "cfg_args": settings.encode()}, a


def expected(a, time, interpolation):
    """One Gaussian after the other: positions, rotations and opacities of those with keyframes."""
    s = time + PAD + (0 if interpolation == "linear" else INTERVAL)
    k, u = int(s // INTERVAL), (s % INTERVAL) / INTERVAL
    places, turns, opacities = [], [], []
    for i in range(M):
        y = a["place"][i]
        if interpolation == "linear":
            places.append(y[k] * (1 - u) + y[k + 1] * u)
        else:
            m0, m1 = (y[k + 1] - y[k - 1]) / 2, (y[k + 2] - y[k]) / 2
            if interpolation == "pchip":
                one, two, three = y[k] - y[k - 1], y[k + 1] - y[k], y[k + 2] - y[k + 1]
                m0 = np.array([two[j] * one[j] / (y[k + 1] - y[k - 1])[j] * 2 if two[j] * one[j] > 0 else 0 for j in range(3)])
                m1 = np.array([three[j] * two[j] / (y[k + 2] - y[k])[j] * 2 if three[j] * two[j] > 0 else 0 for j in range(3)])
            places.append((2 * u**3 - 3 * u**2 + 1) * y[k] + (u**3 - 2 * u**2 + u) * m0 + (-2 * u**3 + 3 * u**2) * y[k + 1]
                          + (u**3 - u**2) * m1)
        p, q = (v / np.linalg.norm(v) for v in a["turn"][i, k:k + 2])
        omega = max(math.acos(min(max(float(p @ q), -1 + 1e-4), 1 - 1e-4)), 1e-4)
        mixed = p * math.sin((1 - u) * omega) + q * math.sin(u * omega)
        turns.append(mixed / np.linalg.norm(mixed))
        tau, (c0, c1), (v0, v1) = s / INTERVAL, a["c"][i], a["v"][i]
        bell = 1.0
        if not (c0 - tau) * (c1 - tau) < 0:
            spread = math.exp(v1 if tau > c0 or tau > c1 else v0) + VAR / INTERVAL / 2.36
            bell = math.exp(-((min(tau - c0, tau - c1) / spread) ** 2))
        opacities.append(bell / (1 + math.exp(-a["m_opacity"][i])))
    return np.array(places), np.array(turns), np.array(opacities)


@pytest.mark.parametrize("interpolation", ["cube", "pchip", "linear"])
@pytest.mark.parametrize("opened", ["point_cloud.ply", "dynamic_point_cloud.ply"])
def test_at_any_time(tmp_path, rng, interpolation, opened):
    contents, a = files(rng, interpolation)
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    source = fg.open_source(tmp_path / opened)
    assert source.clip == fg.Clip(DURATION, 30.0)
    colours = [spherical(directions(N + M)[part], np.concatenate([dc[:, None], rest.reshape(-1, 3, 15).transpose(0, 2, 1)], 1))
               for part, dc, rest in ((slice(0, N), a["dc"], a["rest"]), (slice(N, N + M), a["m_dc"], a["m_rest"]))]
    for time in (0.0, 3.7, 18.0, 26.25, 39.0):
        places, turns, opacities = expected(a, time, interpolation)
        model, t = source.moment(time / DURATION)
        assert model.raster == fg.Raster(blur=0.1, near=4.0, antialiased=True)
        assert_shows(model, t, position=np.concatenate([a["xyz"] + a["drift"] * time / DURATION, places]),
                     covariance=np.concatenate([kernel_covariance(np.exp(a["scale"]), a["rot"]),
                                                kernel_covariance(np.exp(a["m_scale"]), turns)]),
                     opacity=np.concatenate([1 / (1 + np.exp(-a["opacity"])), opacities]), colour=np.concatenate(colours))


def test_what_is_missing_is_said(tmp_path, rng):
    contents, _ = files(rng)
    for name in ("point_cloud.ply", "dynamic_point_cloud.ply"):
        (tmp_path / name).write_bytes(contents[name])
    with pytest.raises(fg.FastGSError, match=r"point_cloud\.ply.*cfg_args"):
        fg.open_source(tmp_path / "point_cloud.ply")
    for other, said in ((b"'cubic_diff'", "cubic_diff"), (b"['cube']", "a list"), (b"{}", "a dict")):
        (tmp_path / "cfg_args").write_bytes(contents["cfg_args"].replace(b"'cube'", other))
        with pytest.raises(fg.FastGSError, match=said):
            fg.open_source(tmp_path / "point_cloud.ply")


def test_mutated_files(tmp_path, rng):
    told = mutations.campaign("ex4dgs", mutations.shows("dynamic_point_cloud.ply"), {"cube": files(rng)[0]}, tmp_path)
    assert min(told.values(), default=1) > 0
