# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutated small files: plans and poses of runs, frames' times, verdicts on GPUs, hidden Gaussians, sizes of captures."""
from __future__ import annotations

import json

import mutations
import numpy as np
import tiny_captures

from fastgs_blender.cameras.camera import Camera
from fastgs_blender.cameras.lens import Lens
from fastgs_blender.captures import open_capture
from fastgs_blender.captures.posing import with_cameras
from fastgs_blender.captures.timestamps import FILE as TIMES
from fastgs_blender.captures.timestamps import read_times
from fastgs_blender.commands.info import describe_run, run_text
from fastgs_blender.jobs import checks
from fastgs_blender.kernels.gpu import choice
from fastgs_blender.rendering.masks import pack_mask, unpack_mask
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.initial import calibrate, refine
from fastgs_blender.training.run.files import REFINED, RUN, STATUS
from fastgs_blender.training.run.plan import Plan, Source, read_plan
from fastgs_blender.util.errors import FastGSError, printable_lines
from fastgs_blender.util.verdicts import Verdict, read_verdict


def test_the_plan_of_a_run(tmp_path):
    """run.json and status.json, as `fastgs info` shows them and as a resumed run takes them."""
    source = Source("/capture", "fastgs", 0.5, (0, 20, 2), ("cam00",))
    status = {"state": "training", "process": 5, "iteration": 20, "iterations": 100, "gaussians": 30, "held_out_psnr": 20.5}
    seed = {RUN: json.dumps(Plan(settings(iterations=100), source).to_dict()).encode(), STATUS: json.dumps(status).encode()}

    def read(folder):
        plan = read_plan(folder)
        assert plan.settings.iterations >= 1 and (plan.source.scale is None or 0 < plan.source.scale <= 1)
        facts = describe_run(folder)
        json.dumps(facts, allow_nan=False)
        assert all(printable_lines(text) == text for text in (run_text(facts, True), run_text(facts, False)))

    mutations.campaign("plan", read, {"run": seed}, tmp_path)


def test_poses_that_were_found(tmp_path):
    tiny_captures.pictures(tmp_path / "capture")
    capture = open_capture(tmp_path / "capture")
    cameras = {view: Camera(64, 48, 60.0, 60.0, 32.0, 24.0, tiny_captures.pose(i)) for i, view in enumerate(capture.views)}
    calibrate.keep(tmp_path / calibrate.FILE, capture, cameras, {view: Lens("opencv", (0.1,)) for view in cameras})

    def read(folder):
        known = calibrate.kept(folder / calibrate.FILE, capture)
        if known is not None:
            for shot in with_cameras(capture, *known).shots:
                assert np.isfinite(shot.camera.world_to_camera).all() and shot.camera.fx > 0 and shot.camera.fy > 0

    told = mutations.campaign("poses", read, {"two": {calibrate.FILE: (tmp_path / calibrate.FILE).read_bytes()}}, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0


def test_what_was_refined(tmp_path):
    tiny_captures.pictures(tmp_path / "capture")
    capture = open_capture(tmp_path / "capture")
    changes = {view: {"turn": [0.001, -0.002, 0.0], "shift": [0.0, 0.01, 0.02], "focal": 1.004} for view in capture.views}
    values = {"capture": str(capture.path.resolve()), "cameras": changes, "before": 1.2, "after": 0.4}

    def read(folder):
        known = refine.kept(folder / REFINED, capture)
        assert known is None or all(0.5 <= change["focal"] <= 2 and np.isfinite(change["turn"] + change["shift"]).all()
                                    for change in known["cameras"].values())

    told = mutations.campaign("refined", read, {"all": {REFINED: json.dumps(values).encode()}}, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0


def test_times_without_numbers_of_moments(tmp_path):
    rows = [f"{i},{10 + frame / 6 + 0.01 * i}" for frame in range(3) for i in range(2)]
    seeds = {"port": {TIMES: "\n".join(["port,frame_time", *rows, ""]).encode()}}

    def read(folder):
        times = read_times(folder / TIMES)
        assert times.count >= 1 and np.isfinite(times.fps) and times.fps > 0
        assert all(0 <= frame < times.count and 0 <= t <= 1 for taken in times.frames.values() for frame, t in taken)

    told = mutations.campaign("timestamps", read, seeds, tmp_path)
    assert min(told.values(), default=1) > 0
    many = "camera,frame_time\n" + "".join(f"a,{i}\nb,{i}.2\n" for i in range(20_000))
    mutations.attacks("timestamps", read, {"many": {TIMES: many.encode()}}, tmp_path, memory=256 << 20)


def test_verdicts_on_gpus(tmp_path, monkeypatch):
    seed = {choice.VERDICTS: json.dumps({
        "llvmpipe | 1 | Vulkan | abc": Verdict("", (1.5, 20.0), (9, 80)).values(),
        "other": Verdict("its pictures are wrong").values()}).encode()}

    def read(folder):
        monkeypatch.setattr(choice, "user_folder", lambda: folder)
        for values in choice._kept().values():
            found = read_verdict(values)
            assert found is None or (isinstance(found.fault, str) and isinstance(found.pace, str) and found.faster in (True, False))

    mutations.campaign("verdicts", read, {"two": seed}, tmp_path)


def test_times_too_large_for_a_float_are_none():
    """JSON holds integers of any length."""
    assert read_verdict({"self_test": "", "frame_ms": [1, 10**400], "step_ms": [1, 2]}) == Verdict("")


def test_hidden_gaussians(tmp_path):
    """The text of a mask, which an object in a .blend holds."""
    seed = {"mask": pack_mask(np.arange(500) % 3 == 0).encode()}

    def read(folder):
        bits = unpack_mask((folder / "mask").read_bytes().decode("utf-8", "surrogateescape"), 500)
        assert bits.shape == (500,) and bits.dtype == bool

    told = mutations.campaign("mask", read, {"third": seed}, tmp_path)
    assert told.get("refused", 0) == 0


def test_the_size_of_a_capture_that_nobody_looked_at(tmp_path):
    tiny_captures.fastgs(tmp_path / "made")

    def read(folder):
        sizes = checks.picture_size(str(folder))
        assert all(type(number) is int for number in sizes)
        if sizes == (0, 0, 0):
            raise FastGSError("nothing is known.")

    seed = {"cameras.json": (tmp_path / "made" / "cameras.json").read_bytes()}
    told = mutations.campaign("size", read, {"two": seed}, tmp_path / "seeds")
    assert min(told.values(), default=1) > 0
