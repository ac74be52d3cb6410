# SPDX-License-Identifier: GPL-3.0-or-later
"""The time left, in status.json and on the terminal: from the pace of steps, not from the compiling before them."""
import io
import json
import os
from types import SimpleNamespace

import numpy as np
import pytest

from fastgs_blender.jobs.job import State, read_status
from fastgs_blender.jobs.queue import _preparing
from fastgs_blender.training.run import progress


@pytest.fixture
def clock():
    """Seconds that pass only when told, from the second 1000 on."""
    return SimpleNamespace(now=1000.0)


@pytest.mark.parametrize("begin", [0, 40])
def test_time_left_does_not_count_compiling(tmp_path, clock, begin, monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stderr", terminal)
    reporter = progress.Reporter(tmp_path, 100, begin=begin, elapsed=7.0 * begin, clock=lambda: clock.now)

    def left():
        reporter.status("training")
        return json.loads((tmp_path / progress.STATUS).read_text("utf-8"))["seconds_left"]

    clock.now += 90  # decoding, starting points
    assert left() is None
    for iteration, seconds in enumerate((300, 60, 2, 2, 2, 4, 4, 4), begin + 1):
        clock.now += seconds
        reporter.step({"iteration": iteration, "loss": 0.1, "psnr": 20.0, "gaussians": 5})
        if iteration == begin + 1:
            assert left() is None and "<?" in str(reporter.bar.bar)
    steps = 100 - begin - 8
    assert left() == pytest.approx(3 * steps)
    assert f"<{3 * steps // 60:02d}:{3 * steps % 60:02d}" in str(reporter.bar.bar)
    assert reporter.elapsed == pytest.approx(7 * begin + 90 + 378), "what has passed is told in full"
    reporter.close()


def test_time_left_before_the_first_step_is_the_forecast_s(tmp_path, clock, capsys):
    """That of the whole run, with all that comes before its steps; a stage's own bar tells how long the stage takes."""
    reporter = progress.Reporter(tmp_path, 100, clock=lambda: clock.now, forecast=300.0)
    with reporter.stage("finding starting points") as report:
        for done in range(5):
            report(done, 8)
            clock.now += 10
        found = json.loads((tmp_path / progress.STATUS).read_text("utf-8"))
        assert found["seconds_left"] == 260
    assert ", 4:20 until" in capsys.readouterr().err
    assert State("PREPARING", "", found).seconds_left == 260
    for iteration in (1, 2, 3, 4):
        clock.now += 2
        reporter.step({"iteration": iteration, "loss": 0.1, "psnr": 20.0, "gaussians": 5})
    reporter.status("training")
    assert json.loads((tmp_path / progress.STATUS).read_text("utf-8"))["seconds_left"] == 192
    reporter.close()


@pytest.mark.parametrize("name", [progress.LOG, progress.STATUS, progress.PLOT])
@pytest.mark.posix
def test_a_pipe_in_the_folder_does_not_stop_a_run(tmp_path, clock, capsys, name):
    os.mkfifo(tmp_path / name)
    reporter = progress.Reporter(tmp_path, 100, begin=2, clock=lambda: clock.now)
    for iteration in (3, 4, 5):
        reporter.step({"iteration": iteration, "loss": 0.1, "psnr": 20.0, "gaussians": 5})
    reporter.preview(5, np.zeros((2, 2, 3)), {})
    reporter.close()
    assert "not be written" in capsys.readouterr().err
    assert (tmp_path / name).is_fifo() and (tmp_path / progress.STATUS).exists()


def test_plain_lines_where_nobody_looks(tmp_path, clock, capsys):
    """Now and then, without escapes; remarks between them; nothing of both where the run is quiet, but what goes wrong is told."""
    for quiet in (False, True):
        reporter = progress.Reporter(tmp_path, 100, quiet=quiet, clock=lambda: clock.now)
        reporter.say("a remark")
        reporter.warn("a problem")
        for iteration in range(1, 31):
            clock.now += 3
            reporter.step({"iteration": iteration, "loss": 0.1, "psnr": 20.0, "gaussians": 5})
        reporter.close()
        said = capsys.readouterr().err.splitlines()
        if quiet:
            assert said == ["fastgs: a problem"]
            continue
        assert said[:2] == ["fastgs: a remark", "fastgs: a problem"]
        assert said[2].startswith("training: 1/100 steps (1 %), 0:03 so far"), "soon, and then every 20 seconds"
        assert said[3] == "training: 8/100 steps (8 %), 0:24 so far, 4:36 left, loss 0.1000, 20.0 dB, 5 Gaussians"
        assert len(said) == 2 + 1 + 4 + 1 and said[-1].startswith("training: 30/100 steps (30 %), 1:30 so far, 3:30 left")


def test_what_comes_before_the_first_step_shows_how_far_it_is(tmp_path, clock, capsys):
    """On the terminal, in status.json at most once a second, and in Blender's list of runs."""
    reporter, written = progress.Reporter(tmp_path, 100, clock=lambda: clock.now), []
    status = reporter.status
    reporter.status = lambda *state, **values: (written.append(values.get("stage_share")), status(*state, **values))
    with reporter.stage("finding starting points") as report:
        for done in range(8):
            report(done, 8)
            clock.now += 0.7 if done < 4 else 15
        found = read_status(tmp_path / progress.STATUS)
        assert _preparing(found) == "Finding starting points, 88%" and found["state"] == "preparing"
        report(8, 8)
    assert written == [0, 0.25, 0.5, 0.625, 0.75, 0.875, 1, None]
    assert _preparing(read_status(tmp_path / progress.STATUS)) == "Starting", "and not that all of it is done, while kernels compile"
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("finding starting points: 5/8 moments (62 %)") and said[-1].startswith("finding starting points: 8/8 moments")
    reporter.step({"iteration": 1, "loss": 0.1, "psnr": 20.0, "gaussians": 5})
    assert "stage" not in read_status(tmp_path / progress.STATUS) and _preparing({}) == "Preparing the pictures"
    reporter.close()
