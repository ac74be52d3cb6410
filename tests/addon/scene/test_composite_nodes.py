# SPDX-License-Identifier: GPL-3.0-or-later
"""The node group that joins splats and meshes, on single colours whose sum is known."""
import bpy
import numpy as np
import pytest
from joined import column


@pytest.fixture
def group(scene, module, add_camera, render):
    """group("join", **values): the colour of a group of composite_nodes.py for values of its sockets, which the next call keeps."""
    add_camera()
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.view_settings.view_transform = 'Raw'
    tree = module("scene.joins")._new_tree(scene)
    output = next(each for each in tree.nodes if each.inputs and not each.outputs)
    nodes = {}

    def run(kind, **values):
        if kind not in nodes:
            made = bpy.data.node_groups.new(kind, 'CompositorNodeTree')
            getattr(module("scene.composite_nodes"), kind)(made)
            nodes[kind] = tree.nodes.new('CompositorNodeGroup')
            nodes[kind].node_tree = made
        tree.links.new(nodes[kind].outputs[0], output.inputs[0])
        for name, value in values.items():
            nodes[kind].inputs[name.replace("_", " ")].default_value = value
        return render("PNG16")[4, 4]

    return run


def test_what_meshes_and_splats_make_together(group):
    """Colours are premultiplied; PNG files hold straight ones, so all of these fill the pixel with the world's blue."""
    splats, meshes = {"Splats": (0.2, 0, 0, 0.4), "Splat_Alpha": 0.4}, {"Meshes": (0, 0.5, 0, 0.5), "Mesh_Alpha": 0.5, "Mesh_Depth": 3.0}
    held = group("join", **splats, **meshes, Splat_Depth=5.0, Splat_Holdout=0.3, World=(0, 0, 1, 1))
    assert held == pytest.approx([0.2, 0.3, 0.3, 1], abs=1e-3)  # splats + straight meshes x 0.3 + what is left of the world
    assert group("join", Splat_Holdout=0.0, Splat_Depth=2.0) == pytest.approx([0.2, 0.3, 0.3, 1], abs=1e-3)  # splats over meshes
    assert group("join", Splat_Depth=5.0) == pytest.approx([0.1, 0.5, 0.3, 1], abs=1e-3)  # meshes over splats


def test_a_shadow_takes_the_lamps_part(group):
    assert group("shade", Image=(0.1, 0.5, 0.2, 1), Lamp=(0, 0.3, 0.1, 1)) == pytest.approx([0.1, 0.5, 0.2, 1], abs=1e-3)
    assert group("shade", Splat_Shadow=0.5) == pytest.approx([0.1, 0.35, 0.15, 1], abs=1e-3)
    assert group("shade", Shadow_Strength=0.5) == pytest.approx([0.1, 0.425, 0.175, 1], abs=1e-3)
    assert group("shade", Denoise=1.0) == pytest.approx([0.1, 0.425, 0.175, 1], abs=5e-3)
    assert group("shade", Lamp=(0, 4, 0.1, 1))[1] == 0  # noise never makes light negative


def test_what_moves_before_a_holdout_is_blurred(scene, screen, wall, add_camera, choose, render):
    """The part of a pixel that a mesh's blur leaves is the holdout's hole, as in Cycles' picture of the meshes alone."""
    add_camera(lens=30.0)
    scene.render.film_transparent = scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 1.0
    wall(0.5, -0.5, (1, 0, 1), size=5.0).is_holdout = True
    moves = wall(0, -1.0, (0, 1, 0), size=1.6)
    for frame, x in ((0, 0.0), (2, 1.0)):
        moves.location.x = x
        moves.keyframe_insert("location", index=0, frame=frame)
    choose().cycles.samples = 128
    alpha = render("PNG16")[24, :, 3]
    assert alpha[column(0.6, -1)] > 0.98 and alpha[column(1.8, -1)] < 0.02 and (np.diff(alpha[column(0.6, -1):]) < 0.03).all()
    assert 0.3 < alpha[column(1.3, -1)] < 0.7
