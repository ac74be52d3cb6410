# SPDX-License-Identifier: GPL-3.0-or-later
"""Training from inside Blender: the scene is filmed, a process of its own trains, and what goes wrong is told in one sentence."""
from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

SIZE = dict(width=32, height=24)
FEW = ("--set", "points=60", "--set", "warm_up=", "--set", "preview_every=5", "--set", "checkpoint_seconds=0", "--set", "start=random")


@pytest.fixture
def moving_scene(scene):
    """A ball that crosses a floor in two frames, lit, rendered by Cycles."""
    scene.render.engine = 'CYCLES'
    scene.cycles.samples = 77
    scene.view_settings.view_transform = 'AgX'
    scene.frame_start, scene.frame_end = 3, 4
    for name, size in (("Ball", 0.5), ("Floor", 9.0)):
        corners = size * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        if name == "Floor":
            corners[:, 2] = np.where(corners[:, 2] > 0, -0.5, -0.6)
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(corners.tolist(), [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
        obj = bpy.data.objects.new(name, mesh)
        scene.collection.objects.link(obj)
        if name == "Ball":
            for frame, x in ((3, -0.5), (4, 0.5)):
                obj.location.x = x
                obj.keyframe_insert("location", frame=frame)
    light = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    light.data.energy = 3
    scene.collection.objects.link(light)
    scene.frame_set(3)
    return scene


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """A capture of three views and two frames, as a FAST-GS capture."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "library"))
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    try:
        from toy_captures import write_capture

        return write_capture(tmp_path_factory.mktemp("toy"), frames=2, views=4)
    finally:
        del sys.path[:2]


@pytest.fixture(scope="module")
def compiled(module, toy, tmp_path_factory):
    """The kernels of training are compiled, which may take minutes on a busy machine, once for each version of them."""
    pytest.importorskip("torch")
    child = Path(module("fastgs_blender.jobs.queue").__file__).resolve().with_name("child.py")
    out = tmp_path_factory.mktemp("first") / "run"
    subprocess.run([sys.executable, child, child.parents[2], "", "", "train", toy, "--out", out, "--quiet", *FEW, "--iterations", "3"],
                   check=True, capture_output=True, timeout=1800)


@pytest.fixture
def jobs(module, compiled):
    """The user's jobs, none before and none after."""
    known = module("scene.training.store").jobs()
    yield known
    for job in known.all():
        if known.alive(job):
            known.ask(job, 'STOP')
            until(lambda job=job: not known.alive(job))
        known.forget(job)


def until(done, seconds=300.0):
    """Wait for something; returns what it gave."""
    end = time.monotonic() + seconds
    while not (found := done()):
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.05)
    return found


def add(jobs, toy, out, iterations=20):
    return jobs.add(out, toy, sys.executable, [*FEW, "--iterations", str(iterations)])


def end_of(jobs, job):
    return until(lambda: (state := jobs.state(job)) and not state.running and not jobs.alive(job) and state)


def settings_of(group, depth=2):
    """All plain values of Blender's settings, groups within included."""
    values = {}
    for name in group.bl_rna.properties.keys():  # noqa: SIM118 (it is no dictionary)
        value = getattr(group, name)
        if name == "use_nodes":
            continue
        if isinstance(value, (str, int, float, bool)):
            values[name] = value
        elif depth and isinstance(value, bpy.types.bpy_struct) and not isinstance(value, bpy.types.ID) and name != "rna_type":
            values |= {f"{name}.{key}": v for key, v in settings_of(value, depth - 1).items()}
    return values


def everything():
    """Names of the datablocks; the image of Blender's last render is its own affair."""
    kinds = ("scenes", "objects", "cameras", "images", "worlds")
    return {name: sorted({item.name for item in getattr(bpy.data, name)} - {"Render Result"}) for name in kinds}


def test_a_scene_is_filmed_and_left_as_it_was(moving_scene, module, fg, tmp_path):
    out = tmp_path / "film"
    before = settings_of(moving_scene), everything()
    assert bpy.ops.fastgs.capture_scene(out=str(out), count=4, samples=1, **SIZE) == {'FINISHED'}
    after = settings_of(moving_scene), everything()
    changed = {name for name in before[0] if before[0][name] != after[0][name]}
    assert changed <= {"fastgs.training.capture", "training.capture"} and before[1] == after[1]

    open_capture = module("fastgs_blender.captures").open_capture
    capture = open_capture(out)
    module("fastgs_blender.captures.pixels.checks").check(capture)
    assert capture.views == ["cam00", "cam01", "cam02", "cam03"] and capture.held_out_views == ["cam00"]
    assert (capture.clip.frame_count, capture.axes) == (2, "RFU")
    # the masks show the ball, in every view where the ball is: its centre is known
    store = module("fastgs_blender.captures.pixels.store").FrameStore(capture, 2**20, folder=tmp_path / "cache")
    for shot in capture.shots:
        pixels = store.pixels(shot)
        centre = np.array([(-0.5, 0.5)[shot.frame], 0, 0, 1])
        x, y, z = (shot.camera.world_to_camera @ centre)[:3]
        u, v = shot.camera.fx * x / z + shot.camera.cx, shot.camera.fy * y / z + shot.camera.cy
        rows, columns = np.nonzero(pixels.mask > 0.5)
        assert abs(columns.mean() + 0.5 - u) < 2 and abs(rows.mean() + 0.5 - v) < 2
    # points from depth lie on the ball's and the floor's surfaces, those that move belong to their frame
    points = capture.points
    moves = np.isfinite(points.t)
    assert 100 < moves.sum() < len(points)
    x = np.where(points.t[moves] == 0, -0.5, 0.5)
    assert np.quantile(np.abs(np.abs(points.xyz[moves] - np.c_[x, 0 * x, 0 * x]).max(1) - 0.5), 0.9) < 0.05
    assert np.quantile(np.abs(points.xyz[~moves, 2] + 0.5), 0.9) < 0.05


@pytest.mark.parametrize(("world", "textured", "filmed"), [
    ('AUTO', False, False), ('AUTO', True, True), ('FILM', False, True), ('LEAVE_OUT', True, False)])
def test_a_world_that_our_engine_shows_itself_is_left_out(moving_scene, module, tmp_path, world, textured, filmed):
    shown = moving_scene.world = bpy.data.worlds.new("Sky")
    if bpy.app.version < (5, 0, 0):
        shown.use_nodes = True
    if textured:
        tree = shown.node_tree
        tree.links.new(tree.nodes.new('ShaderNodeTexGradient').outputs[0], tree.nodes["Background"].inputs["Color"])
    bpy.data.objects["Floor"].hide_render = True
    bpy.ops.fastgs.capture_scene(out=str(tmp_path / "film"), count=2, samples=1, frame_end=3, world=world, **SIZE)
    assert not moving_scene.render.film_transparent
    capture = module("fastgs_blender.captures").open_capture(tmp_path / "film")
    pixels = module("fastgs_blender.captures.pixels.store").FrameStore(capture, 2**20, folder=tmp_path / "cache").pixels(capture.shots[0])
    assert (pixels.alpha is None) == filmed
    if not filmed:
        assert pixels.alpha[12, 16] == 1 and pixels.alpha[0, 0] == 0 and np.abs(pixels.alpha - pixels.mask).max() < 0.1


def test_filming_goes_on_where_it_stopped(moving_scene, tmp_path):
    out = tmp_path / "film"
    options = dict(out=str(out), count=3, samples=1, frame_end=3, **SIZE)
    bpy.ops.fastgs.capture_scene(**options)
    times = {path: path.stat().st_mtime_ns for path in out.rglob("0001.png")}
    (out / "cam01" / "0001.png").unlink()
    bpy.ops.fastgs.capture_scene(**options)
    again = {path for path, time in times.items() if path.stat().st_mtime_ns != time}
    assert again == {out / "cam01" / "0001.png", out / "masks" / "cam01" / "0001.png"}
    with pytest.raises(RuntimeError, match="other settings"):
        bpy.ops.fastgs.capture_scene(**(options | {"count": 4}))


def test_nothing_is_left_when_filming_fails(moving_scene, tmp_path):
    before = everything()
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError, match="cannot be written there"):
        bpy.ops.fastgs.capture_scene(out=str(tmp_path / "file" / "film"), count=3, samples=1, **SIZE)
    assert everything() == before
    with pytest.raises(RuntimeError, match="Fewer than two cameras"):
        bpy.ops.fastgs.capture_scene(out=str(tmp_path), cameras='ALL')


