# SPDX-License-Identifier: GPL-3.0-or-later
"""Training from inside Blender: a process of its own trains, outlives Blender, and what goes wrong is told in one sentence."""
from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from held_runs import GUARD, HOOK, Barrier, until

FEW = ("--set", "init_points=60", "--set", "warm_up=", "--set", "preview_every=5", "--set", "checkpoint_seconds=0", "--set", "init=random")


@contextlib.contextmanager
def library_modules():
    """The modules of the library's tests can be imported."""
    sys.path[:0] = [str(Path(__file__).resolve().parents[3]), str(Path(__file__).resolve().parents[2] / "library")]
    try:
        yield
    finally:
        del sys.path[:2]


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """A capture of three views and two frames, as a FAST-GS capture."""
    with library_modules():
        from toy_captures import write_capture

        return write_capture(tmp_path_factory.mktemp("toy"), frames=2, views=4)


@pytest.fixture
def few(module, monkeypatch):
    """Runs that the operator starts have few Gaussians and no warm-up."""
    options = module("operators.train")
    arguments = options.arguments
    monkeypatch.setattr(options, "arguments", lambda given: [*arguments(given), *FEW])


@pytest.fixture(scope="module")
def compiled(module, toy, tmp_path_factory):
    """The kernels of training are compiled, which may take minutes on a busy machine, once for each version of them."""
    pytest.importorskip("torch")
    child = Path(module("fastgs_blender.jobs.queue").__file__).resolve().with_name("child.py")
    out = tmp_path_factory.mktemp("first") / "run"
    subprocess.run([sys.executable, child, child.parents[2], "", "", "train", toy, "--out", out, "--quiet", *FEW, "--iterations", "3"],
                   check=True, capture_output=True, timeout=GUARD)


@pytest.fixture
def jobs(module, compiled):
    """The user's jobs, none before and none after."""
    known = module("scene.training.installation").jobs()
    yield known
    for job in known.all():
        if known.alive(job):
            known.ask(job, 'STOP')
            until(lambda job=job: not known.alive(job))
        known.forget(job)


def add(jobs, toy, out, iterations=20):
    return jobs.add(out, toy, sys.executable, [*FEW, "--iterations", str(iterations)])


def end_of(jobs, job):
    return until(lambda: (state := jobs.state(job)) and not state.running and not jobs.alive(job) and state)


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 16 MB; None where none can be mounted."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = sys.platform == "linux" and not subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", place], capture_output=True, check=False).returncode
    yield place if mounted else None
    if mounted:
        subprocess.run(["umount", "-l", place], check=True)


@pytest.fixture
def barrier(tmp_path, monkeypatch):
    """Holds the training processes that this test starts."""
    held = Barrier(tmp_path / "barrier")
    for name, value in held.variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.syspath_prepend(HOOK)  # where the path of Blender's own Python comes from
    yield held
    held.release()


def held_process(jobs, job, barrier):
    """(step, process) of a job that the barrier holds, and by its status trains."""
    step, process = barrier.wait(lambda: jobs.alive(job) or pytest.fail(jobs.state(job).text))
    state = jobs.state(job)
    assert state.kind == 'TRAINING' and state.values["process"] == process and state.values["iteration"] <= step
    return step, process


def told(state):
    """The one sentence about a run that has failed."""
    assert state.kind == 'FAILED' and "\n" not in state.text and "Traceback" not in state.text and state.text.endswith(".")
    return state.text


