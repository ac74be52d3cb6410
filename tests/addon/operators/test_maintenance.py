# SPDX-License-Identifier: GPL-3.0-or-later
"""Preferences, compiling ahead, diagnostics."""
from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from held_runs import until

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def preferences(module):
    found = module("scene.settings").preferences()
    before = {name: getattr(found, name) for name in ("threads", "cache_folder", "log_level")}
    yield found
    for name, value in before.items():
        setattr(found, name, value)


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path))
    return tmp_path


def test_preferences_reach_the_engine(module, preferences):
    preferences.threads = 3
    assert module("scene.settings").threads == 3
    preferences.log_level = 'DEBUG'
    assert module("scene.settings").logging.getLogger(module("scene.settings").EXTENSION).level == 10


def test_kernels_go_to_the_extensions_folder(module, preferences, monkeypatch, tmp_path):
    monkeypatch.delenv("FASTGS_CACHE_DIR", raising=False)
    cache = module("fastgs_blender.kernels.cpu.cache")
    preferences.cache_folder = ""
    assert cache.base_folder() == Path(bpy.utils.extension_path_user("bl_ext.user_default.fastgs_blender", path="kernels"))
    preferences.cache_folder = str(tmp_path)
    assert cache.base_folder() == tmp_path


@pytest.fixture
def session_kernels(module):
    """The folder of the kernels that all tests share, which are all compiled.  To be asked for before empty_cache."""
    cache, compiling = module("fastgs_blender.kernels.cpu.cache"), module("engine.compiling")
    assert compiling.start() or cache.is_filled()
    assert compiling.wait()
    return cache.folder()


@pytest.mark.slow
def test_compile_now_and_clear(module, session_kernels, empty_cache):
    cache = module("fastgs_blender.kernels.cpu.cache")
    assert not cache.is_filled() and not cache.is_begun()
    compiling = module("engine.compiling")
    assert compiling.start()
    until(cache.is_begun)
    assert compiling.is_running()
    compiling.stop()  # as when Blender is closed
    assert not cache.is_filled(), "what was stopped is not taken for finished"
    cache.clear()
    missing = ("decode.decode-", "sort.scatter-")  # compiling two is enough: the others are those that all tests share
    shutil.copytree(session_kernels, cache.folder(), ignore=lambda folder, names: [
        name for name in names if name == cache.COMPLETE or name.startswith(missing) or ".tmp." in name])
    assert cache.is_begun() and not cache.is_filled()
    assert bpy.ops.fastgs.compile_kernels() == {'FINISHED'}
    assert cache.is_filled() and not compiling.start()
    names = {path.name.partition("-")[0] for path in empty_cache.rglob("*.nbi")}
    assert {"project.project", "raster.rasteriser.locals.rasterise", "decode.decode", "sort.scatter"} <= names
    assert cache.size() > 100_000
    # a process that renders finds them: nothing is announced, nothing is added
    files = set(empty_cache.rglob("*.nbc"))
    run = subprocess.run(module("fastgs_blender.kernels.cpu.aside").command("all"), capture_output=True, text=True, check=True)
    assert "compiling" not in run.stderr
    assert set(empty_cache.rglob("*.nbc")) == files
    assert bpy.ops.fastgs.clear_kernels() == {'FINISHED'}
    assert not cache.is_filled()
    assert cache.size() == 0


def test_without_numba_nothing_is_compiled(module, empty_cache, monkeypatch):
    compiling = module("engine.compiling")
    monkeypatch.setattr(compiling, "has_numba", lambda: False)
    assert not compiling.start()
    assert not bpy.ops.fastgs.compile_kernels.poll()


def test_diagnostics_name_versions_objects_and_messages(module, make_model, model_file):
    path = model_file(make_model())
    bpy.ops.import_scene.fastgs(filepath=str(path))
    module("scene.notices").log.warning("something odd happened")
    text = module("engine.diagnostics").text()
    for words in (bpy.app.version_string, "numpy", "backend: cpu", path, "Gaussians", "something odd happened"):
        assert words in text


def test_enabling_imports_nothing_heavy(addon):
    """In a fresh process: neither the heavy packages nor many modules of any (not the time, which depends on the machine)."""
    code = f"""
import os, sys
import bpy, addon_utils
before = set(sys.modules)
assert addon_utils.enable("{addon.__name__}")
others = [name for name in set(sys.modules) - before if not name.startswith("bl_ext")]
print("found", len(others), *(name for name in ("numba", "torch", "llvmlite", "OpenEXR", "PIL") if name in sys.modules), flush=True)
os._exit(0)  # Blender 4.2 as a module crashes in Python's own clean-up
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    others, *heavy = re.search(r"^found (.*)$", out, re.MULTILINE)[1].split()
    assert not heavy
    assert int(others) < 400, "torch alone brings more than a thousand"
