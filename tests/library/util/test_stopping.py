# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line ends in one sentence and with 130 when it is stopped, whenever that is; other programs keep their own signals."""
from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import fastgs_blender as fg
from fastgs_blender import cli
from fastgs_blender.util import stopping

ROOT = Path(__file__).resolve().parents[3]
CHILD = ROOT / "fastgs_blender" / "jobs" / "child.py"


def ended(command, number, place, tmp_path):
    """(exit code, standard error) of a process to which a signal comes when it imports a module, a name of which is `place`."""
    hook = tmp_path / "hook"
    hook.mkdir(exist_ok=True)
    (hook / "sitecustomize.py").write_text(
        "import os, sys\n"
        "class Look:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {place!r}:\n"
        "            sys.meta_path.remove(self)\n"
        f"            os.kill(os.getpid(), {int(number)})\n"
        "sys.meta_path.insert(0, Look())\n")
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": os.pathsep.join([str(hook), str(ROOT)])})
    return done.returncode, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", stopping.SIGNALS)
@pytest.mark.parametrize("place", ["numpy", "fastgs_blender.commands.render", "fastgs_blender.cli", "numba"])
def test_a_signal_while_modules_are_imported(number, place, tmp_path):
    """render imports numba when it has begun."""
    command = [sys.executable, "-m", "fastgs_blender", "render", str(ROOT / "examples" / "fireside.safetensors"), "--camera",
               str(ROOT / "examples" / "cameras.json"), "--out", str(tmp_path / "out"), "--frames", "0", "--size", "32x18"]
    assert ended(command, number, place, tmp_path) == (130, "fastgs: stopped.\n")


@pytest.mark.parametrize("place", ["faulthandler", "numpy", "fastgs_blender.cli", "fastgs_blender.captures.clocks.plot"])
@pytest.mark.posix
def test_a_signal_while_a_job_of_blender_begins(place, tmp_path):
    command = [sys.executable, str(CHILD), str(ROOT), "", "", "sync", str(tmp_path)]
    assert ended(command, signal.SIGTERM, place, tmp_path) == (130, "fastgs: stopped.\n")


@pytest.mark.parametrize("begin", [["-m", "fastgs_blender"], [str(CHILD), str(ROOT), "", ""]], ids=["command", "job"])
@pytest.mark.posix
def test_what_is_stopped_while_it_writes_clears_up(begin, tmp_path, rng, make_model):
    hook, out = tmp_path / "hook", tmp_path / "out"
    hook.mkdir()
    out.mkdir()
    (hook / "sitecustomize.py").write_text("import os, signal\nos.fsync = lambda handle: os.kill(os.getpid(), signal.SIGTERM)\n")
    fg.save(make_model(rng, 5), tmp_path / "m.safetensors")
    done = subprocess.run([sys.executable, *begin, "convert", str(tmp_path / "m.safetensors"), str(out / "a.safetensors")], cwd=ROOT,
                          capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": os.pathsep.join([str(hook), str(ROOT)])})
    assert (done.returncode, done.stderr) == (130, "fastgs: stopped.\n") and not list(out.iterdir())


@pytest.mark.posix
def test_programs_that_use_the_library_keep_their_signals():
    program = ("import signal\nbefore = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]\n"
               "import fastgs_blender.cli\nassert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before\n")
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)
    before = [signal.getsignal(number) for number in stopping.SIGNALS]
    assert {"SIGINT", "SIGTERM", "SIGHUP"} == {number.name for number in stopping.SIGNALS}
    assert cli.main([]) == 0
    assert [signal.getsignal(number) for number in stopping.SIGNALS] == before
    old = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stopping.as_interrupts():
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN, "nohup"
    finally:
        signal.signal(signal.SIGHUP, old)


def test_a_terminal_that_was_closed_changes_no_exit_code(monkeypatch):
    class Closed(io.StringIO):
        def write(self, text):
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(sys, "stderr", Closed())
    assert cli.main(["info", "missing.ply"]) == 2
