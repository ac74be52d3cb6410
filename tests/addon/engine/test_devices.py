# SPDX-License-Identifier: GPL-3.0-or-later
"""Final pictures by the scene's device, the GPUs of the preferences, and what is told of them."""
from __future__ import annotations

from types import SimpleNamespace

import bpy
import by_hand
import numpy as np
import pytest
from held_runs import GUARD
from panel_recorder import Layout


@pytest.fixture
def devices(module):
    """The module scene.devices, without what it knows of this machine."""
    found = module("scene.devices")
    found.unregister()
    yield found
    found.unregister()


@pytest.fixture
def backends(module):
    return module("fastgs_blender.util.backends")


@pytest.fixture
def card(devices, backends, monkeypatch):
    """card(verdict, failed=None): this machine has a GPU, "Arc", whose pictures are the processor's; returns what it was asked to draw."""
    drawn, cpu = [], backends.load_backend("cpu")

    def make(verdict="", failed=None):
        arc = type("Arc", (type(cpu),), {"draw": lambda self, *given, **more: drawn.append(1) or cpu.draw(*given, **more)})()
        arc.failed = failed
        monkeypatch.setitem(backends.loaded, "gpu:Arc", arc)
        adapter = SimpleNamespace(name="Arc", driver="driver 1")

        def choose(device, examine):
            found = examine(adapter)
            if found is not None and not found.fault:
                return "gpu:Arc", "Arc is used, as it is faster than the CPU."
            why = "has not been tested yet" if found is None else f"has failed the self-test ({found.fault})"
            return "auto", f"Arc {why}: the CPU is used."

        monkeypatch.setattr(backends, "choose_device", choose)
        monkeypatch.setattr(backends, "stored_verdict", lambda adapter: None if verdict is None else backends.Verdict(verdict))
        listed = {"name": "Arc", "kind": "graphics card", "interface": "Vulkan", "driver": "driver 1", "software": False,
                  "largest_bytes": 1, "self_test": verdict, "frame_ms": (5.0, 20.0), "step_ms": (30.0, 90.0)}
        monkeypatch.setattr(backends, "describe_devices", lambda **how: {"devices": [listed], "auto": "Arc", "reason": "Arc is used."})
        return drawn

    return make


@pytest.fixture
def shot(scene, make_model, model_file, splat_object, add_camera, render):
    """shot(): the picture of a model."""
    splat_object(model_file(make_model()))
    add_camera()
    scene.render.film_transparent = True
    return lambda: render()["ViewLayer.Combined"]


def test_the_scenes_device_renders(scene, card, shot, capfd):
    drawn = card()
    scene.fastgs.device = 'CPU'
    plain = shot()
    assert not drawn
    scene.fastgs.device = 'GPU'
    np.testing.assert_array_equal(shot(), plain)
    assert drawn and "Arc is used" in capfd.readouterr().out


def test_why_the_processor_renders_is_told_once(scene, card, shot, capfd):
    card("its pictures are wrong by 1")
    scene.frame_end = 2
    shot()
    assert capfd.readouterr().out.count("Arc has failed the self-test (its pictures are wrong by 1): the CPU is used.") == 1
    drawn = card("", failed="Parent device is lost")
    shot()
    assert drawn and "Arc fails" in capfd.readouterr().out


def test_a_picture_that_does_not_fit_is_told_and_the_next_one_is_not(scene, card, shot, backends, capfd):
    card()
    backends.loaded["gpu:Arc"].too_large = "its memory is full"
    shot()
    assert "no room" in capfd.readouterr().out
    shot()
    assert "no room" not in capfd.readouterr().out


def test_an_untested_gpu_is_tested_before_the_first_picture(scene, card, shot, devices, monkeypatch):
    asked = []

    class Examination:
        def __init__(self, part="", again=False):
            asked.append((part, again))
            self.done, self.trouble, self.waits = False, "", 0
            self.found = {"devices": [{"name": "Arc", "driver": "driver 1", "self_test": "", "frame_ms": [5, 20], "step_ms": [3, 9]}]}

        def wait(self, seconds=None):
            self.waits += 1
            self.done = self.waits > 2
            return self.done

        def stop(self):
            self.done = True

    monkeypatch.setattr(devices, "Examination", Examination)
    drawn = card(verdict=None)
    shot()
    assert drawn and asked == [("Arc", False)]
    assert devices.backend("auto") == ("auto", "Arc has not been tested yet: the CPU is used."), "nobody waits without a progress"
    assert bpy.ops.fastgs.test_gpus() == {'FINISHED'}
    assert asked[-1] == ("", True)


