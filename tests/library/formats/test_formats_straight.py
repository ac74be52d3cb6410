# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats of Gaussians with linear motion and bell-shaped temporal opacity, against their own formulas: FreeTimeGS, Mediastorm, splat4d.

Transcribed: FreeTimeGsVanilla (raiscui@ff48035, src/simple_trainer_freetime_4d_pure_relocation.py: compute_temporal_opacity and
compute_positions_at_time, lines 1932-1958, checkpoints 2624-2629, canonical_4d.npz 2965-2990; OpsiClear-4DGS@662a832, freetime_ops.py,
and export_ftgs_ply.py@9dbf862).  gsplat normalises quaternions, so their length means nothing.  FreeTimeGS++: see plus_plus().
gsplat-unity (raiscui@a92f847): records and unit quaternions as Editor/GsplatSplat4DImporter.cs decodes them (lines 303-340), weights of
time as Runtime/Shaders/Gsplat.compute, 576-590.  Mediastorm's law is that of the nodes of its viewer, which is no text.
"""
from __future__ import annotations

import io
import struct
import zipfile

import evaluated
import mutations
import numpy as np
import ply_files
import pytest
import torch
from evaluated import assert_shows, directions, spherical
from random_models import random_model

import fastgs_blender as fg

TIMES = (-0.3, 0.0, 0.2137, 0.5, 0.77, 1.0, 1.4)
N = 9


def sigmoid(x):
    return 0.5 + 0.5 * np.tanh(0.5 * np.asarray(x, np.float64))


def raw(rng, rest: int = 15) -> dict[str, np.ndarray]:
    """Random parameters under FreeTimeGS's names, float32."""
    arrays = {"means": rng.normal(size=(N, 3)), "scales": rng.normal(-2, 0.5, (N, 3)), "quats": rng.normal(size=(N, 4)),
              "opacities": rng.normal(1, 2, N), "sh0": rng.normal(size=(N, 1, 3)), "shN": rng.normal(0, 0.2, (N, rest, 3)),
              "times": rng.uniform(-0.2, 1.2, (N, 1)), "durations": rng.normal(-1.5, 1, (N, 1)), "velocities": rng.normal(size=(N, 3))}
    return {key: value.astype(np.float32) for key, value in arrays.items()}


def freetime(a, t: float, least: float = 0.0, moves: bool = True) -> dict:
    """FreeTimeGS's equations 1 and 4."""
    a = {key: value.astype(np.float64) for key, value in a.items()}
    delta, sigma = t - a["times"], np.maximum(np.exp(a["durations"]), least)
    return {"position": a["means"] + (a["velocities"] * delta if moves else 0), "rotation": a["quats"], "scale": np.exp(a["scales"]),
            "opacity": sigmoid(a["opacities"]) * np.exp(-0.5 * (delta / sigma) ** 2)[:, 0],
            "colour": spherical(directions(N), np.concatenate([a["sh0"], a["shN"]], 1))}


def columns(a) -> dict[str, np.ndarray]:
    """The columns of `.ftgs.ply`, but for those of time."""
    rest = a["shN"].transpose(0, 2, 1).reshape(N, -1)
    table = dict(zip("xyz", a["means"].T)) | dict(zip(("nx", "ny", "nz"), np.zeros((3, N), np.float32)))
    table |= {f"f_dc_{i}": a["sh0"][:, 0, i] for i in range(3)} | {f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])}
    table |= {"opacity": a["opacities"]} | {f"scale_{i}": a["scales"][:, i] for i in range(3)}
    return table | {f"rot_{i}": a["quats"][:, i] for i in range(4)}


def ftgs(a, comments=(), velocity=True) -> bytes:
    table = columns(a) | {"time": a["times"][:, 0], "log_duration": a["durations"][:, 0]}
    if velocity:
        table |= {f"velocity_{i}": a["velocities"][:, i] for i in range(3)}
    usual = ["ftgs_version 1", "time_units normalized", "sh_degree 3", "use_velocity 1", "min_duration 0.02", "opacity_floor 0.0001"]
    keys = {c.split()[0] for c in comments}
    return ply_files.ply(table, comments=[c for c in usual if c.split()[0] not in keys] + list(comments))


