# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutated files of the dynamic formats whose own tests have no campaign, of cfg_args, and of headers as full as they get."""
from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import mutations
import numpy as np
import ply_files
import pytest
import test_formats_ex4dgs
import test_formats_straight
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.commands.info import describe, model_text
from fastgs_blender.evaluation import training_record
from fastgs_blender.formats import torch_zip
from fastgs_blender.model.surroundings import Backdrop, Surroundings, Viewpoint
from fastgs_blender.util.errors import printable_lines

N = 5
pytestmark = pytest.mark.filterwarnings("ignore::fastgs_blender.LossWarning")


def static(rng, degree: int = 1) -> dict[str, np.ndarray]:
    """Columns of an INRIA PLY."""
    rest = 3 * ((degree + 1) ** 2 - 1)
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(rest)), "opacity",
             *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    return {name: rng.normal(-1 if name.startswith("scale") else 0, 0.5, N).astype(np.float32) for name in names}


def supersplat(rng) -> dict[str, dict[str, bytes]]:
    table = static(rng) | {f"motion_{i}": rng.normal(size=N) for i in range(3)}
    table |= {"trbf_center": rng.uniform(0, 3, N), "trbf_scale": rng.normal(size=N)}
    said = ["cfg_args: start=2.0, duration=3.0, fps=20.0, sh_degree=1"]
    return {"comment": {"m.ply": ply_files.ply(table, comments=said)},
            "cfg_args": {"m.ply": ply_files.ply(table), "cfg_args": b"Namespace(start=2.0, duration=3.0, fps=20.0)"}}


def freetime(rng) -> dict[str, dict[str, bytes]]:
    """FreeTimeGS++: gates that are open or shut, and gates between, which make a model of each time."""
    renamed = {"sh0": "sh_0", "shN": "sh_n", "velocities": "velocity_model"}
    arrays = {renamed.get(name, name): value for name, value in test_formats_straight.raw(rng, 3).items()}
    count = len(arrays["means"])
    gates = {"open or shut": np.where(np.arange(count) % 2, -1.0, 1.0), "between": np.linspace(-0.1, 0.1, count)}
    return {name: {"m.npz": test_formats_straight.zip_of(arrays | {"marginal_gates": gate.astype(np.float32)[:, None]})}
            for name, gate in gates.items()}


def deformable(folder: Path, rng, six: bool) -> dict[str, bytes]:
    """Deformable-3DGS with a small network."""
    def layer(name, out, size):
        weights[f"{name}.weight"], weights[f"{name}.bias"] = rng.normal(0, 0.3, (out, size)), rng.normal(0, 0.1, out)

    weights: dict[str, np.ndarray] = {}
    layer("linear.0", 6, 84)
    layer("linear.1", 6, 6)
    for name, out in (("branch_w", 3), ("branch_v", 3)) if six else (("gaussian_warp", 3),):
        layer(name, out, 90)
    layer("gaussian_rotation", 4, 90)
    layer("gaussian_scaling", 3, 90)
    torch_zip.write(folder / "deform.pth", {name: value.astype(np.float32) for name, value in weights.items()})
    return {"point_cloud/iteration_9/point_cloud.ply": ply_files.ply(static(rng)), "cfg_args": b"Namespace(sh_degree=1, is_blender=False)",
            "deform/iteration_9/deform.pth": (folder / "deform.pth").read_bytes()}


@pytest.mark.parametrize(("name", "file", "made"), [("supersplat ply", "m.ply", supersplat), ("freetime++", "m.npz", freetime)])
def test_files_of_one_part(tmp_path, rng, name, file, made):
    told = mutations.campaign(name, mutations.shows(file), made(rng), tmp_path)
    assert min(told.values(), default=1) > 0


def test_deformable(tmp_path, rng):
    seeds = {name: deformable(tmp_path, rng, six) for name, six in (("shift", False), ("screw", True))}
    told = mutations.campaign("deformable", mutations.shows("point_cloud/iteration_9/point_cloud.ply"), seeds, tmp_path)
    assert min(told.values(), default=1) > 0


def test_numbered_files(tmp_path, rng):
    """A damaged frame fails alone, when it is shown."""
    seed = {}
    for i in (1, 2, 4):
        fg.save(random_model(rng, N), tmp_path / "m.splat")
        seed[f"frame_{i}.splat"] = (tmp_path / "m.splat").read_bytes()
    told = mutations.campaign("numbered files", mutations.shown, {"splat": seed}, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0


def test_cfg_args(tmp_path, rng):
    """The settings of trainers that models are read with: one file for four formats."""
    seeds = {"supersplat": {"m.ply": supersplat(rng)["cfg_args"]["m.ply"], "cfg_args": b"Namespace(start=2.0, duration=3.0, fps=20.0)"},
             "ex4dgs": test_formats_ex4dgs.files(rng)[0]}

    def read(folder):
        mutations.shown(next(folder / name for name in ("m.ply", "dynamic_point_cloud.ply") if (folder / name).exists()))

    told = mutations.campaign("cfg_args", read, seeds, tmp_path, fixed=["m.ply", "point_cloud.ply", "dynamic_point_cloud.ply"])
    assert min(told.values(), default=1) > 0


def test_everything_that_a_header_may_say(tmp_path):
    """What `fastgs info` shows of it, and what evaluation and training believe of it."""
    view = Viewpoint(width=640, height=360, fx=500.0, fy=500.0, cx=320.0, cy=180.0, position=(1.0, 2.0, 3.0), distance=4.0, name="first")
    around = Surroundings(Backdrop((0.5, 0.0, 1.0), 4.0), (view, replace(view, name="second")), view)
    facts = {"clocks": {"a": 0.5}, "exposures": {"a": {"gain": [1.0, 1.1, 0.9], "bias": [0.0, 0.01, 0.0]}},
             "cameras": {"a": {"turn": [0.0, 0.01, 0.0], "shift": [0.0, 0.0, 0.1], "focal": 1.01}}}
    origin = {"settings": "{}", "trained_on": '{"views": ["a", "b"], "scale": 0.5}', **training_record.corrections_entry(facts)}
    model = replace(random_model(np.random.default_rng(3), N, "keys", "smooth keys", "radial-window", "changing sh1"),
                    surroundings=around, provenance=origin)
    fg.save(model, tmp_path / "m.safetensors")

    def read(folder):
        found = describe(folder / "m.safetensors")
        json.dumps(found, allow_nan=False)
        assert all(printable_lines(text) == text for text in (model_text(found, True), model_text(found, False)))
        with warnings.catch_warnings():
            model = fg.load(folder / "m.safetensors")
        known, evened = training_record.recorded(model), training_record.corrections(model)
        assert known is None or not known.saw("c", 0.0, 1) or "c" in known.views
        assert isinstance(training_record.sentence(evened), str)

    seeds = {"full": {"m.safetensors": (tmp_path / "m.safetensors").read_bytes()}}
    told = mutations.campaign("header", read, seeds, tmp_path)
    assert min(told.values(), default=1) > 0
