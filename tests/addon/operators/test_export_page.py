# SPDX-License-Identifier: GPL-3.0-or-later
"""File > Export > Web Page: the page holds the scene as final frames show it, says what it leaves out, and changes nothing."""
import base64
import json
import re
import wave
import zlib

import bpy
import image_files
import numpy as np
import pytest

SIZE = 96, 64


@pytest.fixture(autouse=True)
def few_small_pictures(module, monkeypatch):
    """Compression looks at little."""
    for part, name, value in (("sensitivity", "WIDTH", 64), ("rate", "SHOTS", 8), ("rate", "JUDGED", 3), ("rate", "SHOWN", 64)):
        monkeypatch.setattr(module(f"fastgs_blender.formats.{part}"), name, value)


@pytest.fixture
def export(scene, tmp_path):
    """export(**options): the page's description, its files by the ids of their scripts, and its poster."""
    def run(name="page.html", **options):
        assert bpy.ops.fastgs.export_page(filepath=str(tmp_path / name), **options) == {'FINISHED'}
        text = (tmp_path / name).read_text("utf-8")
        blocks = dict(re.findall(r'<script type="[a-z/]+" id="([\w-]+)">(.*?)</script>', text, re.DOTALL))
        description = json.loads(blocks.pop("scene"))
        files = {name: base64.b64decode(blocks[name]) for name in description["parts"]}
        poster = base64.b64decode(re.search(r'id="poster"[^>]*src="data:image/png;base64,([^"]+)"', text)[1])
        return description, files, poster

    return run


@pytest.fixture
def moving(fg, make_model, model_file):
    """The file of a model of 8 frames, 12 a second, that moves along x."""
    model = make_model(60, spread=0.6, axes="RFU", basis=fg.Polynomial(1), motion=np.full((60, 1, 3), (1.0, 0, 0)), clip=fg.Clip(8, 12.0))
    return model_file(model, "moving.safetensors")


@pytest.fixture
def pictures(scene, add_camera):
    """The scene as it is to be photographed, small and in sRGB."""
    scene.render.engine = 'FASTGS'
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = 'Standard'
    scene.render.fps, scene.frame_start, scene.frame_end = 12, 1, 8
    return add_camera()


def test_the_poster_is_what_f12_shows(scene, fg, pictures, moving, export, render, make_model, model_file, tmp_path):
    """Two objects, one turned, stretched, coloured and cropped; a world of one colour."""
    bpy.ops.import_scene.fastgs(filepath=moving)
    bpy.ops.import_scene.fastgs(filepath=model_file(make_model(50, seed=3, spread=0.7), "still.safetensors"))
    still = bpy.data.objects["still"]
    still.location, still.rotation_euler, still.scale = (0.3, 0.1, -0.2), (0.4, 0.5, 0.6), (1.2, 0.6, 0.9)
    still.fastgs.exposure, still.fastgs.opacity, still.fastgs.splat_scale = 0.5, 0.8, 0.9
    with bpy.context.temp_override(object=still, active_object=still, selected_objects=[still]):
        bpy.ops.fastgs.add_crop_box()
    still.fastgs.crops[0].object.scale.x *= 0.6
    scene.world = bpy.data.worlds.new("Blue")
    if bpy.app.version < (5, 0, 0):
        scene.world.use_nodes = True
    node = next(node for node in scene.world.node_tree.nodes if node.bl_idname == 'ShaderNodeBackground')
    node.inputs["Color"].default_value = (0.02, 0.05, 0.4, 1)
    description, files, poster = export()
    assert description["background"] == pytest.approx((0.02, 0.05, 0.4), abs=1e-5) and len(files) == 2
    assert description["title"] == "page" and description["frames"] == 8 and description["fps"] == 12 and description["loop"]
    (tmp_path / "poster.png").write_bytes(poster)
    wrong = np.abs(image_files.read_png(tmp_path / "poster.png")[..., :3].astype(int) - render("PNG")[..., :3])
    assert wrong.max() <= 2 and wrong.mean() < 0.5, (wrong.max(), wrong.mean())