def checkpoint(path, a, **more):
    """A .pt of {"step", "splats": {...}, ...} in PyTorch's zip, written with the library's own pickle of a flat table in it."""
    torch.save({"step": 7, "splats": {key: torch.tensor(value) for key, value in a.items()}, "optimizers": {"means": {"state": {
        0: {"step": torch.tensor(3.0), "exp_avg": torch.zeros(N, 3)}}, "param_groups": [{"lr": 1e-3, "params": [0]}]}}} | more, path)


@pytest.mark.parametrize("rest", [0, 3, 15])
def test_ftgs(tmp_path, rng, rest):
    a, path = raw(rng, rest), tmp_path / "scene.ftgs.ply"
    a["durations"][:3] = -6  # under min_duration
    path.write_bytes(ftgs(a, ["n_frames 61", "min_duration 0.05"]))
    model = fg.load(path)
    assert fg.formats.identify(path).name == "FreeTimeGS PLY"
    assert model.clip.t_of_frame(60) == 1
    for t in TIMES:
        assert_shows(model, t, **freetime(a, t, 0.05))


def test_ftgs_that_does_not_move(tmp_path, rng):
    a, path = raw(rng), tmp_path / "scene.ftgs.ply"
    for velocity in (False, True):
        path.write_bytes(ftgs(a, ["use_velocity 0"], velocity))
        assert_shows(fg.load(path), 0.3, **freetime(a, 0.3, 0.02, moves=False))


@pytest.mark.parametrize("comment", ["ftgs_version 2", "time_units seconds", "use_velocity 3", "min_duration 0", "min_duration nan",
                                     "opacity_floor 1", "n_frames 0", "n_frames 2.5", "n_frames x"])
def test_ftgs_of_another_kind(tmp_path, rng, comment):
    path = tmp_path / "scene.ftgs.ply"
    path.write_bytes(ftgs(raw(rng), [comment]))
    with pytest.raises(fg.FastGSError, match="scene.ftgs.ply"):
        fg.load(path)


def test_ftgs_floor_that_could_be_seen(tmp_path, rng):
    path = tmp_path / "scene.ftgs.ply"
    path.write_bytes(ftgs(raw(rng), ["opacity_floor 0.1"]))
    with pytest.warns(fg.LossWarning, match="for ever"):
        fg.load(path)


def test_mediastorm(tmp_path, rng):
    a, path = raw(rng, 8), tmp_path / "dog.ply"
    a["times"] = rng.uniform(0, 4.0, (N, 1)).astype(np.float32)
    a["times"][0] = 4.0
    for name in ("t", "ttt"):
        motion = {f"motion_{i}": a["velocities"][:, i] for i in range(3)}
        path.write_bytes(ply_files.ply(columns(a) | motion | {name: a["times"][:, 0], "t_scale": a["durations"][:, 0]}))
        model = fg.load(path)
        assert (model.clip.frame_count, model.clip.fps) == (241, 60)
        for frame in (0, 17.3, 240, 300):
            assert_shows(model, model.clip.t_of_frame(frame), **freetime(a, frame / 60))


def test_checkpoints(tmp_path, rng):
    a = raw(rng)
    a["durations"][:3] = -6
    checkpoint(tmp_path / "ckpt_29999.pt", a)
    checkpoint(tmp_path / "with_frames.pt", a, n_frames=31)
    np.savez(tmp_path / "canonical_4d.npz", **a, n_frames=31, opacity_threshold=0.1)
    np.savez_compressed(tmp_path / "packed.npz", **a, n_frames=31)
    for path in tmp_path.iterdir():
        model = fg.load(path)
        assert model.clip.frame_count == (299 if "ckpt" in path.name else 30)
        for t in (*TIMES, *a["times"][:3, 0] + 0.03):
            assert_shows(model, t, **freetime(a, t, 0.02))


def test_checkpoint_that_does_not_move(tmp_path, rng):
    a = raw(rng)
    checkpoint(tmp_path / "a.pt", a, use_velocity=False)
    assert_shows(fg.load(tmp_path / "a.pt"), 0.3, **freetime(a, 0.3, 0.02, moves=False))