@pytest.mark.slow
def test_killed_and_resumed(jobs, toy, tmp_path, small_disk, barrier):
    """kill -9 in the middle is told, and so are a full disk and a capture that has gone; the run goes on to the same end."""
    job = add(jobs, toy, (small_disk or tmp_path) / "run", 30)
    barrier.hold_at("step 7")
    jobs.start(job)
    step, process = held_process(jobs, job, barrier)
    assert step == 7
    os.kill(process, signal.SIGKILL)
    text = told(end_of(jobs, job))
    assert "memory" in text and "resum" in text
    if small_disk:
        barrier.hold_at("step 9")
        jobs.start(job)
        held_process(jobs, job, barrier)
        with contextlib.suppress(OSError), (small_disk / "other").open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass
        barrier.release()
        assert "disk is full" in told(end_of(jobs, job))
        (small_disk / "other").unlink()
    barrier.release()
    toy.rename(toy.with_name("gone"))
    jobs.start(job)
    assert "no such capture" in told(end_of(jobs, job))
    toy.with_name("gone").rename(toy)
    jobs.start(job)
    assert end_of(jobs, job).kind == 'FINISHED'
    assert json.loads((Path(job.out) / "report.json").read_text())["iterations"] == 30


def test_a_run_of_one_step_shows_that_it_trains(jobs, toy, tmp_path, barrier):
    job = add(jobs, toy, tmp_path / "run", 1)
    barrier.hold_at("step 1")
    jobs.start(job)
    held_process(jobs, job, barrier)
    assert jobs.state(job).values["iteration"] == 1
    barrier.release()
    assert end_of(jobs, job).kind == 'FINISHED'


OTHER = """
import sys
sys.path.insert(0, sys.argv[1])
from blender_setup import enable_addon
module = enable_addon()
import bpy
store = module("scene.training.installation")
store.folder = lambda name: __import__("pathlib").Path(sys.argv[2], name)
few = sys.argv[5:]
options = module("operators.train")
arguments = options.arguments
options.arguments = lambda given: [*arguments(given), *few]
assert bpy.ops.fastgs.train(capture=sys.argv[3], out=sys.argv[4], iterations=40, wait=False) == {'FINISHED'}
"""


def test_training_goes_on_when_blender_is_closed(module, compiled, toy, tmp_path, barrier):
    """A Blender begins a run and ends at once; the next one finds the run alive, stops it, and goes on with it."""
    tools = Path(__file__).resolve().parents[3] / "tools"
    barrier.hold_at("step 5")
    subprocess.run([sys.executable, "-c", OTHER, tools, tmp_path / "user", toy, tmp_path / "run", *FEW], check=True, capture_output=True,
                   timeout=GUARD)
    later = module("fastgs_blender.jobs.queue").Jobs(tmp_path / "user" / "training" / "jobs")
    job, = later.all()
    assert held_process(later, job, barrier)[0] == 5
    later.ask(job, 'STOP')
    assert later.state(job).kind == 'STOPPING'
    until(lambda: not later._file(job.id, ".stop").exists())  # the process has seen it
    barrier.release()
    state = end_of(later, job)
    assert state.kind == 'STOPPED' and state.values["iteration"] == 5
    later.start(job)
    assert end_of(later, job).kind == 'FINISHED'


def test_another_blender_finds_pauses_and_resumes(jobs, toy, tmp_path, monkeypatch, barrier):
    """A Blender that did not start the job knows it by its lock file alone."""
    first, second = add(jobs, toy, tmp_path / "one", 40), add(jobs, toy, tmp_path / "two")
    barrier.hold_at("step 3")
    assert jobs.start_next().id == first.id
    held_process(jobs, jobs.get(first.id), barrier)
    monkeypatch.setattr(type(jobs), "_children", {})  # as after closing Blender
    assert [jobs.state(job).kind for job in jobs.all()] == ['TRAINING', 'QUEUED'] and jobs.start_next() is None
    jobs.ask(first, 'PAUSE')
    assert jobs.state(first).kind == 'STOPPING'
    until(lambda: not jobs._file(first.id, ".stop").exists())
    barrier.release()
    state = end_of(jobs, first)
    assert state.kind == 'PAUSED' and state.values["iteration"] == 3
    assert jobs.start_next() is None, "a pause is not for the next job to begin"
    jobs.ask(jobs.get(first.id), 'STOP')
    assert jobs.state(jobs.get(first.id)).kind == 'STOPPED'
    assert jobs.start_next().id == second.id
    assert end_of(jobs, jobs.get(second.id)).kind == 'FINISHED'