def test_what_moves_is_sampled_and_what_stands_comes_once(scene, fg, pictures, moving, export):
    bpy.ops.import_scene.fastgs(filepath=moving)
    obj, camera = bpy.context.object, pictures
    for frame, x in ((1, 0.0), (8, 7.0)):
        obj.location.x = x
        obj.keyframe_insert("location", index=0, frame=frame)
        camera.location.z = x / 7
        camera.keyframe_insert("location", index=2, frame=frame)
    obj.fastgs.speed, obj.fastgs.after, obj.fastgs.trim_start = 2.0, 'LOOP', 2.0
    scene.frame_set(5)
    before = scene.frame_current, len(bpy.data.objects)
    description, _, _ = export(frame_start=1, frame_end=8)
    assert (scene.frame_current, len(bpy.data.objects)) == before
    (shown,) = description["objects"]
    places = np.array(shown["places"]).reshape(-1, 4, 4)
    assert len(places) == 8 and places[0, 0, 3] == pytest.approx(0) and places[7, 0, 3] == pytest.approx(7)
    assert np.array(shown["times"]) * 8 == pytest.approx([2, 4, 6, 2, 4, 6, 2, 4]), "six frames are left of eight, at twice the speed"
    assert len(shown["looks"]) == len(shown["crops"]) == 1
    assert description["opening"]["moves"] and len(description["opening"]["cameras"]) == 8
    rise = [np.array(eye["pose"]).reshape(4, 4)[2, 3] for eye in description["opening"]["cameras"]]
    assert rise[0] == pytest.approx(0, abs=1e-6) and rise[-1] == pytest.approx(1)
    still, _, _ = export(frame_start=1, frame_end=8, move=False)
    assert not still["opening"]["moves"] and len(still["opening"]["cameras"]) == 1


def test_what_is_not_there_on_a_frame_is_transparent_on_it(scene, pictures, moving, export):
    bpy.ops.import_scene.fastgs(filepath=moving)
    obj = bpy.context.object
    obj.fastgs.start_frame, obj.fastgs.before = 4, 'HIDE'
    (shown,) = export()[0]["objects"]
    assert [row[0] for row in shown["looks"]] == [0, 0, 0, 1, 1, 1, 1, 1]


def test_objects_with_one_file_share_it_and_filters_leave_gaussians_out(scene, fg, pictures, moving, export, tmp_path):
    bpy.ops.import_scene.fastgs(filepath=moving)
    twin = bpy.context.object.copy()
    scene.collection.objects.link(twin)
    twin.location.x = 3
    description, files, _ = export()
    assert [each["model"] for each in description["objects"]] == [0, 0] and len(files) == 1
    twin.fastgs.density = 0.5
    description, files, _ = export()
    assert [each["model"] for each in description["objects"]] == [0, 1]
    (tmp_path / "half.safetensors").write_bytes(files["model-1"])
    assert len(fg.load(tmp_path / "half.safetensors")) <= 30


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_compressed_file_is_taken_as_it_is(fg, pictures, moving, export, tmp_path):
    fg.save(fg.load(moving), tmp_path / "packed.safetensors", compress="fine")
    bpy.ops.import_scene.fastgs(filepath=str(tmp_path / "packed.safetensors"))
    files = export()[1]
    assert files["model-0"] == (tmp_path / "packed.safetensors").read_bytes()
    assert export(quality='SMALL')[1]["model-0"] != files["model-0"]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("own", [False, True], ids=["one time", "own times"])
def test_a_long_clip_is_written_piece_by_piece(scene, fg, module, pictures, moving, export, tmp_path, monkeypatch, own):
    """Moved and coloured as its object is; what filters hide is left out, and no model of all chapters is made."""
    model = fg.load(moving)
    fg.save(fg.chapters(*[model] * (1 + own), frames=2), tmp_path / "long.safetensors", compress="fine")
    bpy.ops.import_scene.fastgs(filepath=str(tmp_path / "long.safetensors"))
    obj = bpy.context.object
    for frame, x in ((1, 0.0), (8, 7.0)):
        obj.location.x = x
        obj.keyframe_insert("location", index=0, frame=frame)
    obj.fastgs.exposure, obj.fastgs.after, obj.fastgs.trim_start = 1, 'LOOP', 2.0
    clip = module("scene.objects").load_model(str(tmp_path / "long.safetensors"))
    monkeypatch.setattr(type(clip), "joined", None)
    description, files, _ = export()
    first, *others = description["objects"]
    assert [each["count"] for each in description["objects"]] == [piece.size for piece in clip.pieces] and len(files) == len(clip.pieces)
    assert all(each["like"] == 0 and "places" not in each for each in others) and first["looks"][0][10] != 1
    frames = clip.clip.frame_count
    assert np.array(first["times"]) * frames == pytest.approx([(2 + k) if 2 + k < frames else k + 4 - frames for k in range(8)])
    assert np.array(first["places"]).reshape(-1, 4, 4)[7, 0, 3] == pytest.approx(7)
    for k, piece in enumerate(clip.pieces):
        (tmp_path / "piece.safetensors").write_bytes(files[f"model-{k}"])
        assert np.array_equal(fg.load(tmp_path / "piece.safetensors").position, piece.read().position), "as the file has them"
    obj.fastgs.density = 0.5
    hidden, files, _ = export()
    assert all(each["count"] <= 0.5 * piece.size + 1 for each, piece in zip(hidden["objects"], clip.pieces, strict=True))
    steps = []

    def cancelled(*args):
        steps.append(args)
        raise InterruptedError

    monkeypatch.setattr(module("fastgs_blender.formats.web.long"), "_file", cancelled)
    with pytest.raises(RuntimeError):
        export("other.html")
    assert steps and not (tmp_path / "other.html").exists()


