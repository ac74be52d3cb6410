# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things are in scenes whose meshes and splats are joined."""
import bpy


def tree_of(scene):
    if bpy.app.version >= (5, 0, 0):
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def column(x, y=0.0, lens=30.0):
    """The column of a 64 pixels wide picture in which a place is seen from a camera at y = -5."""
    return int(32 + x / (5 + y) * lens / 36 * 64)