def test_operators_train_look_in_between_and_import(jobs, module, toy, scene, tmp_path, monkeypatch):
    out = tmp_path / "run"
    options = module("operators.train").FASTGS_OT_train
    assert options.bl_idname == "fastgs.train"
    assert bpy.ops.fastgs.train(capture=str(toy), out=str(out), iterations=12, max_gaussians=500, start_frame=7) == {'FINISHED'}
    obj = bpy.context.object
    assert obj.fastgs.start_frame == 7 and obj.fastgs.gaussian_count > 10
    assert Path(bpy.path.abspath(obj.fastgs.filepath)) == out / "model.safetensors"
    # the checkpoint is the same model, all but the Gaussians that cannot be seen
    so_far = module("fastgs_blender.training.run.intermediate").write_model(out)
    load = module("fastgs_blender").load
    model, other = load(out / "model.safetensors"), load(so_far)
    assert np.array_equal(model.position, other.position) and np.array_equal(model.motion, other.motion)
    assert (model.clip, model.axes, model.basis) == (other.clip, other.axes, other.basis)
    results = module("scene.training.results")
    path = results.Reading(str(out), False).path  # what the thread does leaves Blender's data little to do
    monkeypatch.setattr(module("scene.splats.proxy_points"), "_choose", None)
    again = results.add_model(bpy.context, jobs.all()[0], path)
    assert again == obj and again.fastgs.filepath.endswith("so-far.safetensors")
    assert bpy.ops.fastgs.train_report() == {'FINISHED'}
    assert "Held-out PSNR" in bpy.data.texts["FAST-GS Report"].as_string()
    assert bpy.ops.fastgs.train_forget() == {'FINISHED'} and not jobs.all()


@pytest.fixture
def other_toy(tmp_path_factory):
    """Another capture than `toy`."""
    with library_modules():
        from toy_captures import write_capture

        return write_capture(tmp_path_factory.mktemp("other"), frames=2, views=3)


@pytest.fixture
def press(module, scene):
    """press(): what the panel's Train button does.  Blender without a window calls execute() at once, and invoke() never."""
    names = module("operators.train").FROM_PANEL
    return lambda: bpy.ops.fastgs.train(wait=False, **{name: getattr(scene.fastgs.training, name) for name in names})


def run_pressed(press, scene, module, **settings):
    """Press the panel's Train button with these settings, and let the queue work until nothing runs or waits; (job, its states)."""
    watch, jobs = module("scene.training.watch"), module("scene.training.installation").jobs()
    chosen = scene.fastgs.training
    chosen.source, chosen.iterations, chosen.max_gaussians = 'FOLDER', 8, 200
    for name, value in settings.items():
        setattr(chosen, name, str(value) if isinstance(value, Path) else value)
    assert press() == {'FINISHED'}
    job, kinds = jobs.all()[-1], []

    def ended():
        every = watch._poll()
        kinds.append(jobs.state(jobs.get(job.id)).kind)
        return every is None and not jobs.alive(job)

    until(ended)
    return jobs.get(job.id), kinds