def test_own_cameras_film_as_they_move(moving_scene, add_camera, module, tmp_path):
    cameras = [add_camera((x, -6, 1), (85, 0, 0), lens=30) for x in (-1, 1)]
    cameras[1].keyframe_insert("location", frame=3)
    cameras[1].location.z = 2
    cameras[1].keyframe_insert("location", frame=4)
    bpy.ops.fastgs.capture_scene(out=str(tmp_path / "film"), cameras='ALL', samples=1, **SIZE)
    capture = module("fastgs_blender.captures").open_capture(tmp_path / "film")
    heights = {(shot.view, shot.frame): np.linalg.inv(shot.camera.world_to_camera)[2, 3] for shot in capture.shots}
    assert np.allclose([heights[view, frame] for view in ("Camera", "Camera.001") for frame in (0, 1)], [1, 1, 1, 2])
    assert abs(capture.shots[0].camera.fx - 30 / 36 * 32) < 1e-4


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


def trained_for_a_while(jobs, job):
    """The process of a job that has begun to train."""
    def process():
        state = jobs.state(job)
        assert state.kind not in ('FINISHED', 'FAILED'), "it has ended already"
        return state.kind == 'TRAINING' and state.values.get("iteration") and state.values["process"]

    return until(process)


def told(state):
    """The one sentence about a run that has failed."""
    assert state.kind == 'FAILED' and "\n" not in state.text and "Traceback" not in state.text and state.text.endswith(".")
    return state.text


