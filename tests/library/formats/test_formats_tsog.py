# SPDX-License-Identifier: GPL-3.0-or-later
"""`.tsog` against the formulas of its specification, on packages written here.

OpsiClear-4DGS/FreeTimeGsVanilla, TSOG Playback Profile 1, version 1.0.1, sections 5 to 8: quaternions are normalised (5.2), the deviation
is linear (6.3), a discrete frame is min(N - 1, q // delta) (6.2).
"""
from __future__ import annotations

import io
import json
import zipfile

import mutations
import numpy as np
import pytest
from evaluated import assert_shows, directions, spherical
from PIL import Image

import fastgs_blender as fg

N, SIDE = 14, 4
TIMES = (-0.1, 0.0, 0.31, 0.5, 0.77, 1.0)


def package(rng, timeline=None, motion=0, degree=0, **more) -> tuple[bytes, dict]:
    """A package, and its pictures [N, 4] by name."""
    size = SIDE * SIDE
    names = ("means_l", "means_u", "scales", "quats", "sh0", "time_l", "time_u", "v_l", "v_u")
    pixels = {name: rng.integers(0, 256, (size, 4)) for name in names}
    pixels["quats"] = np.concatenate([rng.integers(60, 196, (size, 3)), rng.integers(252, 256, (size, 1))], 1)
    meta = {"version": 4, "count": N, "means": {"mins": [-1, -2, 0], "maxs": [1, 1.5, 2], "files": ["means_l.webp", "means_u.webp"]},
            "scales": {"codebook": np.linspace(-5, -1, 256).tolist(), "files": ["scales.webp"]}, "quats": {"files": ["quats.webp"]},
            "sh0": {"codebook": np.linspace(-2, 2, 256).tolist(), "files": ["sh0.webp"]}} | more
    if timeline is not None:
        meta["timeline"] = timeline | {"files": ["time_l.webp", "time_u.webp"]}
    if motion:
        meta["temporal"] = {"means": {"mins": [[-1, -1, -2]], "maxs": [[1, 2, 1]], "files": ["v_l.webp", "v_u.webp"][:motion]}}
    shapes = dict.fromkeys(pixels, (SIDE, SIDE))
    if degree:
        width = (degree + 1) ** 2 - 1
        pixels["centroids"], shapes["centroids"] = rng.integers(0, 256, (64 * width, 4)), (1, 64 * width)
        pixels["labels"], shapes["labels"] = np.zeros((size, 4), int), (SIDE, SIDE)
        pixels["labels"][:, 0] = rng.integers(0, 40, size)
        meta["shN"] = {"bands": degree, "count": 40, "codebook": np.linspace(-0.5, 0.5, 256).tolist(),
                       "files": ["centroids.webp", "labels.webp"]}
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, values in pixels.items():
            picture = io.BytesIO()
            Image.fromarray(values.astype(np.uint8).reshape(*shapes[name], 4)).save(picture, "WEBP", lossless=True, exact=True)
            archive.writestr(f"{name}.webp", picture.getvalue())
    return out.getvalue(), {name: values.astype(np.float64) for name, values in pixels.items()}


def shown(p, t: float, kind, motion=0, degree=0, frames=1) -> dict:
    """Sections 5 to 7 of the specification."""
    p = {name: values if name == "centroids" else values[:N] for name, values in p.items()}
    low, high = np.array([-1, -2, 0]), np.array([1, 1.5, 2])
    v = low + (high - low) * (p["means_l"][:, :3] + 256 * p["means_u"][:, :3]) / 65535
    position, opacity = np.sign(v) * np.expm1(np.abs(v)), p["sh0"][:, 3] / 255
    q = np.zeros((N, 4))
    for i, (*kept, tag) in enumerate(p["quats"]):
        kept = (2 * np.array(kept) / 255 - 1) / np.sqrt(2)
        q[i] = np.insert(kept, int(tag) - 252, np.sqrt(max(0, 1 - np.sum(kept**2))))
    code = p["time_l"] + 256 * p["time_u"]
    if kind == 0:
        opacity = opacity * (np.minimum(frames - 1, code[:, 0] // (65536 // frames)) == np.floor(t * frames))
    elif kind == 1:
        centre, sigma = -0.2 + 1.4 * code[:, 0] / 65535, 0.05 + 0.75 * code[:, 1] / 65535
        opacity = opacity * np.exp(-0.5 * ((t - centre) / sigma) ** 2)
        share = p["v_l"][:, :3] / 255 if motion == 1 else (p["v_l"][:, :3] + 256 * p["v_u"][:, :3]) / 65535
        position = position + (np.array([-1, -1, -2]) + np.array([2, 3, 3]) * share) * (t - centre)[:, None] * bool(motion)
    coefficients = np.linspace(-2, 2, 256)[p["sh0"][:, :3].astype(int)][:, None]
    if degree:
        table = np.linspace(-0.5, 0.5, 256)[p["centroids"][:, :3].astype(int)].reshape(64, -1, 3)
        coefficients = np.concatenate([coefficients, table[p["labels"][:, 0].astype(int)]], 1)
    scale = np.exp(np.linspace(-5, -1, 256)[p["scales"][:, :3].astype(int)])
    return {"position": position, "rotation": q, "opacity": opacity, "scale": scale,
            "colour": spherical(directions(N), coefficients)}


BELL = {"type": 1, "mins": [-0.2, 0.05], "maxs": [1.2, 0.8]}


@pytest.mark.parametrize(("motion", "degree"), [(0, 0), (1, 1), (2, 3)])
def test_continuous(tmp_path, rng, motion, degree):
    data, pixels = package(rng, BELL, motion, degree, playback={"duration": 5, "fps": 24})
    (tmp_path / "a.tsog").write_bytes(data)
    model = fg.load(tmp_path / "a.tsog")
    assert (model.clip.frame_count, model.clip.duration) == (120, 5)
    for t in TIMES:
        assert_shows(model, t, **shown(pixels, t, 1, motion, degree))


def test_discrete_and_static(tmp_path, rng):
    data, pixels = package(rng, {"type": 0, "N": 7, "delta": 65536 // 7}, fps=12)
    (tmp_path / "a.tsog").write_bytes(data)
    model = fg.load(tmp_path / "a.tsog")
    assert (model.clip.frame_count, model.clip.fps) == (7, 12)
    for frame in (0, 1, 2.5, 3, 6, 6.9):
        assert_shows(model, frame / 7, **shown(pixels, frame / 7, 0, frames=7))
    data, pixels = package(rng)
    (tmp_path / "b.tsog").write_bytes(data)
    assert_shows(fg.load(tmp_path / "b.tsog"), 0.3, **shown(pixels, 0.3, None))


@pytest.mark.parametrize(("more", "said"), [
    ({"profile": {"id": "another", "version": 1}}, "profile"), ({"temporal": {"scales": {}}}, "positions.*supported"),
    ({"playback": {"fps": 0}}, "playback")])
def test_what_is_not_known(tmp_path, rng, more, said):
    (tmp_path / "a.tsog").write_bytes(package(rng, BELL, **more)[0])
    with pytest.raises(fg.FastGSError, match=said):
        fg.load(tmp_path / "a.tsog")


def test_damaged_files(tmp_path, rng):
    frames = {"type": 0, "N": 7, "delta": 65536 // 7}
    contents = {"continuous": {"m": package(rng, BELL, 2, 1)[0]}, "discrete": {"m": package(rng, frames)[0]}}
    mutations.campaign("tsog", mutations.shows("m"), contents, tmp_path)