def plus_plus(a, gates, seconds: float) -> dict:
    """FreeTimeGS++ at a time in seconds: suNoeul/FreeTimeGSPlusPlus@8005d2f, ftgspp/models/gaussians.py, means_t, gate, temporal_opacity
    and opacities_t (lines 68-94); max_duration is 1 in all configs/ with marginal_gating and inf in the others, in which
    train/__init__.py, 107-110, fills the gates with -100."""
    a = {key: value.astype(np.float64) for key, value in a.items()}
    gate, max_duration = sigmoid(20 * gates.astype(np.float64)), np.inf if (gates == -100).all() else 1
    tscale = np.exp(a["durations"]) if max_duration == np.inf else max_duration / 6 * sigmoid(a["durations"])
    temporal = gate + (1 - gate) * np.exp(-0.5 * ((seconds - a["times"]) / tscale) ** 2)
    expected = freetime(a, seconds)
    return expected | {"opacity": (sigmoid(a["opacities"])[:, None] * temporal)[:, 0]}


@pytest.mark.parametrize("kind", ["without gates", "open or shut", "between"])
@pytest.mark.parametrize(("begin", "frames"), [(0.0, 300), (148.5, 60)])
def test_freetime_plus_plus(tmp_path, rng, kind, begin, frames):
    """As its export_npz() writes it (ftgspp/utils/io.py, 142): all parameters by their names, and an array "allow_pickle"; time is
    frame / fps (data/utils/multiview.py, 222), counted from the beginning of the film."""
    a = raw(rng)
    a["times"] = np.linspace(begin, begin + frames / 30, N, dtype=np.float32)[:, None]
    gates = {"without gates": np.full(N, -100), "open or shut": np.where(np.arange(N) % 2, -1, 1),
             "between": np.linspace(-0.1, 0.1, N)}[kind].astype(np.float32)[:, None]
    renamed = {{"sh0": "sh_0", "shN": "sh_n", "velocities": "velocity_model"}.get(k, k): v for k, v in a.items()}
    renamed["opacities"] = a["opacities"][:, None]
    np.savez_compressed(tmp_path / "a.npz", allow_pickle=True, marginal_gates=gates, **renamed)
    if kind == "between":
        with pytest.raises(fg.FastGSError, match="fade"):
            fg.load(tmp_path / "a.npz")
    else:
        assert isinstance(fg.load(tmp_path / "a.npz"), fg.GaussianModel)
    source = fg.open_source(tmp_path / "a.npz")
    assert abs(source.clip.duration - frames / 30) < 0.03 * frames / 30
    first = begin and begin + 0.01 * frames / 30  # of the Gaussians' times, the file states no other
    for seconds in np.linspace(begin, begin + frames / 30, 7):
        model, moment = source.moment((seconds - first) / source.clip.duration)
        assert_shows(model, moment, **plus_plus(a, gates, seconds), tolerance=1e-3)


@pytest.mark.parametrize("more", [{"color_correction": {"a": 1}}, {"model_spec": {"time_units": "seconds"}}, {"use_marginal_gating": True}])
def test_checkpoint_with_extensions(tmp_path, rng, more):
    checkpoint(tmp_path / "a.pt", raw(rng), **more)
    with pytest.raises(fg.FastGSError, match="not supported"):
        fg.load(tmp_path / "a.pt")


@pytest.mark.parametrize(("key", "shape"), [("quats", (N, 3)), ("times", (N - 1, 1)), ("shN", (N, 4, 3)), ("shN", (N, 45))])
def test_checkpoint_of_wrong_shapes(tmp_path, rng, key, shape):
    np.savez(tmp_path / "a.npz", **raw(rng) | {key: np.zeros(shape, np.float32)})
    with pytest.raises(fg.FastGSError, match=f"{key}.*shape|harmonics.*shape"):
        fg.load(tmp_path / "a.npz")


RECORD = np.dtype([("p", "<f4", 3), ("s", "<f4", 3), ("c", "u1", 4), ("q", "u1", 4), ("v", "<f4", 3), ("time", "<f4"), ("duration", "<f4"),
                   ("pad", "<f4", 3)])


def records(rng, n=N, inside=True) -> np.ndarray:
    out = np.zeros(n, RECORD)
    out["p"], out["v"], out["s"] = rng.normal(size=(2, n, 3)).tolist() + [np.exp(rng.normal(-2, 0.5, (n, 3)))]
    out["c"] = rng.integers(1, 255, (n, 4))
    q = rng.normal(size=(n, 4))
    out["q"] = np.clip(np.round(q / np.linalg.norm(q, axis=1, keepdims=True) * 128 + 128), 0, 255)
    out["time"] = rng.uniform(0, 0.8, n) if inside else rng.uniform(-0.5, 1.5, n)
    out["duration"] = rng.uniform(0.05, 0.4, n)
    return out