@pytest.mark.slow
def test_a_folder_that_holds_a_finished_run_trains_again_as_it_was_asked(jobs, module, toy, other_toy, scene, tmp_path, few, press):
    """Through the panel's operator and the queue.  What is there already is never taken for what was asked for."""
    plan = module("fastgs_blender.training.run.plan").read_plan
    first, kinds = run_pressed(press, scene, module, capture=toy, out=tmp_path / "run", scan=other_toy)
    assert kinds[0] in ('STARTING', 'PREPARING', 'TRAINING') and kinds[-1] == 'FINISHED'
    assert plan(tmp_path / "run").source.scan == str(other_toy)
    shown, = (obj for obj in scene.objects if "fastgs_job" in obj)
    old = (tmp_path / "run" / "model.safetensors").read_bytes()

    beside, kinds = run_pressed(press, scene, module, capture=other_toy, out=tmp_path / "run", existing='NEW', scan="")
    assert Path(beside.out).name == "run-2" and kinds[0] != 'FINISHED' and kinds[-1] == 'FINISHED'
    assert (tmp_path / "run" / "model.safetensors").read_bytes() == old
    assert len([obj for obj in scene.objects if "fastgs_job" in obj]) == 2

    read = module("scene.objects").reloads()
    anew, kinds = run_pressed(press, scene, module, capture=other_toy, out=tmp_path / "run", existing='OVERWRITE')
    assert module("scene.objects").reloads() > read, "viewports read the file again"
    assert kinds[0] != 'FINISHED' and kinds[-1] == 'FINISHED' and anew.id != first.id and jobs.get(first.id) is None
    assert plan(tmp_path / "run").source.capture == str(other_toy)
    new = (tmp_path / "run" / "model.safetensors").read_bytes()
    assert new == (tmp_path / "run-2" / "model.safetensors").read_bytes() != old
    assert shown["fastgs_job"] == anew.id and len([obj for obj in scene.objects if "fastgs_job" in obj]) == 2, "the object follows its file"

    scene.fastgs.training.existing = 'RESUME'
    with pytest.raises(RuntimeError, match="nothing.*continue"):
        press()
    with pytest.raises(RuntimeError, match="finished"):
        bpy.ops.fastgs.train(capture=str(toy), out=str(tmp_path / "run"), wait=False)
    assert [job.id for job in jobs.all()] == [beside.id, anew.id]


@pytest.mark.slow
def test_going_on_with_a_run_takes_its_own_capture_and_options(jobs, module, toy, other_toy, scene, tmp_path, few, barrier, press):
    """Whether it is on the list of runs or not, and whatever the panel is set to now."""
    barrier.hold_at("step 3")
    scene.fastgs.training.capture, scene.fastgs.training.out, scene.fastgs.training.iterations = str(toy), str(tmp_path / "run"), 8
    press()
    job, = jobs.all()
    held_process(jobs, job, barrier)
    scene.fastgs.training.existing = 'RESUME'
    with pytest.raises(RuntimeError, match="not ended"):
        press()
    jobs.ask(job, 'PAUSE')
    until(lambda: not jobs._file(job.id, ".stop").exists())
    barrier.release()
    assert end_of(jobs, job).kind == 'PAUSED'
    module("scene.training.watch").refresh()
    same, kinds = run_pressed(press, scene, module, capture=other_toy, out=tmp_path / "run", existing='RESUME', iterations=500)
    assert same.id == job.id and kinds[-1] == 'FINISHED'
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["iterations"] == 8


def test_what_goes_wrong_is_one_sentence(jobs, toy, scene, tmp_path):
    for options, words in (
            (dict(capture=str(tmp_path / "lost")), "no such capture"), (dict(capture=""), "capture.*chosen"),
            (dict(capture=str(tmp_path)), "no capture"), (dict(source='CAMERAS'), "background"),
            (dict(source='SCENE'), "fastgs.capture_scene")):
        with pytest.raises(RuntimeError, match=words) as told:
            bpy.ops.fastgs.train(out=str(tmp_path / "run"), **options)
        assert "Traceback" not in str(told.value)


