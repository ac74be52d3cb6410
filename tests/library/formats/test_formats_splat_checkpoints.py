# SPDX-License-Identifier: GPL-3.0-or-later
"""Static checkpoints of gsplat and nerfstudio, in files that torch saves with their own layouts.

gsplat, examples/simple_trainer.py: `data = {"step": step, "splats": self.splats.state_dict()}; torch.save(data, ...)`, with pose_adjust
and app_module where these were trained.  It draws exp(scales), sigmoid(opacities), cat([sh0, shN]), sigmoid(app_module(...) + colors).
nerfstudio, engine/trainer.py: step, pipeline, optimizers, schedulers, scalers; models/splatfacto.py draws exp(scales), sigmoid(opacities),
features_dc and features_rest, and sigmoid(features_dc) where sh_degree is 0.  Both hand quaternions w x y z to gsplat, which normalises.
"""
from __future__ import annotations

import shutil
from pathlib import Path

import mutations
import numpy as np
import pytest
import torch
from evaluated import assert_shows, directions, spherical
from test_fuzz_static import usable

import fastgs_blender as fg
from fastgs_blender.formats import identify

pytestmark = pytest.mark.filterwarnings("error")
N = 12


def raw(rng, degree=3, count=N) -> dict[str, np.ndarray]:
    shapes = {"means": 3, "scales": 3, "quats": 4}
    out = {name: rng.normal(size=(count, width)) for name, width in shapes.items()}
    out |= {"opacities": rng.normal(size=count), "dc": rng.normal(size=(count, 3)),
            "rest": rng.normal(0, 0.3, (count, (degree + 1) ** 2 - 1, 3))}
    return {name: values.astype(np.float32) for name, values in out.items()}


def parameters(arrays):
    return torch.nn.ParameterDict({name: torch.nn.Parameter(torch.from_numpy(np.ascontiguousarray(a))) for name, a in arrays.items()})


def gsplat(path, arrays, renamed=(), **more):
    """simple_trainer's checkpoint."""
    table = {name: arrays[name] for name in ("means", "scales", "quats", "opacities")}
    table |= ({"sh0": arrays["dc"][:, None], "shN": arrays["rest"]} if "dc" in arrays
              else {name: arrays[name] for name in ("features", "colors")})
    for old, new in renamed:
        table[new] = table.pop(old)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"step": 29999, "splats": parameters(table).state_dict(), **more}, path)
    return path


def nerfstudio(path, arrays, prefix="_model.gauss_params.", **more):
    """A trainer's checkpoint with a pipeline of splatfacto: beside the Gaussians, other modules, and the state of Adam and a schedule."""
    gaussians = parameters({"means": arrays["means"], "scales": arrays["scales"], "quats": arrays["quats"], "features_dc": arrays["dc"],
                            "features_rest": arrays["rest"], "opacities": arrays["opacities"][:, None], **more})
    pipeline = torch.nn.Module()
    pipeline._model = torch.nn.Module()
    pipeline._model.lpips = torch.nn.Linear(3, 2)
    pipeline._model.register_buffer("device_indicator_param", torch.zeros(1))
    state = pipeline.state_dict()
    state.update({prefix + name: value for name, value in gaussians.state_dict().items()})
    optimisers = {name: torch.optim.Adam([value], lr=1e-3) for name, value in gaussians.items()}
    schedules = {name: torch.optim.lr_scheduler.LambdaLR(each, lambda step: 1.0) for name, each in optimisers.items()}
    for value in gaussians.values():
        value.grad = torch.zeros_like(value)
    for each in optimisers.values():
        each.step()
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"step": 29999, "pipeline": state, "optimizers": {k: v.state_dict() for k, v in optimisers.items()},
                "schedulers": {k: v.state_dict() for k, v in schedules.items()}, "scalers": torch.amp.GradScaler("cpu").state_dict()}, path)
    return path


def assert_model(model, arrays, colour=None):
    turn = arrays["quats"] / np.linalg.norm(arrays["quats"], axis=1, keepdims=True)
    coefficients = np.concatenate([arrays["dc"][:, None], arrays["rest"]], 1) if "dc" in arrays else None
    assert_shows(model, 0.0, position=arrays["means"], rotation=turn, scale=np.exp(arrays["scales"]),
                 opacity=1 / (1 + np.exp(-arrays["opacities"])),
                 colour=spherical(directions(len(model)), coefficients) if colour is None else colour)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("renamed", [(), (("means", "means3d"),)])
def test_gsplat(rng, tmp_path, degree, renamed):
    arrays = raw(rng, degree)
    path = gsplat(tmp_path / "ckpts" / "ckpt_29999_rank0.pt", arrays, renamed, pose_adjust={"embeds.weight": torch.zeros(3, 9)})
    assert identify(path).name == "gsplat checkpoint"
    model = fg.load(path)
    assert_model(model, arrays)
    assert (model.raster, model.axes) == (fg.Raster(alpha_max=0.999, near=0.01), "RDF")


