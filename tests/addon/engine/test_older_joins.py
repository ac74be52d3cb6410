# SPDX-License-Identifier: GPL-3.0-or-later
"""Files with *Render With Meshes* of an older version: its node groups are made anew."""
import bpy
import numpy as np
from joined import tree_of


def test_groups_of_an_older_version_are_made_anew(scene, screen, wall, add_camera, choose, render, module):
    """A group without its newer sockets comes back with them; nodes keep their links, their values, and what they make."""
    joins = module("scene.joins")
    add_camera(lens=30.0)
    wall(-1.5, -1.0, (0, 1, 0))
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    lamp.fastgs.splat_shadow = True
    scene.collection.objects.link(lamp)
    choose()
    expected, tree = render("PNG16"), tree_of(scene)
    shade = next(node for node in tree.nodes if joins.LAMP in node)
    shade.inputs["Shadow Strength"].default_value = 0.3
    before = len(tree.nodes), len(tree.links), len(bpy.data.node_groups)
    for kind, name in ((joins.JOIN, "World"), (joins.SHADE, "Lamp")):
        group = next(group for group in bpy.data.node_groups if kind in group)
        group[kind] = True
        group.interface.remove(group.interface.items_tree[name])
    joins.join_all(scene)
    assert (len(tree.nodes), len(tree.links), len(bpy.data.node_groups)) == before
    assert all(name in joins._joins(tree)[0].inputs for name in ("World", "Catcher Bias"))
    shade = next(node for node in tree.nodes if joins.LAMP in node)
    assert "Lamp" in shade.inputs and abs(shade.inputs["Shadow Strength"].default_value - 0.3) < 1e-6
    shade.inputs["Shadow Strength"].default_value = 1
    np.testing.assert_array_equal(render("PNG16"), expected)
