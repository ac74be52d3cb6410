# SPDX-License-Identifier: GPL-3.0-or-later
"""Which device is used: adapters, the self-test and its verdicts, the command line, and a run whose GPU fails."""
from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from toy_captures import toy_capture

import fastgs_blender as fg
from fastgs_blender.kernels import made
from fastgs_blender.kernels.cpu.backend import CPU
from fastgs_blender.kernels.gpu import adapters, choice, pace, selftest
from fastgs_blender.kernels.gpu.backend import GPU
from fastgs_blender.kernels.gpu.device import Device, Failure
from fastgs_blender.kernels.gpu.selftest import self_test
from fastgs_blender.training.core import settings
from fastgs_blender.training.run import plan as plans
from fastgs_blender.training.run import session
from fastgs_blender.util.backends import choose_device, load_backend
from fastgs_blender.util.verdicts import Verdict, read_verdict


def card(name, kind="DiscreteGPU"):
    info = {"device": name, "description": "driver 1", "backend_type": "Vulkan", "adapter_type": kind}
    return SimpleNamespace(info=info, limits={"max-storage-buffer-binding-size": 1 << 27, "max-buffer-size": 1 << 28})


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """machine(cards ..., wrong={name: fault}, slow={names}): a machine with these cards; returns the list of those that were tested."""
    import wgpu
    import wgpu.backends.wgpu_native.extras  # this makes wgpu.gpu what it will be

    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path))
    tested = []

    def make(*cards, wrong=(), slow=()):
        def verdict(each):
            tested.append(each.name)
            fault = dict(wrong).get(each.name, "")
            return Verdict(fault) if fault else Verdict("", (40.0 if each.name in slow else 5.0, 20.0), (30.0, 90.0))

        adapters.adapters.cache_clear()
        monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", lambda: list(cards))
        monkeypatch.setattr(choice, "self_test", verdict)
        return tested

    yield make
    adapters.adapters.cache_clear()


def test_auto_takes_the_best_that_passes_and_remembers(machine, monkeypatch):
    soft, inner, arc = card("llvmpipe", "CPU"), card("UHD", "IntegratedGPU"), card("Arc A770")
    tested = machine(soft, inner, arc)
    assert choose_device("auto")[0] == "gpu:Arc A770" and choose_device("gpu") == ("gpu:Arc A770", "") == choose_device("a77")
    assert tested == ["Arc A770"]  # once
    assert choose_device("llvm") == ("gpu:llvmpipe", "") and choose_device("cpu") == ("auto", "")
    arc.info["description"] = "driver 2"
    machine(soft, inner, arc, wrong={"Arc A770": "its pictures are wrong by 1"})
    name, about = choose_device("auto")
    assert name == "gpu:UHD" and tested[-2:] == ["Arc A770", "UHD"] and "UHD is used" in about
    failed = "Arc A770 has failed the self-test (its pictures are wrong by 1): the CPU is used."
    assert choose_device("gpu") == ("auto", failed) == choose_device("a77"), "by its name neither"
    assert choose_device("a77", lambda each: None) == ("auto", "Arc A770 has not been tested yet: the CPU is used.")
    machine(soft, arc, wrong={})
    assert choose_device("auto") == ("auto", failed)
    monkeypatch.setenv("LOCAL_RANK", "1")
    machine(soft, card("one"), card("two"))
    assert choose_device("gpu")[0] == "gpu:two"
    monkeypatch.setenv("FASTGS_DEVICE", "one")
    assert choose_device()[0] == "gpu:one"


def test_without_a_gpu_the_cpu_is_used_and_a_line_says_so(machine, monkeypatch):
    machine(card("llvmpipe", "CPU"))
    assert choose_device("auto") == ("auto", "no GPU was found, only the software llvmpipe: the CPU is used.")
    with pytest.raises(fg.FastGSError, match="no GPU.*llvmpipe.*cpu"):
        load_backend("gpu")
    with pytest.raises(fg.FastGSError, match="'arc'.*llvmpipe"):
        choose_device("arc")
    machine()
    assert choose_device("auto") == ("auto", "no GPU was found: the CPU is used.")
    monkeypatch.setitem(__import__("sys").modules, "wgpu", None)
    adapters.adapters.cache_clear()
    assert "wgpu" in choose_device("auto")[1]


