# SPDX-License-Identifier: GPL-3.0-or-later
"""Clips in Blender: keyed capture frames, fades and echoes as F12 shows them; splitting, markers, sound."""
from __future__ import annotations

import wave
from itertools import pairwise

import bpy
import numpy as np
import pytest


@pytest.fixture
def shown(fg, model_file, add_camera, scene):
    """A cloud that moves to the right for 20 frames at 24 per second, imported, before a camera, on transparent film."""
    rng = np.random.default_rng(0)
    model = fg.GaussianModel(
        position=rng.uniform(-0.5, 0.5, (60, 3)), rotation=rng.normal(size=(60, 4)), scale=np.full((60, 3), -2.0), opacity=np.full(60, 3.0),
        features=rng.uniform(0, 1, (60, 3)), motion=np.tile([1.0, 0, 0], (60, 1, 1)), basis=fg.Polynomial(1), mu_tau=np.zeros(60),
        clip=fg.Clip(20, 24.0), axes="RFU")
    add_camera()
    scene.render.film_transparent = True
    bpy.ops.import_scene.fastgs(filepath=model_file(model))
    obj = bpy.context.object
    obj.fastgs.start_frame = 1
    return obj


@pytest.fixture
def expected(module, shown, scene, now, fg):
    """expected((capture frame, opacity), ...): the library's picture of the model at these frames."""
    instances, passes, snapshot = (module(name) for name in ("fastgs_blender.rendering.instances", "engine.passes", "scene.snapshot"))

    def picture(*frames):
        item = snapshot.take(bpy.context.evaluated_depsgraph_get()).instances[0]
        model = fg.load(item.path)
        parts = [instances.Instance(model, item.placement, frame / 20, instances.ObjectSettings(opacity=share)) for frame, share in frames]
        return passes.images(parts, now(scene.camera), [])["Combined"]

    return picture


def same(picture, wanted):
    assert np.abs(picture["ViewLayer.Combined"] - wanted).max() < 2e-3  # the file's half floats
    return True


def test_f12_shows_keyed_frames_fades_and_echoes(shown, scene, render, expected):
    settings = shown.fastgs
    pictures = []
    for frame in (10.0, 10.5, 11.0):
        scene.frame_set(11 + int(frame - 10), subframe=frame % 1)
        pictures.append(expected((frame, 1.0)))
        if frame % 1 == 0:
            assert same(render(), pictures[-1])
    assert all(np.abs(a - b).max() > 0.01 for a, b in pairwise(pictures))
    settings.use_capture_frame = True
    for frame, value in ((1, 12.0), (11, 12.0), (16, 2.0)):  # a freeze, then back
        settings.capture_frame = value
        settings.keyframe_insert("capture_frame", frame=frame)
    scene.frame_set(6)
    assert same(render(), expected((12.0, 1.0)))
    scene.frame_set(16)
    assert same(render(), expected((2.0, 1.0)))
    settings.use_capture_frame = False
    settings.echoes, settings.echo_spacing, settings.echo_fade = 2, 4.0, 0.5
    scene.frame_set(13)
    assert same(render(), expected((12.0, 1.0), (8.0, 0.5), (4.0, 0.25)))
    settings.echoes, settings.after, settings.fade, settings.trim_start = 0, 'LOOP', 4.0, 2.0
    scene.frame_set(16)  # 15 frames on in a clip of 18 that begins anew every 14
    assert same(render(), expected((3.0, 0.25), (17.0, 0.75)))


def test_the_panel_and_fitting_know_of_trims(module, shown, scene):
    shown.fastgs.trim_start, shown.fastgs.trim_end = 3.0, 2.0
    scene.frame_set(1)
    assert module("ui.facts").shown_now(shown, scene).startswith("Frame 3 ")
    bpy.ops.fastgs.fit_scene()
    assert (scene.frame_start, scene.frame_end) == (1, 15)


@pytest.mark.parametrize("speed", [1.0, 2.0, -1.0])
def test_split_shows_the_same_as_before(module, shown, scene, speed):
    """On every frame of the clip one of the two shows what the whole did, and the other nothing."""
    snapshot, shown_frames = module("scene.snapshot"), module("scene.time").shown_frames
    shown.fastgs.speed = speed
    clip = module("scene.objects").clip_of(shown)
    frames = range(1, 21 if abs(speed) == 1 else 11)
    before = [shown_frames(f, 24.0, snapshot.retime_of(shown, f), clip) for f in frames]
    scene.frame_set(6)
    assert bpy.ops.fastgs.split() == {'FINISHED'}
    second = bpy.context.object
    assert second is not shown and second.fastgs.filepath == shown.fastgs.filepath
    for frame, whole in zip(frames, before, strict=True):
        parts = [shown_frames(frame, 24.0, snapshot.retime_of(obj, frame), clip) for obj in (shown, second)]
        assert parts[frame >= 6] == [(pytest.approx(f), 1.0) for f, _ in whole] and parts[frame < 6] == []
    scene.frame_set(30)
    with pytest.raises(RuntimeError, match="split here"):
        bpy.ops.fastgs.split()


def test_markers(shown, scene):
    shown.fastgs.start_frame, shown.fastgs.trim_end = 11, 5
    for _ in range(2):
        bpy.ops.fastgs.mark_clip()
        assert {marker.name: marker.frame for marker in scene.timeline_markers} == {f"{shown.name} begins": 11, f"{shown.name} ends": 25}


@pytest.mark.skipif(not bpy.app.build_options.audaspace, reason="this Blender has no sound")
def test_sound_runs_with_the_clip(shown, scene, tmp_path):
    path = tmp_path / "sound.wav"
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(2 * 8000 * 2))  # two seconds, 48 frames
    shown.fastgs.start_frame, shown.fastgs.trim_start, shown.fastgs.trim_end = 11, 4, 6
    bpy.ops.fastgs.add_sound(filepath=str(path))
    editor = scene.sequence_editor
    strip = (editor.strips if hasattr(editor, "strips") else editor.sequences)[0]
    assert (strip.frame_final_start, strip.frame_final_end) == (11, 21)
    assert strip.frame_start == pytest.approx(7)  # its first four frames lie before the clip
    assert scene.sync_mode == 'AUDIO_SYNC'
    with pytest.raises(RuntimeError, match="none.wav.*found"):
        bpy.ops.fastgs.add_sound(filepath=str(tmp_path / "none.wav"))
    shown.fastgs.speed = -1
    with pytest.raises(RuntimeError, match="forwards"):
        bpy.ops.fastgs.add_sound(filepath=str(path))
