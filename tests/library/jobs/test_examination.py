# SPDX-License-Identifier: GPL-3.0-or-later
"""Testing GPUs in a process of its own: what it finds, what it says meanwhile, and what a driver does that ends it."""
from __future__ import annotations

import json

import pytest
from held_runs import GUARD, until

from fastgs_blender.jobs.examination import TRIES, Examination


@pytest.fixture
def python(tmp_path):
    """python(script): a program that stands for Python; it is given the number of the process in $N and notes its arguments in `calls`."""
    def make(script):
        path = tmp_path / "python"
        path.write_text(f"#!/bin/sh\ncd '{tmp_path}'\necho \"$*\" >> calls\nN=$(wc -l < calls)\n{script}\n")
        path.chmod(0o755)
        return str(path)

    make.calls = lambda: (tmp_path / "calls").read_text().splitlines()
    return make


@pytest.mark.posix
def test_a_driver_that_crashes_ends_one_process_alone(python):
    program = python("echo 'fastgs: testing Arc (1 of 2)' >&2; [ $N -lt 3 ] && kill -SEGV $$\necho '{\"devices\": [], \"auto\": null}'")
    found = Examination("ar", again=True, python=program)
    assert found.wait(GUARD) and found.found == {"devices": [], "auto": None} and not found.trouble
    assert found.line == "testing Arc (1 of 2)"
    assert ["--device ar --again" in call for call in python.calls()] == [True, False, False], "what crashed is not tested again"
    hopeless = Examination(python=python("kill -SEGV $$"))
    assert hopeless.wait(GUARD) and hopeless.found is None and "be tested" in hopeless.trouble
    assert len(python.calls()) == 3 + TRIES
    gone = Examination(python="/nowhere/python")
    assert gone.wait(GUARD) and "No such file" in gone.trouble


@pytest.mark.posix
def test_it_can_be_stopped(python):
    running = Examination(python=python("echo 'fastgs: testing Arc (1 of 1)' >&2; exec sleep 600"))
    until(lambda: running.line == "testing Arc (1 of 1)")
    assert not running.done
    running.stop()
    assert running.done and running.found is None and len(python.calls()) == 1


def test_it_is_the_command(tmp_path, monkeypatch):
    """The real process: no GPU has this name, so none is tested."""
    monkeypatch.setenv("FASTGS_CACHE_DIR", str(tmp_path))
    found = Examination("no such name")
    assert found.wait(GUARD) and found.found["devices"] == [] and found.found.keys() == {"devices", "auto", "reason"}, found.trouble
    assert json.dumps(found.found)
