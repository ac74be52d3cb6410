# SPDX-License-Identifier: GPL-3.0-or-later
"""The queue of training jobs: nothing is lost in it, several programs share it, and no file harms it.  No training takes place."""
from __future__ import annotations

import json
import logging
import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import mutations
import pytest
from held_runs import until

import fastgs_blender as fg
from fastgs_blender.jobs import queue
from fastgs_blender.jobs.environment import environment
from fastgs_blender.jobs.job import read_job, read_status
from fastgs_blender.jobs.queue import Jobs
from fastgs_blender.util import locks

ROOT = Path(__file__).resolve().parents[3]
RUN = """
import os, sys, time
sys.path.insert(0, sys.argv[1])
from fastgs_blender.util import locks
held = locks.inherited() or locks.acquire(sys.argv[2], 30.0)
out, stop = sys.argv[4], sys.argv[3]
def status(state):
    with open(os.path.join(out, "part"), "w") as file:
        file.write('{"state": "%s", "process": %d, "iteration": 3, "iterations": 9}' % (state, os.getpid()))
    os.replace(os.path.join(out, "part"), os.path.join(out, "status.json"))
status("training")
while not os.path.exists(stop) and not os.path.exists(os.path.join(out, "finish")):
    time.sleep(0.01)
status("stopped" if os.path.exists(stop) else "finished")
"""
"""Stands in for a training process: it trains until it is asked to stop, or a file says that it has finished."""


@pytest.fixture
def make_jobs(tmp_path, monkeypatch):
    """make_jobs(): the queue as another Blender sees it, which has no children of its own."""
    def command(self, job, more=()):
        return [sys.executable, "-c", RUN, str(ROOT), *(str(self._file(job.id, suffix)) for suffix in (".lock", ".stop")), job.out]

    monkeypatch.setattr(Jobs, "command", command)
    made = []

    def make(**options):
        known = Jobs(tmp_path / "jobs", **options)
        known._children = {}
        made.append(known)
        return known

    yield make
    for known in made:
        for _, child in known._children.values():
            child.kill()
            child.wait()


def add(known, folder, name="run"):
    return known.add(folder / name, "/capture", sys.executable)


def trains(known, job):
    """The number of the job's process, as soon as it trains."""
    return until(lambda: known.state(job).kind == 'TRAINING' and known.state(job).values["process"])


@pytest.mark.slow
def test_two_hundred_adds_give_two_hundred_jobs_in_order(make_jobs, tmp_path):
    known = make_jobs(clock=lambda: 1000.0)
    names = [add(known, tmp_path, f"{k:03}").name for k in range(200)]
    jobs = known.all()
    assert [job.name for job in jobs] == names and len({job.id for job in jobs}) == 200


def test_a_clock_that_is_set_back_does_not_change_the_order(make_jobs, tmp_path):
    now = iter((5000.0, 10.0, 7000.0))
    known = make_jobs(clock=lambda: next(now))
    names = [add(known, tmp_path, name).name for name in "zab"]
    assert [job.name for job in known.all()] == names


def _adds(folder, begin, count, ready, go):
    known = Jobs(folder / "jobs")
    ready.release()
    go.wait()
    for k in range(begin, begin + count):
        known.add(folder / str(k), "/capture", sys.executable)


def _adds_the_same(folder, ready, go, answers):
    ready.release()
    go.wait()
    try:
        answers.put(Jobs(folder / "jobs").add(folder / "one", "/capture", sys.executable).id)
    except fg.FastGSError as error:
        answers.put(str(error))


def _together(work, arguments):
    """Run work(*arguments, ready, go) in processes that begin at the same moment."""
    spawn = multiprocessing.get_context("spawn")
    ready, go = spawn.Semaphore(0), spawn.Event()
    answers = spawn.Queue()
    extra = (answers,) if work is _adds_the_same else ()
    processes = [spawn.Process(target=work, args=(*each, ready, go, *extra)) for each in arguments]
    for process in processes:
        process.start()
    for _ in processes:
        while not ready.acquire(timeout=1):
            assert all(process.is_alive() for process in processes), "a process has ended before all were ready"
    go.set()
    given = [answers.get() for _ in processes] if extra else []
    for process in processes:
        process.join()
        assert process.exitcode == 0
    return given


