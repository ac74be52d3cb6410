# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutated small files that the scene reads by itself: what a capture was filmed from, the cameras of a filming, the report of a run."""
from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

REPORT = {"held_out_psnr": 31.25, "held_out_foreground_psnr": 28.5, "held_out_views": ["cam00", "cam07"], "device": "the processor",
          "gaussians": 12345, "model_bytes": 2.5e6, "iterations": 3000, "seconds": 754.5, "model": "/run/model.safetensors",
          "settings": {"iterations": 3000, "motion": "fourier", "order": None}}


@pytest.fixture
def campaign(monkeypatch, fg, tmp_path):
    """campaign(name, read, seed): as mutations.campaign() in the library's tests."""
    for folder in (Path(__file__).resolve().parents[3], Path(__file__).resolve().parents[2] / "library"):
        monkeypatch.syspath_prepend(str(folder))
    import mutations

    def run(name, read, seed):
        def told(folder):
            try:
                read(folder)
            except fg.FastGSError as error:  # of the extension's library; campaigns know the one of that beside it
                raise mutations.FastGSError(error) from error.__cause__

        return mutations.campaign(name, told, {"one": seed}, tmp_path / name)

    return run


def test_the_report_of_a_run(module, campaign):
    results, files = module("scene.training.results"), module("fastgs_blender.training.run.files")

    def read(folder):
        text = results.report_of(SimpleNamespace(out=str(folder))).text
        text.encode()
        assert all(line == module("fastgs_blender.util.errors").printable(line) for line in text.splitlines())

    told = campaign("report", read, {files.REPORT: json.dumps(REPORT).encode()})
    assert min(told.values(), default=1) > 0


def test_what_was_filmed(scene, module, campaign):
    film, results = module("scene.filming.film"), module("scene.training.results")

    def read(folder):
        assert all(isinstance(name, str) for name in film.filmed_objects(folder))
        results.hide_originals(bpy.context, str(folder))

    told = campaign("filmed", read, {film.FILMED: json.dumps({"objects": ["Cube", "Émile", "Cube.001"]}).encode()})
    assert told.get("refused", 0) == 0


def test_a_capture_that_is_filmed_on(scene, module, fg, campaign, tmp_path):
    """cameras.json of a folder: it is that of the same filming, or the folder is refused and stays as it is."""
    film, layout = module("scene.filming.film"), module("fastgs_blender.captures.layouts.fastgs")
    plan = film.Plan(1, 2, width=64, height=48, count=3)
    views = film._rig(plan, SimpleNamespace(radius=1.0, centre=(0.0, 0.0, 0.0)))
    made = tmp_path / "made"
    film._describe(made, scene, plan, views)

    def read(folder):
        before = (folder / layout.FILE).read_bytes()
        film._describe(folder, scene, plan, views)
        assert (folder / layout.FILE).read_bytes() == before

    told = campaign("filming", read, {layout.FILE: (made / layout.FILE).read_bytes()})
    assert min(told.values(), default=1) > 0
