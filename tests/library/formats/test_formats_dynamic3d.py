# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamic 3D Gaussians: params.npz against what the original shows at every frame, and straight lines in between.

Transcribed from JonathonLuiten/Dynamic3DGaussians@7dbbd4d: helpers.py, params2rendervar, lines 34-43 (quaternions are normalised there),
and save_params, 94-102, as visualize.py, load_scene_data, reads it.
"""
from __future__ import annotations

import io

import mutations
import numpy as np
import pytest
from evaluated import assert_shows

import fastgs_blender as fg

T, N = 7, 11


def params(rng, frames=T) -> dict[str, np.ndarray]:
    arrays = {"means3D": rng.normal(size=(frames, N, 3)), "rgb_colors": rng.uniform(0, 1, (frames, N, 3)),
              "unnorm_rotations": rng.normal(size=(1, N, 4)) + 0.4 * rng.normal(size=(frames, N, 4)),
              "logit_opacities": rng.normal(size=(N, 1)), "log_scales": rng.normal(-3, 0.5, (N, 3)), "seg_colors": rng.uniform(size=(N, 3)),
              "cam_m": np.zeros((4, 3)), "cam_c": np.zeros((4, 3))}
    arrays["unnorm_rotations"][1::2] *= -3  # the same rotations
    return {key: value.astype(np.float32) for key, value in arrays.items()}


def shown(a, frame: float) -> dict:
    """helpers.py's params2rendervar() at whole frames; between them straight lines, rotations on the nearer side."""
    first = int(np.clip(np.floor(frame), 0, len(a["means3D"]) - 1))
    second, share = min(first + 1, len(a["means3D"]) - 1), np.clip(frame - first, 0, 1)
    q = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in a["unnorm_rotations"][[first, second]].astype(np.float64)]
    q[1] *= np.sign((q[0] * q[1]).sum(1, keepdims=True))
    opacity = 1 / (1 + np.exp(-a["logit_opacities"].astype(np.float64)[:, 0]))
    mix = {key: (1 - share) * a[key][first].astype(np.float64) + share * a[key][second] for key in ("means3D", "rgb_colors")}
    return {"position": mix["means3D"], "rotation": (1 - share) * q[0] + share * q[1], "opacity": opacity,
            "scale": np.broadcast_to(np.exp(a["log_scales"].astype(np.float64)), (N, 3)), "colour": mix["rgb_colors"]}


@pytest.mark.parametrize("change", [lambda a: a, lambda a: a | {"log_scales": a["log_scales"][:, :1]},
                                    lambda a: a | {"rgb_colors": np.repeat(a["rgb_colors"][:1], T, 0)},
                                    lambda a: {k: v[:1] if v.shape[:2] == (T, N) else v for k, v in a.items()}])
def test_every_frame_and_between(tmp_path, rng, change):
    a, path = change(params(rng)), tmp_path / "params.npz"
    for write in (np.savez, np.savez_compressed):
        write(path, **a)
        model = fg.load(path)
        assert model.clip.frame_count == len(a["means3D"])
        for frame in (0, 1, 2.5, 3.25, 5, 6, 7.5, -1):
            assert_shows(model, model.clip.t_of_frame(frame), **shown(a, frame))


def test_colours_of_all_frames(tmp_path, rng):
    """A still colour costs nothing; one for all frames may have no axis of time; what changes survives our own file."""
    a, path = params(rng), tmp_path / "params.npz"
    np.savez(path, **a | {"rgb_colors": a["rgb_colors"][0]})
    assert fg.load(path).appearance == fg.RGB()
    np.savez(path, **a)
    fg.save(fg.load(path), tmp_path / "a.safetensors")
    assert_shows(fg.load(tmp_path / "a.safetensors"), 2.5 / T, **shown(a, 2.5))
    with pytest.warns(fg.LossWarning, match="change in time"):
        fg.save(fg.load(path), tmp_path / "a.splatv")
    still = fg.freeze(fg.load(path), 2.5 / T)
    np.testing.assert_allclose(still.features, shown(a, 2.5)["colour"], atol=1e-6)


@pytest.mark.parametrize(("change", "said"), [
    ({"means3D": np.zeros((T, 3))}, "frames x Gaussians"), ({"unnorm_rotations": np.zeros((T, N, 3))}, "array unnorm_rotations has"),
    ({"rgb_colors": np.zeros((T - 1, N, 3))}, "array rgb_colors has"), ({"logit_opacities": np.zeros((T, N, 1))}, "change in time"),
    ({"rgb_colors": np.array(["a"])}, "rgb_colors.*missing")])
def test_wrong_shapes(tmp_path, rng, change, said):
    np.savez(tmp_path / "a.npz", **params(rng) | change)
    with pytest.raises(fg.FastGSError, match=said):
        fg.load(tmp_path / "a.npz")


def test_damaged_files(tmp_path, rng):
    contents = {}
    for name, write in (("stored", np.savez), ("packed", np.savez_compressed)):
        out = io.BytesIO()
        write(out, **{key: value[:3] if value.ndim == 3 else value for key, value in params(rng).items()})
        contents[name] = {"m": out.getvalue()}
    mutations.campaign("dynamic3d", mutations.shows("m"), contents, tmp_path)