def test_two_processes_that_add_at_once_lose_nothing(tmp_path):
    _together(_adds, [(tmp_path, 0, 60), (tmp_path, 60, 60)])
    jobs = Jobs(tmp_path / "jobs").all()
    assert sorted(int(job.name) for job in jobs) == list(range(120)) and len({job.id for job in jobs}) == 120


def test_a_folder_is_added_once_however_many_ask(tmp_path):
    answers = _together(_adds_the_same, [(tmp_path,)] * 3)
    job, = Jobs(tmp_path / "jobs").all()
    assert answers.count(job.id) == 1
    assert sum("not ended" in answer for answer in answers) == 2


def test_a_run_that_another_blender_resumed_is_alive(make_jobs, tmp_path):
    """A's own process is dead, B has resumed the run: to A it trains, nothing is started beside it, and A's stop reaches it."""
    a, b = make_jobs(), make_jobs()
    job, waiting = add(a, tmp_path, "one"), add(a, tmp_path, "two")
    a.start(job)
    trains(a, job)
    a._children[job.id][1].kill()
    a._children[job.id][1].wait()
    assert a.state(job).kind == 'FAILED'
    b.start(b.get(job.id))
    for known_to_a in (job, a.get(job.id)):  # also what A remembers from before
        trains(a, known_to_a)
        assert a.state(known_to_a).running
    assert a.start_next() is None and a.state(waiting).kind == 'QUEUED'
    assert not a.report_end(job), "it has been started again, so nobody is told of its end"
    a.ask(job, 'STOP')
    until(lambda: not b.alive(b.get(job.id)))
    assert a.state(a.get(job.id)).kind == b.state(b.get(job.id)).kind == 'STOPPED'


def test_a_job_that_another_blender_starts_is_alive_from_its_first_moment(make_jobs, tmp_path, monkeypatch):
    """Before its Python has come up: the lock is handed over."""
    a, b = make_jobs(), make_jobs()
    job = add(a, tmp_path)
    monkeypatch.setattr(Jobs, "command", lambda self, job, more=(): [sys.executable, "-c", "import time; time.sleep(3600)"])
    b.start(b.get(job.id))
    assert a.state(a.get(job.id)).kind == 'STARTING' and a.start_next() is None
    a.start(a.get(job.id))
    assert not a._children, "nothing is started beside it"
    b._children[job.id][1].kill()
    b._children[job.id][1].wait()
    monkeypatch.setattr(a, "clock", lambda: a.get(job.id).started + queue.GRACE)
    assert a.state(a.get(job.id)).kind == 'FAILED'


def test_the_end_of_a_job_is_told_once(make_jobs, tmp_path):
    a, b = make_jobs(), make_jobs()
    job = add(a, tmp_path)
    a.start(job)
    trains(a, job)
    (tmp_path / "run" / "finish").touch()
    until(lambda: a.state(job).kind == 'FINISHED' and not a.alive(job))
    seen_by_b = b.get(job.id)
    assert [a.report_end(job), b.report_end(seen_by_b), a.report_end(a.get(job.id))] == [True, False, False]


def test_what_one_blender_changes_another_does_not_undo(make_jobs, tmp_path):
    a, b = make_jobs(), make_jobs()
    job = add(a, tmp_path)
    b.ask(b.get(job.id), 'PAUSE')
    a.report_end(job)
    assert a.get(job.id).request == 'PAUSE' and job.request == 'PAUSE'
    b.forget(b.get(job.id))
    with pytest.raises(fg.FastGSError, match="list.*training jobs"):
        a.ask(job, 'QUEUED')
    assert not a.all()