def test_killed_and_gone_on_with(jobs, toy, tmp_path, small_disk):
    """kill -9 in the middle is told, and so are a full disk and a capture that has gone; the run goes on to the same end."""
    job = add(jobs, toy, (small_disk or tmp_path) / "run", 250)
    jobs.start(job)
    os.kill(trained_for_a_while(jobs, job), signal.SIGKILL)
    text = told(end_of(jobs, job))
    assert "memory" in text and "resum" in text
    if small_disk:
        jobs.start(job)
        process = trained_for_a_while(jobs, job)
        os.kill(process, signal.SIGSTOP)
        with contextlib.suppress(OSError), (small_disk / "other").open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass
        os.kill(process, signal.SIGCONT)
        assert "disk is full" in told(end_of(jobs, job))
        (small_disk / "other").unlink()
    toy.rename(toy.with_name("gone"))
    jobs.start(job)
    assert "there is no such capture" in told(end_of(jobs, job))
    toy.with_name("gone").rename(toy)
    jobs.start(job)
    assert end_of(jobs, job).kind == 'FINISHED'
    assert json.loads((Path(job.out) / "report.json").read_text())["iterations"] == 250


OTHER = """
import sys
sys.path.insert(0, sys.argv[1])
from blender_setup import enable_addon
module = enable_addon()
import bpy
store = module("scene.training.store")
store.folder = lambda name: __import__("pathlib").Path(sys.argv[2], name)
few = sys.argv[5:]
options = module("operators.train")
arguments = options.arguments
options.arguments = lambda given: [*arguments(given), *few]
assert bpy.ops.fastgs.train(capture=sys.argv[3], out=sys.argv[4], iterations=500, wait=False) == {'FINISHED'}
"""


def test_training_goes_on_when_blender_is_closed(jobs, module, toy, tmp_path):
    """A Blender begins a run and ends at once; the next one finds the run alive, stops it, and goes on with it."""
    files = module("fastgs_blender.jobs.queue")
    tools = Path(__file__).resolve().parents[2] / "tools"
    subprocess.run([sys.executable, "-c", OTHER, tools, tmp_path / "user", toy, tmp_path / "run", *FEW], check=True, capture_output=True,
                   timeout=300)
    later = files.Jobs(tmp_path / "user" / "training" / "jobs")
    job, = later.all()
    trained_for_a_while(later, job)
    first = until(lambda: later.state(job).values["iteration"])
    until(lambda: later.state(job).values["iteration"] > first)
    later.ask(job, 'STOP')
    state = end_of(later, job)
    assert state.kind == 'STOPPED' and first < state.values["iteration"] < 500
    later.start(job)
    assert end_of(later, job).kind == 'FINISHED'


def test_another_blender_finds_pauses_and_resumes(jobs, module, toy, tmp_path, monkeypatch):
    """A Blender that did not start the job knows it by its lock file alone."""
    files = module("fastgs_blender.jobs.queue")
    first, second = add(jobs, toy, tmp_path / "one", 4000), add(jobs, toy, tmp_path / "two")
    assert jobs.start_next().id == first.id
    until(lambda: jobs.state(first).kind == 'TRAINING')
    monkeypatch.setattr(files, "_children", {})  # as after closing Blender
    assert [jobs.state(job).kind for job in jobs.all()] == ['TRAINING', 'QUEUED'] and jobs.start_next() is None
    jobs.ask(first, 'PAUSE')
    assert jobs.state(first).kind == 'STOPPING'
    state = end_of(jobs, first)
    assert state.kind == 'PAUSED' and 0 < state.values["iteration"] < 4000
    assert jobs.start_next() is None, "a pause is not for the next job to begin"
    jobs.ask(jobs.get(first.id), 'STOP')
    assert jobs.state(jobs.get(first.id)).kind == 'STOPPED'
    assert jobs.start_next().id == second.id
    assert end_of(jobs, jobs.get(second.id)).kind == 'FINISHED'