@pytest.mark.parametrize("packed", [False, True])
def test_a_trainer_s_folder_and_its_zip(rng, tmp_path, packed):
    """The last step of both trainers, with what the settings beside it say; gsplat's ranks together."""
    arrays, early = raw(rng), raw(rng, count=3)
    for step, table in (("6999", early), ("29999", arrays)):
        for rank in range(2):
            gsplat(tmp_path / "gsplat" / "ckpts" / f"ckpt_{step}_rank{rank}.pt", table)
        nerfstudio(tmp_path / "splatfacto" / "nerfstudio_models" / f"step-{step:>09}.ckpt", table)
    (tmp_path / "gsplat" / "cfg.yml").write_text("antialiased: true\n")
    (tmp_path / "splatfacto" / "config.yml").write_text("    rasterize_mode: antialiased\n")
    for name, count in (("gsplat", 2 * N), ("splatfacto", N)):
        path = tmp_path / name
        if packed:
            path = Path(shutil.make_archive(str(path), "zip", path))
        for model in (fg.load(path), fg.open_source(path)):
            assert len(model) == count and model.raster.antialiased
            np.testing.assert_array_equal(model.position[:N], arrays["means"])


def test_gsplat_of_several_gpus(rng, tmp_path):
    """Each rank saves its own Gaussians: simple_viewer.py joins them with torch.cat."""
    parts = [raw(rng, 2, count) for count in (5, 7, 4)]
    for rank, arrays in enumerate(parts):
        gsplat(tmp_path / f"ckpt_6999_rank{rank}.pt", arrays)
    gsplat(tmp_path / "ckpt_29999_rank0.pt", parts[0])
    joined = {name: np.concatenate([each[name] for each in parts]) for name in parts[0]}
    for rank in range(3):
        assert_model(fg.load(tmp_path / f"ckpt_6999_rank{rank}.pt"), joined)
    assert len(fg.load(tmp_path / "ckpt_29999_rank0.pt")) == 5


def test_gsplat_with_a_network_of_appearance(rng, tmp_path):
    arrays = raw(rng)
    del arrays["dc"], arrays["rest"]
    arrays |= {"features": rng.normal(size=(N, 32)).astype(np.float32), "colors": rng.normal(size=(N, 3)).astype(np.float32)}
    path = gsplat(tmp_path / "m.pt", arrays, app_module={"embeds.weight": torch.zeros(3, 16)})
    with pytest.warns(fg.LossWarning, match="app_opt"):
        model = fg.load(path)
    assert_model(model, arrays, 1 / (1 + np.exp(-arrays["colors"])))


@pytest.mark.parametrize("prefix", ["_model.gauss_params.", "_model."])
@pytest.mark.parametrize("degree", [1, 3])
def test_nerfstudio(rng, tmp_path, degree, prefix):
    arrays = raw(rng, degree)
    path = nerfstudio(tmp_path / "nerfstudio_models" / "step-000029999.ckpt", arrays, prefix)
    assert identify(path).name.startswith("nerfstudio checkpoint")
    model = fg.load(path)
    assert_model(model, arrays)
    assert model.axes == "RFU" and not model.raster.antialiased


def test_nerfstudio_without_harmonics(rng, tmp_path):
    """splatfacto with sh_degree 0 learns logits of colours."""
    arrays = raw(rng, 0)
    model = fg.load(nerfstudio(tmp_path / "step-000000100.ckpt", arrays))
    assert_model(model, arrays, 1 / (1 + np.exp(-arrays["dc"])))


@pytest.mark.parametrize(("write", "file", "text"), [
    (gsplat, "cfg.yml", "absgrad: false\nantialiased: true\nbatch_size: 1\n"),
    (nerfstudio, "config.yml", "!!python/object:ns.X\n  model: !!python/object:Y\n    rasterize_mode: antialiased\n    sh_degree: 3\n")])
def test_the_settings_say_antialiased(rng, tmp_path, write, file, text):
    path = write(tmp_path / "run" / "models" / ("m.pt" if write is gsplat else "step-1.ckpt"), raw(rng))
    (tmp_path / "run" / file).write_text(text.replace("true", "false").replace(": antialiased", ": classic"))
    assert not fg.load(path).raster.antialiased
    (tmp_path / "run" / file).write_text(text)
    assert fg.load(path).raster.antialiased


def test_unknown_parameters_are_told(rng, tmp_path):
    path = nerfstudio(tmp_path / "step-1.ckpt", raw(rng), normals=np.zeros((N, 3), np.float32))
    with pytest.warns(fg.LossWarning, match="normals"):
        assert len(fg.load(path)) == N


def test_shapes_that_do_not_fit_are_refused(rng, tmp_path):
    arrays = raw(rng)
    for name, values in (("scales", arrays["scales"][:-1]), ("rest", arrays["rest"][:, :7]), ("dc", arrays["dc"][:, :2])):
        with pytest.raises(fg.FastGSError, match="shape"):
            fg.load(gsplat(tmp_path / "m.pt", arrays | {name: values}))


def test_pickles_that_call_something_are_refused(rng, tmp_path):
    class Evil:
        def __reduce__(self):
            return print, ("executed",)

    path = gsplat(tmp_path / "m.pt", raw(rng), more=Evil())
    with pytest.raises(fg.FastGSError, match="PyTorch|never executed|pickle"):
        fg.load(path)


def test_mutated_files(tmp_path):
    rng = np.random.default_rng(5)
    seeds = {}
    for name, write, degree in (("m.pt", gsplat, 1), ("m.ckpt", nerfstudio, 1), ("plain.ckpt", nerfstudio, 0)):
        seeds[name] = {"m": write(tmp_path / "made" / name, raw(rng, degree, 5)).read_bytes()}
    told = mutations.campaign("static checkpoints", lambda folder: usable(folder / "m"), seeds, tmp_path / "seeds")
    assert min(told.values(), default=1) > sum(told.values()) / 30