def test_a_running_job_is_not_forgotten(make_jobs, tmp_path):
    known = make_jobs()
    job = add(known, tmp_path)
    known.start(job)
    trains(known, job)
    with pytest.raises(fg.FastGSError, match="is running"):
        known.forget(job)
    with pytest.raises(fg.FastGSError, match="not ended"):
        add(known, tmp_path)


def test_a_folder_in_which_the_command_line_trains_is_left_alone(make_jobs, tmp_path):
    known = make_jobs()
    job = add(known, tmp_path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "status.json").write_text('{"state": "training"}')
    with locks.acquire(tmp_path / "run" / "training.lock"):
        with pytest.raises(fg.FastGSError, match="another process"):
            known.start(job)
        assert (tmp_path / "run" / "status.json").exists()
    state = known.state(job)
    assert state.kind == 'FAILED' and "another process" in state.text
    known.start(job)
    trains(known, job)


@pytest.fixture
def old_run(tmp_path):
    """The folder of a run that has finished before."""
    folder = tmp_path / "run"
    folder.mkdir()
    for name, content in (("run.json", "{}"), ("model.safetensors", ""), ("status.json", '{"state": "finished", "iteration": 9}')):
        (folder / name).write_text(content)
    return folder


def test_a_finished_run_in_the_folder_is_not_the_new_one(make_jobs, tmp_path, old_run, monkeypatch):
    """Until the new job has written a status of its own, it waits and starts; its process is told to begin anew, once."""
    given = []
    command = Jobs.command
    monkeypatch.setattr(Jobs, "command", lambda self, job, more=(): given.append(list(more)) or command(self, job))
    known = make_jobs()
    job = known.add(old_run, "/other", sys.executable, existing="--overwrite")
    state = known.state(job)
    assert (state.kind, state.values) == ('QUEUED', {})
    with monkeypatch.context() as patch:  # it ends before it has begun its run
        patch.setattr(Jobs, "command", lambda self, job, more=(): given.append(list(more)) or [sys.executable, "-c", "raise SystemExit(1)"])
        known.start(job)
        known._children[job.id][1].wait()
    assert known.state(job).kind == 'FAILED'
    known.start(job)
    trains(known, job)
    known._children[job.id][1].kill()
    known._children[job.id][1].wait()
    known.start(job)
    trains(known, job)
    assert given == [["--overwrite"], ["--overwrite"], ["--resume"]], "what it has begun itself it continues"


def test_a_job_without_a_wish_leaves_an_old_run_alone(make_jobs, tmp_path, old_run):
    known = make_jobs()
    with pytest.raises(fg.FastGSError, match="finished"):
        add(known, tmp_path)
    assert not known.all()
    late = add(known, tmp_path, "late")  # a run comes into its folder while it waits
    old_run.rename(tmp_path / "late")
    assert known.start_next() is None
    state = known.state(known.get(late.id))
    assert state.kind == 'FAILED' and "finished run" in state.text
    assert (tmp_path / "late" / "status.json").exists()


def test_a_list_that_another_program_holds_is_waited_for(make_jobs, tmp_path, monkeypatch):
    known = make_jobs()
    job = add(known, tmp_path)
    monkeypatch.setattr(queue, "PATIENCE", 0.0)
    with locks.acquire(tmp_path / "jobs" / "queue.lock"):
        assert known.start_next(patience=0.0) is None and [found.id for found in known.all()] == [job.id]
        with pytest.raises(fg.FastGSError, match="another Blender"), known._changing(0.0):
            pass
    assert known.start_next().id == job.id


@pytest.mark.parametrize("content", [
    b"", b"{", b"[]", b"null", b"\xff\xfe", b'{"id": "x"}', b"[" * 100_000, b'{"id": "x", "out": 5, "capture": "c", "python": "p"}',
    b'{"id": "../x", "out": "/o", "capture": "c", "python": "p"}',
    b'{"id": "x", "out": "/o", "capture": "c", "python": "p", "created": NaN}',
    b'{"id": "x", "out": "/o", "capture": "c", "python": "p", "options": "abc"}',
    b'{"id": "x", "out": "/o", "capture": "c", "python": "p", "request": ["RUN"]}'])