def splat4d(r, t: float, bell: bool, cutoff: float = 0.01, higher=None) -> dict:
    """What gsplat-unity's shader makes of records."""
    time, duration = r["time"].astype(np.float64), r["duration"].astype(np.float64)
    if bell:
        weight = np.exp(-0.5 * ((t - time) / duration) ** 2)
        weight = np.where(weight < cutoff, 0, weight)
    else:
        weight = ((t >= time) & (t <= time + duration)).astype(np.float64)
    rgb = r["c"][:, :3] / 255.0
    coefficients = ((rgb - 0.5) / 0.28209479177387814)[:, None]
    if higher is not None:
        coefficients = np.concatenate([coefficients, higher], 1)
    return {"position": r["p"] + r["v"].astype(np.float64) * (t - time)[:, None], "rotation": (r["q"].astype(np.float64) - 128) / 128,
            "scale": r["s"], "opacity": r["c"][:, 3] / 255.0 * weight, "colour": spherical(directions(len(r)), coefficients)}


def second_layout(r, time_model: int, palettes=(), cutoff=0.05, frames=0, later=None) -> bytes:
    """A file of layout 2; palettes: (coefficients [entries, 2 b + 1, 3], labels [N], type code) for each band."""
    body, sections = bytearray(64), []

    def add(kind, data, band=0, start=0, count=0):
        sections.append((kind, band, start, count, len(body), len(data)))
        body.extend(data)

    add(b"RECS", r.tobytes())
    infos = [(len(p), code, 2 if frames else 1, 0) for p, _, code in palettes] + [(0, 0, 0, 0)] * (3 - len(palettes))
    add(b"META", struct.pack("<IfII12I", 1, cutoff, 0, 0, *(v for info in infos for v in info)))
    for band, (palette, labels, code) in enumerate(palettes, 1):
        add(b"SHCT", palette.astype({1: "<f2", 2: "<f4"}[code]).tobytes(), band)
        add(b"SHLB", labels.astype("<u2").tobytes(), band, 0, frames)
        if frames:
            head = b"SPL4DLB1" + struct.pack("<5I", 1, 0, frames, len(r), len(palette))
            add(b"SHDL", head + struct.pack("<I", 0) * (frames - 1), band, 0, frames)
    if later is not None:
        add(b"SHLB", later.astype("<u2").tobytes(), 1, frames, frames)
    table = len(body)
    body += struct.pack("<4s3I", b"SECT", 1, len(sections), 0)
    for kind, *numbers in sections:
        body += struct.pack("<4s3I2Q", kind, *numbers)
    body[:64] = struct.pack("<8s8I3Q", b"SPL4DV02", 2, 64, len(sections), 64, len(r), len(palettes), time_model, frames, table, 0, 0)
    return bytes(body)


@pytest.mark.parametrize("inside", [True, False])
def test_splat4d_layout_1(tmp_path, rng, inside):
    """Windows, unless times leave 0..1: then bells."""
    r, path = records(rng, inside=inside), tmp_path / "a.splat4d"
    path.write_bytes(r.tobytes())
    model = fg.load(path)
    for t in TIMES:
        assert_shows(model, t, **splat4d(r, t, not inside))
    assert fg.formats.identify(path).name == "splat4d"


@pytest.mark.parametrize("time_model", [1, 2])
@pytest.mark.parametrize("bands", [0, 1, 3])
def test_splat4d_layout_2(tmp_path, rng, time_model, bands):
    r, path = records(rng), tmp_path / "a.splat4d"
    palettes = [(rng.normal(0, 0.2, (5, 2 * b + 1, 3)).astype(np.float16), rng.integers(0, 5, N), 1 + b % 2) for b in range(1, bands + 1)]
    path.write_bytes(second_layout(r, time_model, palettes))
    higher = np.concatenate([p[labels].astype(np.float64) for p, labels, _ in palettes], 1) if bands else None
    model = fg.load(path)
    for t in TIMES:
        assert_shows(model, t, **splat4d(r, t, time_model == 2, 0.05, higher))


