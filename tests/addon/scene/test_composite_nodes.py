# SPDX-License-Identifier: GPL-3.0-or-later
"""The node group that joins splats and meshes, on single colours whose sum is known."""
import bpy
import pytest


@pytest.fixture
def joined(scene, module, add_camera, render):
    """joined(**values): the group's colour for values of its sockets."""
    add_camera()
    group = bpy.data.node_groups.new("Join", 'CompositorNodeTree')
    module("scene.composite_nodes").build(group)
    tree = module("scene.composite")._new_tree(scene)
    node = tree.nodes.new('CompositorNodeGroup')
    node.node_tree = group
    output = next(each for each in tree.nodes if each.inputs and not each.outputs)
    tree.links.new(node.outputs[0], output.inputs[0])
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.view_settings.view_transform = 'Raw'

    def run(**values):
        for name, value in values.items():
            node.inputs[name.replace("_", " ")].default_value = value
        return render("PNG16")[4, 4]

    return run


def test_what_meshes_and_splats_make_together(joined):
    """Colours are premultiplied; PNG files hold straight ones, so all of these fill the pixel with the world's blue."""
    splats, meshes = {"Splats": (0.2, 0, 0, 0.4), "Splat_Alpha": 0.4}, {"Meshes": (0, 0.5, 0, 0.5), "Mesh_Alpha": 0.5, "Mesh_Depth": 3.0}
    held = joined(**splats, **meshes, Splat_Depth=5.0, Splat_Holdout=0.3, World=(0, 0, 1, 1))
    assert held == pytest.approx([0.2, 0.3, 0.3, 1], abs=1e-3)  # splats + straight meshes x 0.3 + what is left of the world
    assert joined(Splat_Holdout=0.0, Splat_Depth=2.0) == pytest.approx([0.2, 0.3, 0.3, 1], abs=1e-3)  # splats over meshes
    assert joined(Splat_Depth=5.0) == pytest.approx([0.1, 0.5, 0.3, 1], abs=1e-3)  # meshes over splats
    assert joined(Splat_Shadow=0.5) == pytest.approx([0.1, 0.5, 0.3, 1], abs=1e-3)  # the lamp has no light there
    assert joined(Lamp=(0, 0.5, 0, 1)) == pytest.approx([0.1, 0.25, 0.3, 1], abs=1e-3)
    assert joined(Shadow_Strength=0.5) == pytest.approx([0.1, 0.375, 0.3, 1], abs=1e-3)