def test_a_python_without_what_training_needs_says_so(module, scene, toy, tmp_path, monkeypatch):
    """An empty environment, made here without the network, is told apart from one that can train."""
    pythons, preferences = module("fastgs_blender.jobs.environment"), module("scene.settings").preferences()
    venv = pytest.importorskip("venv")
    venv.create(tmp_path / "bare", with_pip=False, symlinks=True)
    preferences.training_choice, preferences.training_python = 'CHOSEN', str(tmp_path / "bare")
    try:
        with pytest.raises(RuntimeError, match="lacks numba, safetensors"):
            bpy.ops.fastgs.test_training_python()
        with pytest.raises(RuntimeError, match="numba|numpy"):
            bpy.ops.fastgs.train(capture=str(toy), out=str(tmp_path / "run"))
        preferences.training_python = str(tmp_path / "nowhere")
        with pytest.raises(RuntimeError, match="no Python"):
            bpy.ops.fastgs.test_training_python()
    finally:
        preferences.training_choice, preferences.training_python = 'AUTO', ""
    for job in module("scene.training.installation").jobs().all():
        module("scene.training.installation").jobs().forget(job)
    assert pythons.python_in(str(tmp_path)) is None


def test_no_environment_is_made_without_leave(scene):
    assert not bpy.app.online_access
    assert not bpy.ops.fastgs.make_training_python.poll()


def test_what_would_be_downloaded_is_said_before_anything_is(module, monkeypatch):
    operators, store = module("operators.make_environment"), module("scene.training.installation")
    app = SimpleNamespace(online_access=True, online_access_override=False, background=False)
    monkeypatch.setattr(operators, "bpy", SimpleNamespace(app=app))
    said, asked = [], []
    layout = SimpleNamespace(column=lambda **_: SimpleNamespace(
        label=lambda text, **_: said.append(text), prop=lambda owner, name, text: said.append(text)))
    dialog = SimpleNamespace(window_manager=SimpleNamespace(invoke_props_dialog=lambda operator, **_: asked.append(operator)))
    operator, this = operators.FASTGS_OT_make_training_python, SimpleNamespace(layout=layout)
    assert operators.offline_reason() == ""
    operator.invoke(this, dialog, None)
    operator.draw(this, dialog)
    text = " ".join(said)
    assert asked == [this] and store.maker is None and not store.made_environment().exists()
    assert "pycolmap" in text and "gigabyte" in text and "PyTorch" in text and str(store.made_environment()) in text
    app.online_access = False
    assert "Allow Online Access" in operators.offline_reason()
    app.online_access_override = True
    assert "--online-mode" in operators.offline_reason()


@pytest.mark.posix
def test_causes(module):
    sentence = module("fastgs_blender.jobs.causes").sentence
    cases = (
        (None, "x\nRuntimeError: [enforce fail] DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes.", 1, "memory"),
        (None, "", -9, "memory"), ("checkpoint could not be written: No space left on device", "", 2, "disk is full"),
        (None, "Traceback\nModuleNotFoundError: No module named 'torch'", 1, "lacks torch"),
        ("the capture is gone.", "", 2, "The capture is gone."), (None, "", None, "unexpectedly"), (None, "", 0xC0000005, "0xc0000005"),
        (None, "fastgs: /x: there is no such capture; check the name.", 2, "there is no such capture"),
        (None, "fastgs: 3 of 20 Gaussians are left out.", -9, "ended by the system"),
        (None, "fastgs: 3 of 20 Gaussians are left out.", -11, "SIGSEGV"), (None, "fastgs: lost: the cameras.", -15, "SIGTERM"),
        (None, "fastgs: lost: the cameras.\nValueError: odd", 1, "ValueError: odd"), (None, "fastgs: a remark.", 1, "unexpectedly"),
        ("the capture is gone.", "not enough memory for the GPU, so the processor is used", 2, "The capture is gone."))
    for reason, said, code, words in cases:
        text = sentence(reason, said, code, "/out")
        assert words in text and text.endswith(".") and "\n" not in text and ("left out" in text) == (words == "left out")
        other = sentence(reason, said, code, "/out", "the check")
        assert "raining" not in other.replace("he training Python", "") and "resum" not in other, other