def test_a_test_that_ends_the_program_is_not_tried_again(machine, monkeypatch, tmp_path):
    machine(card("Arc"))

    def dies(each):
        raise SystemExit

    monkeypatch.setattr(choice, "self_test", dies)
    with pytest.raises(SystemExit):
        choose_device("auto")
    assert "to its end" in choose_device("auto")[1]
    (tmp_path / "gpus.json").write_text("{damaged")
    machine(card("Arc"))
    assert choose_device("auto")[0] == "gpu:Arc"
    assert [each["self_test"] for each in json.loads((tmp_path / "gpus.json").read_text()).values()] == [""]


@pytest.mark.slow
def test_the_self_test_passes_here_and_finds_what_is_wrong(adapter, fresh, monkeypatch):
    sound = SimpleNamespace(open=lambda: fresh.backend.device, software=True)
    assert self_test(sound) == Verdict(""), "software is tested, and no time is taken"
    run = Device.run
    for stage, what in (("raster", "pictures"), ("project_backward", "gradients")):
        def wrong(self, name, threads, parameters, *buffers, stage=stage, **rest):
            if name == stage == "raster":
                parameters = [[*np.add(parameters[0], (0, 1, 0, 1))], *parameters[1:]]
            if name == stage == "project_backward":
                parameters = [np.asarray(parameters[0]) * 1.1, *parameters[1:]]
            return run(self, name, threads, parameters, *buffers, **rest)

        with monkeypatch.context() as patch:
            patch.setattr(Device, "run", wrong)
            assert what in self_test(sound).fault
    monkeypatch.setattr(GPU, "compare", lambda *rest: (_ for _ in ()).throw(Failure("it is lost")))
    assert self_test(sound) == Verdict("it is lost")


def clock(gpu, cpu):
    """A clock for pace(): each piece of work takes so many seconds, by turns."""
    times = np.cumsum([0, *[gpu, 0, cpu, 0] * pace.ROUNDS * 2])
    return iter(times).__next__


def passing(monkeypatch):
    """The self-test without its comparisons, of a GPU that is the processor."""
    monkeypatch.setattr(selftest, "WORKS", {})
    monkeypatch.setattr(selftest, "MANY_SPLATS", 50)
    monkeypatch.setattr(selftest, "FRAME", (16, 16))
    monkeypatch.setattr(selftest, "GPU", lambda open_: SimpleBackend())


class SimpleBackend(CPU):
    failed, too_large = None, ""


def test_auto_takes_only_what_is_faster_and_says_why(machine, monkeypatch):
    machine(card("Arc"))
    passing(monkeypatch)
    for gpu, cpu, taken, words in ((0.4, 0.2, "auto", ("not faster", "100 ms", "50 ms", "the CPU is used")),
                                   (0.2, 0.4, "gpu:Arc", ("Arc is used", "faster", "100 ms", "50 ms")),
                                   (0.2, 0.2, "auto", ("not faster",))):
        monkeypatch.setattr(choice, "self_test", lambda each, gpu=gpu, cpu=cpu: self_test(each, clock(gpu, cpu)))
        choice.verdict(adapters.adapters()[0], again=True)
        name, about = choose_device("auto")
        assert name == taken and all(word in about for word in words), about
        assert choose_device("gpu") == ("gpu:Arc", ""), "who names it gets it"
        assert choice.describe(test=False)["auto"] == ("Arc" if taken != "auto" else None)


@pytest.mark.parametrize(("frame", "step"), [((9.0, 8.0), (1.0, 8.0)), ((1.0, 8.0), (9.0, 8.0)), (None, None)])
def test_both_a_frame_and_a_step_must_be_faster(machine, frame, step):
    machine(card("Arc"))
    assert choose_device("auto", lambda each: Verdict("", frame, step))[0] == "auto"


def test_the_next_gpu_is_taken_where_the_first_is_slow(machine):
    machine(card("UHD", "IntegratedGPU"), card("Old"), slow={"Old"})
    assert choose_device("auto")[0] == "gpu:UHD"


