# SPDX-License-Identifier: GPL-3.0-or-later
"""benchmarks/quality.py: what it measures, and its table."""
from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_captures import toy_scene, write_capture

import fastgs_blender as fg

FILE = Path(__file__).resolve().parents[3] / "benchmarks" / "quality.py"


@pytest.fixture(scope="module")
def quality():
    pytest.importorskip("resource")
    spec = importlib.util.spec_from_file_location("quality", FILE)
    sys.modules["quality"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["quality"]


def test_frames_that_were_trained_on_and_those_between(quality, tmp_path, monkeypatch):
    """A model of every second frame is measured at all, at the right times; one that stands still is wrong in the moving pixels alone."""
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path / "cache"))
    path = write_capture(tmp_path / "toy")
    scene = quality.Scene({"inner": "cam00"}, step=2)
    right = replace(toy_scene(), clip=fg.Clip(3, 12.0, 1))
    found = quality.measured(right, path, scene, None)
    assert set(found) == {"inner", "inner between"} and min(min(values) for values in found.values()) > 45, found
    whole, moving, still = quality.measured(replace(right, motion=0 * right.motion), path, scene, None)["inner between"]
    assert moving < whole < still and still > moving + 6, (whole, moving, still)


def test_moving_pixels_differ_from_the_median_over_time(quality):
    pictures = np.full((5, 2, 3, 3), 0.5)
    pictures[1, 0, 2, 1] += 0.2
    pictures[:, 1, 0] += 0.01 * np.arange(5)[:, None]  # less than what counts
    found = quality.moving_pixels(pictures)
    assert found.shape == (5, 2, 3) and np.argwhere(found).tolist() == [[1, 0, 2]]


def test_the_table_has_means_and_deviations_and_hides_the_test_camera(quality, capsys):
    run = {"gaussians": 100, "megabytes": 1.5, "minutes": 2.0, "inner": [30.0, 20.0, 40.0], "test": [11.0, 12.0, 13.0]}
    results = {f"room | defaults | seed {seed}": {**run, "inner": [30.0 + seed, 20.0, 40.0]} for seed in range(2)}
    quality.show(results, test=False)
    shown = capsys.readouterr().out
    assert "| room: synthetic, defaults | 30.50 ± 0.71 / 20.00 ± 0.00 / 40.00 ± 0.00 |" in shown and "12.00" not in shown
    quality.show(results, test=True)
    assert "11.00 ± 0.00 / 12.00" in capsys.readouterr().out


def test_the_real_film_comes_first_and_what_is_refilmed_says_so(quality, capsys):
    quality.show({f"{scene} | x | seed 0": {"gaussians": 1, "megabytes": 1, "minutes": 1} for scene in ("kitchen", "people")}, test=True)
    first, second = capsys.readouterr().out.splitlines()[-2:]
    assert first.startswith("| people: real, x") and second.startswith("| kitchen: refilmed, pictures by this renderer, x")