def test_operators_train_look_in_between_and_import(jobs, module, toy, scene, tmp_path):
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
    assert bpy.ops.fastgs.train_report() == {'FINISHED'}
    assert "Held-out PSNR" in bpy.data.texts["FAST-GS Report"].as_string()
    assert bpy.ops.fastgs.train_forget() == {'FINISHED'} and not jobs.all()


def test_what_goes_wrong_is_one_sentence(jobs, toy, scene, tmp_path):
    for options, words in (
            (dict(capture=str(tmp_path / "lost")), "there is no such capture"), (dict(capture=""), "No capture is chosen"),
            (dict(capture=str(tmp_path)), "no capture"), (dict(source='CAMERAS'), "background"),
            (dict(source='SCENE'), "fastgs.capture_scene")):
        with pytest.raises(RuntimeError, match=words) as told:
            bpy.ops.fastgs.train(out=str(tmp_path / "run"), **options)
        assert "Traceback" not in str(told.value)


def test_a_python_without_torch_says_so(module, scene, toy, tmp_path, monkeypatch):
    """An empty environment, made here without the network, is told apart from one that can train."""
    pythons, preferences = module("fastgs_blender.jobs.environment"), module("scene.settings").preferences()
    import venv

    venv.create(tmp_path / "bare", with_pip=False, symlinks=True)
    preferences.training_choice, preferences.training_python = 'CHOSEN', str(tmp_path / "bare")
    try:
        with pytest.raises(RuntimeError, match="lacks torch, numba"):
            bpy.ops.fastgs.test_training_python()
        with pytest.raises(RuntimeError, match="PyTorch|numpy"):
            bpy.ops.fastgs.train(capture=str(toy), out=str(tmp_path / "run"))
        preferences.training_python = str(tmp_path / "nowhere")
        with pytest.raises(RuntimeError, match="There is no Python"):
            bpy.ops.fastgs.test_training_python()
    finally:
        preferences.training_choice, preferences.training_python = 'AUTO', ""
    for job in module("scene.training.store").jobs().all():
        module("scene.training.store").jobs().forget(job)
    assert pythons.python_in(str(tmp_path)) is None


def test_no_environment_is_made_without_leave(scene):
    assert not bpy.app.online_access
    assert not bpy.ops.fastgs.make_training_python.poll()


def test_what_would_be_downloaded_is_said_before_anything_is(module, monkeypatch):
    operators, store = module("operators.training_python"), module("scene.training.store")
    app = SimpleNamespace(online_access=True, online_access_override=False, background=False)
    monkeypatch.setattr(operators, "bpy", SimpleNamespace(app=app))
    said, asked = [], []
    layout = SimpleNamespace(column=lambda **_: SimpleNamespace(label=lambda text, **_: said.append(text)))
    dialog = SimpleNamespace(window_manager=SimpleNamespace(invoke_props_dialog=lambda operator, **_: asked.append(operator)))
    operator, this = operators.FASTGS_OT_make_training_python, SimpleNamespace(layout=layout)
    assert operators.offline_reason() == ""
    operator.invoke(this, dialog, None)
    operator.draw(this, dialog)
    text = " ".join(said)
    assert asked == [this] and store.maker is None and not store.made_environment().exists()
    assert "PyTorch" in text and "3 GB" in text and str(store.made_environment()) in text
    app.online_access = False
    assert "Allow Online Access" in operators.offline_reason()
    app.online_access_override = True
    assert "--online-mode" in operators.offline_reason()


def test_causes(module):
    sentence = module("fastgs_blender.jobs.causes").sentence
    cases = (
        (None, "x\nRuntimeError: [enforce fail] DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes.", 1, "memory"),
        (None, "", -9, "memory"), ("checkpoint could not be written: No space left on device", "", 2, "disk is full"),
        (None, "Traceback\nModuleNotFoundError: No module named 'torch'", 1, "lacks torch"),
        ("the capture is gone.", "", 2, "The capture is gone."), (None, "", None, "unexpectedly"),
        (None, "fastgs: /x: there is no such capture; check the name.", 2, "there is no such capture"))
    for reason, said, code, words in cases:
        text = sentence(reason, said, code, "/out")
        assert words in text and text.endswith(".") and "\n" not in text