def test_a_gpu_that_is_far_behind_is_not_measured_for_long(monkeypatch):
    model, camera, calls = selftest._model(selftest.SH(1), 50), made.made_camera(16, 16), []
    monkeypatch.setattr(SimpleBackend, "draw", lambda self, *given: calls.append(1) or CPU.draw(self, *given))
    found = pace.pace(SimpleBackend(), CPU(), model, camera, iter(np.cumsum([0, 1, 0, 0.1] * 2)).__next__)
    assert len(calls) == 1 + pace.AT_ONCE and found["frame"] == pytest.approx((250, 25)) == found["step"]


def test_the_pace_of_a_real_adapter_is_taken(shared_gpu, adapter, monkeypatch):
    """Its frames and steps come to their end, and each time is of the backend that worked."""
    ran, run = [], Device.run
    monkeypatch.setattr(Device, "run", lambda self, name, *given, **rest: ran.append(name) or run(self, name, *given, **rest))
    found = pace.pace(shared_gpu, CPU(), selftest._model(selftest.SH(1), 300, 1.0), made.made_camera(96, 64), clock(0.4, 0.2))
    assert found == {name: pytest.approx((100, 50)) for name in ("frame", "step")} and not Verdict("", **found).faster
    assert shared_gpu.failed is None and {"raster", "project_backward"} <= set(ran)


def test_stored_verdicts_that_are_damaged_are_none():
    assert read_verdict({}) is None and read_verdict({"self_test": 1}) is None
    assert read_verdict({"self_test": "", "frame_ms": [1.0, 2.0], "step_ms": [3, 4]}) == Verdict("", (1.0, 2.0), (3.0, 4.0))
    for pair in ([1.0], [0.0, 1.0], [float("nan"), 1.0], ["1", 2], None):
        assert read_verdict({"self_test": "", "frame_ms": pair, "step_ms": [3.0, 4.0]}) == Verdict("")


def test_devices_are_listed(machine, run_command):
    cards = card("llvmpipe", "CPU"), card("Arc A770")
    tested = machine(*cards, wrong={"llvmpipe": "its pictures are wrong by 2"})
    text = run_command("info", "--devices")
    assert "Arc A770" in text and "graphics card, through Vulkan" in text and "wrong by 2" in text
    assert "--device auto means Arc A770: " in text and "frame 5 ms, processor 20 ms, training step 30 ms, processor 90 ms" in text
    facts = json.loads(run_command("info", "--devices", "--json"))
    assert facts["auto"] == "Arc A770" and [each["self_test"] for each in facts["devices"]] == ["", "its pictures are wrong by 2"]
    assert len(tested) == 2
    machine(*cards)
    again = json.loads(run_command("info", "--devices", "--json", "--device", "llvm", "--again"))
    assert tested[2:] == ["llvmpipe"] and [each["self_test"] for each in again["devices"]] == [""]
    assert choice.describe(test=False)["devices"][1]["self_test"] == ""
    cards[1].info["description"] = "driver 2"
    machine(*cards)
    assert choice.describe(test=False)["devices"][0]["self_test"] is None and len(tested) == 3


@pytest.fixture
def run_command(capsys):
    from fastgs_blender.cli import main

    def run(*arguments):
        assert main(list(arguments)) in (0, None)
        return capsys.readouterr().out

    return run


def test_a_run_whose_gpu_fails_goes_on_from_the_last_checkpoint(fresh, tmp_path, monkeypatch, capsys):
    capture, store, points = toy_capture(frames=2, views=3)
    monkeypatch.setattr("fastgs_blender.training.initial.starting_points.initial_points", lambda *rest: (points, rest[1]))
    compare, calls = GPU.compare, []

    def lost(*given):
        calls.append(1)
        if len(calls) == 3:
            raise Failure("Parent device is lost")
        return compare(*given)

    monkeypatch.setattr(GPU, "compare", lost)
    options = {"iterations": 5, "checkpoint_seconds": 0.0, "preview_every": 0, "max_gaussians": 500}
    plan = plans.begin(tmp_path, options, lambda wanted: settings.settings(**wanted), False, False)
    report = session.run(capture, store, plan, tmp_path, quiet=True, backend=fresh.name)
    assert report["iterations"] == 5 and len(calls) == 3
    assert report["device"].startswith("fresh, then the processor, ")
    assert json.loads((tmp_path / "status.json").read_text())["device"] == report["device"]
    assert "device is lost): the processor" in capsys.readouterr().err
