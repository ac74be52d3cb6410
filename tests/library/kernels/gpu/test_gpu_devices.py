# SPDX-License-Identifier: GPL-3.0-or-later
"""Which device is used: adapters, the self-test and its verdicts, the command line, and a run whose GPU fails."""
from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from toy_captures import toy_capture

import fastgs_blender as fg
from fastgs_blender.kernels.gpu import adapters, choice, training
from fastgs_blender.kernels.gpu.device import Device, Failure
from fastgs_blender.training.core import settings
from fastgs_blender.training.run import session
from fastgs_blender.util.backends import choose_device, load_backend


def card(name, kind="DiscreteGPU"):
    info = {"device": name, "description": "driver 1", "backend_type": "Vulkan", "adapter_type": kind}
    return SimpleNamespace(info=info, limits={"max-storage-buffer-binding-size": 1 << 27, "max-buffer-size": 1 << 28})


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """machine(cards ..., wrong={name: verdict}): a machine with these cards; returns the list of those that were tested."""
    import wgpu
    import wgpu.backends.wgpu_native.extras  # this makes wgpu.gpu what it will be

    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path))
    tested = []

    def make(*cards, wrong=()):
        adapters.adapters.cache_clear()
        monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", lambda: list(cards))
        monkeypatch.setattr(choice, "test", lambda each: tested.append(each.name) or dict(wrong).get(each.name, ""))
        return tested

    yield make
    adapters.adapters.cache_clear()


def test_auto_takes_the_best_that_passes_and_remembers(machine, monkeypatch):
    soft, inner, arc = card("llvmpipe", "CPU"), card("UHD", "IntegratedGPU"), card("Arc A770")
    tested = machine(soft, inner, arc)
    assert choose_device("auto") == ("gpu:Arc A770", "") == choose_device("gpu") == choose_device("a77")
    assert tested == ["Arc A770"]  # once
    assert choose_device("llvm") == ("gpu:llvmpipe", "") and choose_device("cpu") == ("auto", "")
    arc.info["description"] = "driver 2"
    machine(soft, inner, arc, wrong={"Arc A770": "its pictures are wrong by 1"})
    name, about = choose_device("auto")
    assert name == "gpu:UHD" and tested[-2:] == ["Arc A770", "UHD"] and not about
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
    assert choose_device("auto") == ("auto", "no GPU was found but llvmpipe, which must be called by name: the CPU is used.")
    with pytest.raises(fg.FastGSError, match="no GPU was found but llvmpipe, which must be called by name; use the device cpu"):
        load_backend("gpu")
    with pytest.raises(fg.FastGSError, match="no GPU is called 'arc'; there are llvmpipe"):
        choose_device("arc")
    machine()
    assert choose_device("auto") == ("auto", "no GPU was found: the CPU is used.")
    monkeypatch.setitem(__import__("sys").modules, "wgpu", None)
    adapters.adapters.cache_clear()
    assert "wgpu is not installed" in choose_device("auto")[1]


def test_a_test_that_ends_the_program_is_not_tried_again(machine, monkeypatch, tmp_path):
    machine(card("Arc"))

    def dies(each):
        raise SystemExit

    monkeypatch.setattr(choice, "test", dies)
    with pytest.raises(SystemExit):
        choose_device("auto")
    assert "did not come to its end" in choose_device("auto")[1]
    (tmp_path / "gpus.json").write_text("{damaged")
    machine(card("Arc"))
    assert choose_device("auto")[0] == "gpu:Arc" and list(json.loads((tmp_path / "gpus.json").read_text()).values()) == [""]


def test_the_self_test_passes_here_and_finds_what_is_wrong(adapter, fresh, monkeypatch):
    sound = SimpleNamespace(open=lambda: fresh.backend.device)
    assert choice.test(sound) == ""
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
            assert what in choice.test(sound)
    monkeypatch.setattr(training, "compare", lambda *rest: (_ for _ in ()).throw(Failure("it is lost")))
    assert choice.test(sound) == "it is lost"


def test_devices_are_listed(machine, run_command):
    cards = card("llvmpipe", "CPU"), card("Arc A770")
    tested = machine(*cards, wrong={"llvmpipe": "its pictures are wrong by 2"})
    text = run_command("info", "--devices")
    assert "Arc A770" in text and "graphics card, through Vulkan" in text and "its pictures are wrong by 2" in text
    assert "--device auto means Arc A770." in text
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
    monkeypatch.setattr("fastgs_blender.training.initial.points.initial_points", lambda *rest: (points, rest[1]))
    compare, calls = training.compare, []

    def lost(*given):
        calls.append(1)
        if len(calls) == 3:
            raise Failure("Parent device is lost")
        return compare(*given)

    monkeypatch.setattr(training, "compare", lost)
    options = {"iterations": 5, "checkpoint_seconds": 0.0, "preview_every": 0, "max_gaussians": 500}
    plan = session.begin(tmp_path, options, lambda wanted: settings.settings(**wanted), False, False)
    report = session.train(capture, store, plan, tmp_path, quiet=True, backend=fresh.name)
    assert report["iterations"] == 5 and len(calls) == 3
    assert report["device"].startswith("fresh, then the processor, ")
    assert json.loads((tmp_path / "status.json").read_text())["device"] == report["device"]
    assert "the GPU fails (Parent device is lost): the processor goes on from the last checkpoint" in capsys.readouterr().err
