# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole shot: two scenes, three view layers, stereo, camera markers, flags of collections and instances, meshes and splats joined.

Each cell (scene, layer, frame, eye) is compared with Blender's own render of the meshes and with the splats alone, by F12 and by a
process with another user folder that opens the moved .blend.
"""
from __future__ import annotations

import os
import subprocess
import sys

import bpy
import image_files
import numpy as np
import pytest
from conftest import ADDON, ROOT
from held_runs import GUARD

LAYERS, EYES, FRAMES = ("All", "No Left", "Held"), ("L", "R"), (1, 2)
JOINED = "Joined" if bpy.app.version >= (5, 0, 0) else "Join"
WORKER = f"""
import sys, bpy, addon_utils
assert addon_utils.enable({ADDON!r})
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
for scene in [scene for scene in bpy.data.scenes if scene.fastgs.render_meshes != 'OFF']:
    scene.render.filepath = f"//farm/{{scene.name}}_"
    bpy.ops.render.render(animation=True, scene=scene.name)
"""


@pytest.fixture
def shot(scene, screen, wall, sky, add, add_camera, paint):
    """Its two scenes.  The second one has cameras of its own, and the world behind it."""
    def moved(obj, name):
        inside = bpy.data.collections.get(name) or bpy.data.collections.new(name)
        inside.objects.link(obj)
        scene.collection.objects.unlink(obj)
        return inside

    def instance(inside, location):
        maker = bpy.data.objects.new(inside.name, None)
        maker.instance_type, maker.instance_collection, maker.location = 'COLLECTION', inside, location
        scene.collection.objects.link(maker)

    scene.name = "Wide"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.film_transparent = 48, 32, True
    scene.view_settings.view_transform = 'Raw'
    instance(moved(screen, "Splats"), (0, 0, 0.4))
    for name, x, colour in (("Left", -1.4, (0, 1, 0)), ("Right", 1.4, (0, 0, 1)), ("Mirrored", 0.0, (1, 1, 1))):
        scene.collection.children.link(moved(wall(x, -1.0, colour, size=0.9), name))
    instance(moved(wall(0.0, -1.5, (1, 1, 0), size=0.5), "Sign"), (0, 0, -0.7))
    wall(0, 2.0, (1, 0, 1), size=1.0)  # behind the splats
    scene.view_layers[0].name = LAYERS[0]
    for name in LAYERS[1:]:
        scene.view_layers.new(name)
    for layer in scene.view_layers:
        layer.layer_collection.children["Mirrored"].indirect_only = True
    scene.view_layers[LAYERS[1]].layer_collection.children["Left"].exclude = True
    scene.view_layers[LAYERS[2]].layer_collection.children["Right"].holdout = True
    scene.render.use_multiview, scene.frame_start, scene.frame_end = True, *FRAMES
    close = scene.copy()
    close.name = "Close"
    close.render.film_transparent = False
    for here, lens in ((scene, 24.0), (close, 36.0)):
        for frame, x in zip(FRAMES, (-0.3, 0.4), strict=True):
            camera = add_camera(location=(x, -5, 0), lens=lens)
            here.timeline_markers.new(f"cut {frame}", frame=frame).camera = camera
        here.camera = camera
    bpy.context.view_layer.objects.active = bpy.data.collections["Right"].objects[0]
    bpy.ops.rigidbody.object_add(type='PASSIVE')  # after the copy: Blender itself crashes with rigid bodies of two worlds
    return scene, close


def rendered(scene, folder, kind) -> dict:
    """Blender's own multi-layer files of a scene: {(layer, frame, eye): Combined}."""
    image_files.set_output(scene, "EXR")
    scene.render.image_settings.views_format = 'INDIVIDUAL'
    scene.render.filepath = f"{folder}/{scene.name} {kind}_"
    bpy.ops.render.render(animation=True, scene=scene.name)
    files = {(frame, eye): image_files.read_exr(f"{scene.render.filepath}{frame:04d}_{eye}.exr") for frame in FRAMES for eye in EYES}
    return {(layer, *key): planes[f"{layer}.Combined"] for key, planes in files.items() for layer in LAYERS}