@pytest.mark.skipif(not bpy.app.build_options.audaspace, reason="this Blender has no sound")
def test_the_sound_of_the_sequencer_comes_along(scene, pictures, moving, export, tmp_path):
    bpy.ops.import_scene.fastgs(filepath=moving)
    with wave.open(str(tmp_path / "tone.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes((np.sin(np.arange(8000)) * 9000).astype("<i2").tobytes())
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strip = strips.new_sound("Tone", str(tmp_path / "tone.wav"), 1, 1)
    description, files, _ = export(frame_start=4)
    assert description["sound"]["start"] == pytest.approx(3 / 12) and len(files["sound"]) > 500
    assert description["parts"]["sound"]["crc"] == zlib.crc32(files["sound"])
    assert export(sound=False)[0]["sound"] is None
    strip.mute = True
    assert export()[0]["sound"] is None


def test_what_a_page_does_not_show_is_said_first(scene, module, pictures, moving, add):
    bpy.ops.import_scene.fastgs(filepath=moving)
    told = module("scene.web_scene").not_kept
    assert told(bpy.context) == []
    scene.view_settings.view_transform, scene.view_settings.exposure = 'AgX', 1
    scene.render.use_motion_blur = True
    pictures.data.dof.use_dof = True
    pictures.data.clip_start = 0.5
    obj = bpy.context.object
    obj.fastgs.points, obj.fastgs.lamp_light = 'ALL', 1
    obj.modifiers.new("Effect", 'NODES')
    for path in ("fastgs.density", "fastgs.exposure"):
        obj.keyframe_insert(path, frame=1)
    if bpy.app.version < (5, 0, 0):
        scene.use_nodes = True
    else:
        scene.compositing_node_group = bpy.data.node_groups.new("Compositing", 'CompositorNodeTree')
    add("cube").name = "Table"
    text = "; ".join(told(bpy.context))
    for words in ("AgX", "exposure", "meshes: Table", "depth of field", "motion blur", "Clip Start", "compositor", "the points of moving",
                  "Scene Light on moving", "the animation of density of moving; the first frame"):
        assert words in text, words
    assert "animation of exposure" not in text


def test_errors_are_sentences_and_nothing_is_written(scene, pictures, moving, make_model, model_file, tmp_path):
    assert not bpy.ops.fastgs.export_page.poll()
    bpy.ops.import_scene.fastgs(filepath=moving)
    page = tmp_path / "a.html"
    for options, text in (({"frame_start": 3, "frame_end": 2}, "another range"), ({"limit": 0.001}, "limit is 0.001 MB")):
        with pytest.raises(RuntimeError, match=text):
            bpy.ops.fastgs.export_page(filepath=str(page), **options)
    pictures.data.type = 'PANO'
    with pytest.raises(RuntimeError, match="Perspective.*Orthographic"):
        bpy.ops.fastgs.export_page(filepath=str(page))
    pictures.data.type, bpy.context.object.hide_render = 'PERSP', True
    with pytest.raises(RuntimeError, match="splats.*shown"):
        bpy.ops.fastgs.export_page(filepath=str(page))
    assert not page.exists()


def test_a_sequence_is_refused_with_the_way_out(pictures, make_model, model_file, tmp_path):
    for number in (1, 2):
        model_file(make_model(20, seed=number), f"take_{number}.ply")
    bpy.ops.import_scene.fastgs(filepath=str(tmp_path / "take_#.ply"))
    with pytest.raises(RuntimeError, match="fastgs convert"):
        bpy.ops.fastgs.export_page(filepath=str(tmp_path / "a.html"))


def test_a_scene_without_a_camera_opens_on_the_splats(scene, moving, export):
    bpy.ops.import_scene.fastgs(filepath=moving)
    scene.camera = None
    description, _, poster = export()
    eye = description["opening"]["cameras"][0]
    pose = np.array(eye["pose"]).reshape(4, 4)
    toward = np.array(description["pivot"]) - pose[:3, 3]
    assert toward @ pose[:3, 2] == pytest.approx(np.linalg.norm(toward), rel=1e-3) and len(poster) > 500
