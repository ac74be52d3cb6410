# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures that the library's tests share."""
from __future__ import annotations

import importlib.util
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import windows_rules
from hypothesis import HealthCheck, settings
from random_models import random_model

settings.register_profile("fastgs", deadline=None, derandomize=True, database=None,
                          suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
settings.load_profile("fastgs")

windows_rules.install()
CACHE = Path(__file__).resolve().parents[2] / "build" / "cache"
os.environ.setdefault("FASTGS_CACHE_DIR", str(CACHE))  # compiled kernels, which the add-on's tests share; the user's own stays as it is
os.environ["FASTGS_DEVICE"] = "cpu"  # commands under test use no GPU, whatever this machine has, unless they are told to
os.environ.pop("COLUMNS", None)  # commands under test tell each sentence in one line, however wide the terminal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a shell's background job: programs under test would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _no_waiting_for_the_disk():
    """A thousand small files need not be safe from a power cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same ones in every run."""
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def make_model():
    """The factory of random models: make_model(rng, n, basis=..., temporal=..., appearance=..., ...); see random_models.py."""
    return random_model


@pytest.fixture
def few_pictures(monkeypatch):
    """Compression takes the same steps with a few pictures of the model, for tests that do not ask how good it looks then."""
    from fastgs_blender.formats import rate, thinning

    for module, names in ((rate, ("SHOTS", "JUDGED")), (thinning, ("SENSED", "REFITS", "FINAL"))):
        for name in names:
            monkeypatch.setattr(module, name, getattr(module, name) // 8)


@pytest.fixture(scope="session")
def pxr() -> None:
    """Pixar's library can be imported; that of the bpy wheel lies in a folder of its own."""
    places = importlib.util.find_spec("bpy").submodule_search_locations
    sys.path += [str(path.parent) for place in places for path in Path(place).glob("*/python/lib/*/site-packages/pxr")]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real inputs beside the repository; tests that need it are skipped where it is absent."""
    folder = Path(__file__).resolve().parents[3] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the folder of real inputs is absent")
    return folder


@pytest.fixture
def run(capsys):
    """run(*arguments): (exit code, standard output, standard error) of fastgs."""
    from fastgs_blender import cli

    def run(*arguments):
        code = cli.main([str(a) for a in arguments])
        return code, *capsys.readouterr()

    return run