def joined(path) -> dict:
    """{(layer, frame, eye): the joined picture} of the files of all passes that begin with a path."""
    files = {(frame, eye): image_files.read_exr(f"{path}passes_{frame:04d}_{eye}.exr") for frame in FRAMES for eye in EYES}
    return {(layer, *key): planes[f"{layer} {JOINED}.Combined"] for key, planes in files.items() for layer in LAYERS}


def interior(mask) -> np.ndarray:
    """The pixels of a mask whose neighbours are in it too."""
    inside = np.zeros_like(mask)
    inside[1:-1, 1:-1] = np.lib.stride_tricks.sliding_window_view(mask, (3, 3)).all((2, 3))
    return inside


@pytest.mark.slow
def test_every_cell_of_a_shot_is_right(shot, choose, module, tmp_path):
    splats, meshes = {}, {}
    for scene in shot:
        splats |= {(scene.name, *key): image for key, image in rendered(scene, tmp_path, "splats").items()}
        engine, film = scene.render.engine, scene.render.film_transparent
        scene.render.engine, scene.render.film_transparent, bpy.data.objects["Splats"].hide_render = 'CYCLES', True, True
        scene.cycles.samples, scene.cycles.use_denoising = 4, False
        meshes |= {(scene.name, *key): image for key, image in rendered(scene, tmp_path, "meshes").items()}
        scene.render.engine, scene.render.film_transparent, bpy.data.objects["Splats"].hide_render = engine, film, False

    found = {"F12": {}, "farm": {}}
    for scene in shot:
        choose(of=scene)
        scene.fastgs.write_passes = True
        tree = module("scene.joins").tree_of(scene)
        for layer in LAYERS[1:]:
            node = tree.nodes.new('CompositorNodeRLayers')
            node.scene, node.layer = scene, layer
    for scene in shot:
        bpy.context.window.scene = scene
        scene.render.filepath = f"{tmp_path}/here/{scene.name}_"
        image_files.set_output(scene, "PNG16")
        for frame in FRAMES:
            scene.frame_set(frame)
            bpy.ops.render.render()
        found["F12"] |= {(scene.name, *key): image for key, image in joined(scene.render.filepath).items()}

    (tmp_path / "saved").mkdir()
    (tmp_path / "model.safetensors").rename(tmp_path / "saved" / "model.safetensors")
    path = tmp_path / "saved" / "shot.blend"
    module("scene.paths").put(bpy.data.collections["Splats"].objects[0].fastgs, str(tmp_path / "saved" / "model.safetensors"))
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    (tmp_path / "saved").rename(tmp_path / "moved")
    user = tmp_path / "user" / "extensions" / "user_default"
    user.mkdir(parents=True)
    (user / "fastgs_blender").symlink_to(ROOT, target_is_directory=True)
    done = subprocess.run([sys.executable, "-c", WORKER, str(tmp_path / "moved" / "shot.blend")], capture_output=True, text=True,
                          timeout=GUARD, env=os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path / "user")}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    for scene in shot:
        found["farm"] |= {(scene.name, *key): image for key, image in joined(tmp_path / "moved" / "farm" / f"{scene.name}_").items()}

    assert len(splats) == 24 and set(splats) == set(meshes) == set(found["F12"]) == set(found["farm"])
    assert len({image.tobytes() for image in found["F12"].values()}) == 24, "no two cells are alike"
    for key, picture in found["F12"].items():
        np.testing.assert_allclose(found["farm"][key], picture, atol=1e-5, err_msg=str(key))
        before, beside = interior(meshes[key][..., 3] > 0.999), interior(meshes[key][..., 3] == 0)
        assert before.sum() > 15 and beside.sum() > 100, key
        behind = interior((meshes[key][..., :3] == (1, 0, 1)).all(-1))
        np.testing.assert_allclose(picture[before & ~behind], meshes[key][before & ~behind], atol=0.01, err_msg=str(key))
        np.testing.assert_allclose(picture[beside], splats[key][beside], atol=0.01, err_msg=str(key))