def test_splat4d_edges_of_windows(tmp_path, rng):
    """A record is seen at both ends of its window, however float32 rounds them."""
    r, path = records(rng, 300), tmp_path / "a.splat4d"
    r["time"] = np.arange(300, dtype=np.float32) / 331
    r["duration"] = np.float32(7 / 331)
    path.write_bytes(r.tobytes())
    model = fg.load(path)
    for i in range(0, 300, 7):
        seen = fg.slice_model(model, i / 331, cull=False).opacity > 0
        assert seen[max(0, i - 7):i + 1].all()
        assert seen.sum() == min(i, 7) + 1


def test_splat4d_colour_that_changes(tmp_path, rng):
    r, path = records(rng), tmp_path / "a.splat4d"
    palette = (rng.normal(size=(4, 3, 3)), rng.integers(0, 4, N), 2)
    path.write_bytes(second_layout(r, 2, [palette], frames=5))
    assert fg.load(path).clip.frame_count == 4
    path.write_bytes(second_layout(r, 2, [palette], frames=5, later=(palette[1] + 1) % 4))
    with pytest.warns(fg.LossWarning, match="first frame"):
        model = fg.load(path)
    assert_shows(model, 0.5, **splat4d(r, 0.5, True, 0.05, palette[0][palette[1]]))


def zip_of(arrays) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def test_an_array_that_lies_about_its_size(tmp_path):
    """A small .npz with the header of a large array is refused before anything of that size is made."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f4", "fortran_order": False, "shape": (1 << 28, 3)})
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("means", "quats", "times", "durations"):
            archive.writestr(f"{name}.npy", head.getvalue() + bytes(1000))
    with pytest.raises(fg.FastGSError, match="size.*header"):
        fg.load(path)


def test_damaged_files(tmp_path, rng):
    a, r = raw(rng, 3), records(rng)
    palette = (rng.normal(size=(4, 3, 3)), rng.integers(0, 4, N), 1)
    checkpoint(tmp_path / "c.pt", a)
    motion = {f"motion_{i}": a["velocities"][:, i] for i in range(3)}
    contents = {
        "ftgs": ftgs(a, ["n_frames 61"]), "npz": zip_of(a | {"n_frames": 5}), "pt": (tmp_path / "c.pt").read_bytes(),
        "mediastorm": ply_files.ply(columns(a) | motion | {"t": a["times"][:, 0], "t_scale": a["durations"][:, 0]}),
        "layout 1": r.tobytes(), "layout 2": second_layout(r, 2, [palette], frames=3)}
    mutations.campaign("straight", mutations.shows("m"), {key: {"m": content} for key, content in contents.items()}, tmp_path)


def test_the_comparison_itself(rng):
    """spherical() in the tests and the library's own evaluation agree."""
    c = rng.normal(size=(N, 16, 3))
    np.testing.assert_allclose(evaluated.colours(fg.SH(3), c.reshape(N, -1), directions(N)), spherical(directions(N), c), atol=1e-12)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("axes", ["RDF", "RUB"])
def test_ftgs_is_written_as_it_is_read(tmp_path, degree, axes):
    model = random_model(np.random.default_rng(5), 30, "line", "static", "radial", f"sh{degree}", clip=fg.Clip(24, 30.0), axes=axes)
    with pytest.warns(fg.LossWarning, match="constants"):
        fg.save(model, tmp_path / "m.ftgs.ply")
    again = fg.load(tmp_path / "m.ftgs.ply")
    assert again.clip == fg.Clip(24, 30.0)
    flip = np.float64([1, -1, -1]) if axes == "RUB" else np.ones(3)
    for t in (0.0, 0.3, 1.0):
        a, b = fg.slice_model(model, t, cull=False), fg.slice_model(again, t, cull=False)
        np.testing.assert_allclose(b.position, a.position * flip, atol=1e-5)
        np.testing.assert_allclose(b.opacity, a.opacity, atol=1e-5)
        np.testing.assert_allclose(b.scale, a.scale, rtol=1e-6)
    assert again.appearance == fg.SH(degree)


def test_ftgs_says_what_it_loses(tmp_path):
    model = random_model(np.random.default_rng(6), 40, "paper", "line", "window", "clamp")
    with pytest.warns(fg.LossWarning, match=r"becomes straight.*rotations over time.*decoder"):
        fg.save(model, tmp_path / "m.ftgs.ply")
    assert len(fg.load(tmp_path / "m.ftgs.ply")) == 40
