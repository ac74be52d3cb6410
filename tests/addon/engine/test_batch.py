# SPDX-License-Identifier: GPL-3.0-or-later
"""Animations rendered by processes of their own, as render farms do it: shared folders, failing frames, memory."""
from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import bpy
import image_files
import numpy as np
import pytest
from held_runs import GUARD

FRAMES = 6
WORKER = """
import sys, bpy, addon_utils
assert addon_utils.enable({addon!r})
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene = bpy.context.scene
scene.render.filepath = sys.argv[2]
{more}
bpy.ops.render.render(animation=True)
"""
MEMORY = """
import atexit

def tell(*_):
    with open("/proc/self/statm") as file:
        print("resident", scene.frame_current, file.read().split()[1], flush=True)

bpy.app.handlers.render_write.append(tell)
atexit.register(bpy.app.handlers.render_write.remove, tell)  # Blender 4.2 as a module crashes at its end where handlers are left
scene.frame_end = 60
"""


@pytest.fixture
def shot(scene, fg, make_model, model_file, splat_object, add_camera, tmp_path):
    """A saved file with a moving model, whose frames are not overwritten."""
    model = make_model(200, basis=fg.Polynomial(1), motion=np.tile([[[1.0, 0, 0]]], (200, 1, 1)), clip=fg.Clip(20, 24))
    splat_object(model_file(model))
    add_camera()
    image_files.set_output(scene, "PNG")
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.render.use_overwrite, scene.render.use_placeholder = False, True
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def begin(addon, shot):
    """begin(folder, more=""): a process that renders the shot's animation into a folder."""
    running = []

    def start(folder, more=""):
        code = WORKER.format(addon=addon.__name__, more=more)
        running.append(subprocess.Popen([sys.executable, "-c", code, str(shot), f"{folder}/"], text=True, stdout=subprocess.PIPE,
                                        stderr=subprocess.STDOUT))
        return running[-1]

    yield start
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


def done(process) -> tuple[str, int]:
    """(what it printed, its exit status)."""
    text, _ = process.communicate(timeout=GUARD)
    return text, process.returncode


@pytest.mark.slow
def test_machines_share_a_folder(begin, tmp_path):
    """Two at once make each frame; a third one finds nothing to do; the frames are those of one alone, to the byte."""
    both = [begin(tmp_path / "shared") for _ in range(2)]
    texts = []
    for process in both:
        text, status = done(process)
        assert status == 0, text
        texts.append(text)
    frames = sorted((tmp_path / "shared").glob("*.png"))
    assert [frame.stem for frame in frames] == [f"{number:04d}" for number in range(1, FRAMES + 1)]
    text, status = done(begin(tmp_path / "shared"))
    assert status == 0 and "Saved:" not in text
    bpy.context.scene.render.filepath = f"{tmp_path}/alone/"
    bpy.ops.render.render(animation=True)
    for frame in frames:
        np.testing.assert_array_equal(image_files.read_png(frame), image_files.read_png(tmp_path / "alone" / frame.name))


@pytest.mark.slow
def test_a_frame_that_fails_ends_the_process_loudly(begin, tmp_path):
    """The camera has no directions on frame 4: earlier frames are kept, the sentence is printed, the status is not 0."""
    more = "scene.camera.scale = 1, 1, 1; scene.camera.keyframe_insert('scale', frame=3)\n"
    more += "scene.camera.scale = 0, 0, 0; scene.camera.keyframe_insert('scale', frame=4)"
    text, status = done(begin(tmp_path / "frames", more))
    assert status != 0 and "camera" in text and "Error" in text
    kept = {frame.stem for frame in (tmp_path / "frames").glob("*.png")}
    assert kept == {"0001", "0002", "0003"}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="only Linux tells a process' memory in /proc")
def test_memory_stays_flat(begin, tmp_path):
    """Over sixty frames; benchmarks/memory.py looks at five hundred."""
    text, status = done(begin(tmp_path / "frames", MEMORY))
    assert status == 0, text
    pages = {int(number): int(size) for number, size in (line.split()[1:] for line in text.splitlines() if line.startswith("resident "))}
    assert len(pages) == 60
    early, late = (np.median([pages[n] for n in numbers]) for numbers in (range(11, 21), range(51, 61)))
    assert late < 1.02 * early, (early * os.sysconf("SC_PAGE_SIZE"), late * os.sysconf("SC_PAGE_SIZE"))