def test_a_gpu_that_is_not_there_is_a_sentence(devices, module, monkeypatch):
    monkeypatch.setattr(module("scene.settings"), "gpu", "Voodoo 2")
    name, remark = devices.backend(devices.wanted(bpy.context.scene))
    assert name == "auto" and remark.endswith(": the CPU is used.")
    assert "Voodoo 2" in remark or "no GPU" in remark


def test_preferences_list_and_choose_gpus(card, devices, module):
    card("")
    draw, preferences = module("ui.preferences").draw_gpus, module("scene.settings").preferences()
    devices.found()
    devices._listing.join(GUARD)

    def lines(chosen):
        layout = Layout()
        operators = []
        layout.operator = lambda name, text="", icon='NONE': operators.append((name, text, icon)) or SimpleNamespace()
        layout._inside = layout.column = layout.row = lambda **more: layout
        draw(layout, SimpleNamespace(region=SimpleNamespace(width=500), preferences=bpy.context.preferences), chosen)
        return operators

    assert lines("")[0] == ("fastgs.use_gpu", "Automatic (Arc)", 'RADIOBUT_ON')
    passed = "Arc: graphics card, passed its self-test; the processor's speed x 4 (frames), x 3 (training)"
    assert lines("Arc")[1] == ("fastgs.use_gpu", passed, 'RADIOBUT_ON')
    assert "not there now" in lines("Voodoo 2")[2][1] and lines("")[-1][0] == "fastgs.test_gpus"
    try:
        bpy.ops.fastgs.use_gpu(name="Arc")
        assert preferences.gpu == "Arc" == devices.wanted(bpy.context.scene)
        bpy.context.scene.fastgs.device = 'CPU'
        assert devices.wanted(bpy.context.scene) == "cpu"
    finally:
        preferences.gpu = ""
    assert "Arc (Vulkan, driver 1): passed" in module("engine.diagnostics").text()


def test_training_gets_the_scenes_device(scene, fg, module, monkeypatch, tmp_path):
    given = []

    class Jobs:
        def all(self):
            return []

        def add(self, out, capture, python, options, *rest):
            given.append(options)
            raise fg.FastGSError("enough.")

    monkeypatch.setattr(module("scene.training.installation"), "jobs", Jobs)
    monkeypatch.setattr(module("scene.settings"), "gpu", "")
    for device, wanted in (('GPU', "auto"), ('CPU', "cpu")):
        scene.fastgs.device = device
        with pytest.raises(RuntimeError, match="Enough"):
            bpy.ops.fastgs.train(capture=str(tmp_path), out=str(tmp_path / "run"), preset='DRAFT')
        assert given[-1][:2] == ["--device", wanted] and "draft" in given[-1]


def test_a_real_adapter_draws_what_the_reference_draws(scene, fg, module, devices, backends, shot, make_model, monkeypatch):
    """Mesa's software Vulkan, chosen by its name as a user would; its self-test is the library's tests' business."""
    adapters = pytest.importorskip("wgpu") and module("fastgs_blender.kernels.gpu.adapters")
    try:
        names = [each.name for each in adapters.adapters()]
    except adapters.Failure as failure:
        pytest.skip(f"no GPU: {failure}")
    if not names:
        pytest.skip("no GPU, and none in software (mesa-vulkan-drivers)")
    monkeypatch.setattr(module("scene.settings"), "gpu", names[0])
    monkeypatch.setattr(backends, "stored_verdict", lambda adapter: backends.Verdict(""))
    picture = shot()
    name = f"gpu:{names[0]}"
    assert name in backends.loaded and backends.failure_of(name) == ""
    want = fg.render(make_model(), by_hand.camera(fg, by_hand.look_at((0, -5, 0), (0, 0, 0))), backend="reference")
    by_hand.assert_same_picture(picture, by_hand.combined(want["rgb"], want["alpha"]))
