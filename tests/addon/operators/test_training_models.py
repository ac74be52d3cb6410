# SPDX-License-Identifier: GPL-3.0-or-later
"""Models of finished runs come into the scene without a pause."""
from __future__ import annotations

import os
import threading
from types import SimpleNamespace

import bpy
import pytest
from held_runs import GUARD, until


def test_a_finished_runs_model_is_read_beside_blender(module, fg, make_model, scene, tmp_path, monkeypatch):
    """Nothing of it is done by Blender's own thread but what is left when it has been read."""
    watch, results = module("scene.training.watch"), module("scene.training.results")
    fg.save(make_model(40), tmp_path / "model.safetensors")
    job = SimpleNamespace(id="toy", name="Toy", out=str(tmp_path), capture="",
                          scene={"import": True, "blend": bpy.data.filepath, "process": os.getpid()})
    gate, prepare = threading.Event(), results.proxy.prepare
    monkeypatch.setattr(results.proxy, "prepare", lambda *given: gate.wait(GUARD) and prepare(*given))
    shown = lambda: [obj.name for obj in scene.objects if obj.get("fastgs_job") == "toy"]  # noqa: E731
    watch.report_end(job, SimpleNamespace(kind='FINISHED', values={}, text=""))
    watch._add_models()
    assert not shown() and len(watch._readings) == 1
    gate.set()
    until(lambda: watch._readings[0][1].done)
    watch._add_models()
    assert shown() == ["Toy"] and not watch._readings

    (tmp_path / "model.safetensors").write_bytes(b"nonsense")
    with pytest.raises(fg.FastGSError, match=r"model\.safetensors"):
        results.Reading(str(tmp_path), True).path  # noqa: B018
