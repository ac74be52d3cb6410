# SPDX-License-Identifier: GPL-3.0-or-later
"""The model that comes with the extension: it is there, small, imported ready to play, and shows something."""
import numpy as np


def test_the_example_is_imported_ready_to_play_and_renders(scene, add_camera, render, module):
    import bpy

    assert module("operators.example").EXAMPLE.stat().st_size < 8_000_000
    assert bpy.ops.fastgs.import_example() == {'FINISHED'}
    splats = bpy.context.object
    assert splats.fastgs.frame_count == 40 and scene.frame_end - scene.frame_start == 39 and scene.render.engine == 'FASTGS'
    add_camera(location=(0, -3.2, 1.5), rotation=(82, 0, 0))
    pictures = []
    for at in (1, 15):
        scene.frame_set(at)
        pictures.append(render("PNG")[..., :3].astype(float))
    assert np.std(pictures[0]) > 20 and np.abs(pictures[0] - pictures[1]).max() > 60