def test_a_malformed_job_is_passed_over_with_a_note(make_jobs, tmp_path, content, caplog):
    known = make_jobs()
    job = add(known, tmp_path)
    (tmp_path / "jobs" / "x.json").write_bytes(content)
    with caplog.at_level(logging.WARNING):
        assert [found.id for found in known.all()] == [job.id] and known.get("x") is None
        known.all()
    note, = caplog.records
    assert "x.json" in note.message and "skipped" in note.message
    assert known.start_next().id == job.id


@pytest.mark.posix
def test_a_pipe_among_the_jobs_does_not_hang(make_jobs, tmp_path):
    known = make_jobs()
    job = add(known, tmp_path)
    os.mkfifo(tmp_path / "jobs" / "pipe.json")
    (tmp_path / "run").mkdir()
    os.mkfifo(tmp_path / "run" / "status.json")
    assert [found.id for found in known.all()] == [job.id] and known.state(job).kind == 'QUEUED'


def test_a_status_gives_what_is_of_its_kind_alone(tmp_path):
    path = tmp_path / "status.json"
    path.write_text('{"state": "training", "iteration": "9", "iterations": 20, "psnr": NaN, "seconds_left": -1, "gaussians": 1e999, '
                    '"reason": "a\\u001b[31m\\udcff", "process": 12, "other": [1]}')
    assert read_status(path) == {"state": "training", "iterations": 20, "process": 12, "reason": "a\\x1b[31m\\udcff"}
    assert read_status(tmp_path / "none.json") == {}


def test_damaged_job_and_status_files(tmp_path):
    """Whatever is in them, every state is one printable sentence, and what is read is what was written or is refused."""
    known = Jobs(tmp_path / "jobs")
    job = known.add(tmp_path / "run", "/capture", sys.executable, ["--preset", "draft"],
                    {"start_frame": 3, "world": "World", "blend": "/a.blend", "process": 7, "import": True})
    content = (tmp_path / "jobs" / f"{job.id}.json").read_bytes()
    states = {name: {"status.json": json.dumps(values).encode()} for name, values in {
        "training": {"state": "training", "process": 5, "iteration": 20, "iterations": 100, "gaussians": 30, "psnr": 20.5, "loss": 0.1,
                     "elapsed_seconds": 2.0, "seconds_left": 9.5},
        "failed": {"state": "failed", "reason": "the disk is full.", "iterations": 100}}.items()}

    def read_a_job(folder):
        assert read_job(folder / f"{job.id}.json").id == job.id

    def read_a_status(folder):
        job.out, job.request = str(folder), "RUN"
        state = known.state(job)
        assert state.text and "\n" not in state.text and state.text == fg.FastGSError(state.text).args[0]
        assert 0 <= state.share <= 1 and (state.seconds_left is None or state.seconds_left >= 0)
        assert "{:,} {:,} {:.1f}".format(*(state.values.get(name, 0) for name in ("iteration", "gaussians", "psnr"))).isascii()

    mutations.campaign("job", read_a_job, {"job": {f"{job.id}.json": content}}, tmp_path / "a", memory=256 << 20)
    mutations.campaign("status", read_a_status, states, tmp_path / "b", memory=256 << 20)


@pytest.mark.posix
def test_locks_of_two_looks_do_not_disturb_each_other(tmp_path):
    """While one process looks whether a file is held, another sees it as free."""
    path = tmp_path / "lock"
    path.touch()
    code = ("import fcntl, sys; f = open(sys.argv[1]); fcntl.flock(f, fcntl.LOCK_SH); print('looking', flush=True); sys.stdin.read()")
    child = subprocess.Popen([sys.executable, "-c", code, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "looking\n"
    assert not locks.is_locked(path)
    child.communicate()


def test_a_process_tells_each_sentence_in_one_line(monkeypatch):
    """However wide the terminal is that Blender was started in: its lines are read one by one."""
    monkeypatch.setenv("COLUMNS", "80")
    assert "COLUMNS" not in environment(sys.executable)
