# SPDX-License-Identifier: GPL-3.0-or-later
"""benchmarks/gpu.py and `fastgs bench --device` measure the GPU itself."""
from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.kernels.gpu import choice
from fastgs_blender.util.verdicts import Verdict

BENCHMARKS = Path(__file__).resolve().parents[4] / "benchmarks"


def test_the_benchmark_runs_small_on_any_adapter(gpu, adapter, tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    bench = importlib.import_module("gpu")
    monkeypatch.setattr(bench, "AT_ONCE", 1)
    bench.main(["--device", adapter.name, "--gaussians", "300", "--sizes", "48x32", "--step-gaussians", "300", "--step-size", "48x32",
                "--runs", "1", "--json", str(tmp_path / "figures.json")])
    found = json.loads((tmp_path / "figures.json").read_text())
    assert found["machine"]["adapter"] == adapter.name and "training step" in capsys.readouterr().out
    stages, frames, step = (found[key] for key in ("stages, 300 Gaussians, 48 x 32", "4D frames, 300 Gaussians, 48 x 32", "training step"))
    names = ("slice and project", "sort", "tiles and rasterise")
    assert all(stages[f"{name}, {where} ms"] > 0 for name in names for where in ("GPU", "CPU"))
    assert frames["GPU, pictures stay there, frames a second"] > 0 and step["GPU ms"] > 0 and step["CPU ms"] > 0
    assert gpu.failed is None


def test_the_profile_names_every_stage(adapter, tmp_path, monkeypatch):
    if "timestamp-query" not in adapter.native.features:
        pytest.skip("this adapter has no clock")
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    bench = importlib.import_module("gpu_profile")
    bench.main(["--device", adapter.name, "--gaussians", "300", "--size", "48x32", "--runs", "2", "--json", str(tmp_path / "figures.json")])
    found = json.loads((tmp_path / "figures.json").read_text())
    for stages, names in ((found["frame"], ("project", "raster")), (found["training step"], ("raster_backward", "adam"))):
        assert all(any(label.startswith(f"{name} x") and value > 0 for label, value in stages.items()) for name in names)
        assert stages["dispatches"] > len(names) and stages["GPU busy, ms"] > 0


def test_stages_are_the_gpus(gpu, adapter, monkeypatch, tmp_path, capsys):
    rng = np.random.default_rng(1)
    model = fg.GaussianModel(position=rng.uniform(-1, 1, (50, 3)), rotation=rng.normal(size=(50, 4)), scale=np.full((50, 3), -2.0),
                             opacity=np.ones(50), features=rng.uniform(0, 1, (50, 3)))
    fg.save(model, tmp_path / "model.safetensors")
    monkeypatch.setattr(choice, "verdict", lambda adapter, again=False: Verdict(""))
    asked = []
    measure = type(gpu).measure_stages
    monkeypatch.setattr(type(gpu), "measure_stages", lambda self, *given: asked.append(self) or measure(self, *given))
    arguments = ["bench", str(tmp_path / "model.safetensors"), "--device", adapter.name, "--size", "48x32", "--repeat", "1", "--json"]
    assert cli.main(arguments) in (0, None)
    assert asked == [gpu] and json.loads(capsys.readouterr().out)["visible"] > 0
