# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the meshes of an evaluated scene that hide splats, or catch their shadows, as triangles in the world."""
import functools

import numpy as np

from ..fastgs_blender.util.rotations import transformed
from . import arrays, objects

THROUGH = {'ShaderNodeBsdfTransparent', 'ShaderNodeBsdfGlass', 'ShaderNodeBsdfRefraction'}
"""Shaders that show what lies behind a surface."""


def with_meshes(scene) -> bool:
    """Whether final renders of a scene, evaluated or not, are joined with its meshes (composite.py)."""
    return scene.fastgs.render_meshes != 'OFF' and scene.render.use_compositing


def with_catchers(scene) -> bool:
    """Whether the shadows that Cycles' shadow catchers catch are laid over the splats of a scene, evaluated or not."""
    return with_meshes(scene) and scene.fastgs.render_meshes == 'CYCLES' and any(obj.is_shadow_catcher for obj in scene.objects)


def helpers(scene) -> set[str]:
    """Names of the objects whose surfaces are no part of the picture beside the splats: shapes that crop these, native copies, and meshes
    that were made of them."""
    shapes = {item.object.name for obj in scene.objects if objects.is_splat(obj) for item in obj.fastgs.crops if item.object is not None}
    return shapes | {obj.name for obj in scene.objects if (obj.fastgs.copy_of or obj.fastgs.surface_of) is not None}


def is_held_out(obj, view_layer) -> bool:
    """Whether Blender's own Holdout is switched on for an object, or for a collection it is in."""
    return obj.is_holdout or obj.original.holdout_get(view_layer=view_layer)


def hidden_by(depsgraph, visible=lambda obj: True) -> np.ndarray | None:
    """The triangles [F, 3, 3] float32 that hide splats in a render; None where no object does.

    They are those of objects with Blender's Holdout, and of all others that the camera sees if the scene says so.
    visible(obj) may leave out more, and is asked about the object that makes an instance.
    """
    layer, everything = depsgraph.view_layer, depsgraph.scene.fastgs.use_meshes or with_meshes(depsgraph.scene)
    catchers = with_catchers(depsgraph.scene)

    @functools.cache
    def hides(obj):
        return obj.fastgs.hides_splats and not lets_light_through(obj) and not (catchers and obj.is_shadow_catcher)

    return triangles(depsgraph, lambda obj, maker: visible(maker) and (
        is_held_out(obj, layer) or is_held_out(maker, layer) or (everything and hides(obj.original) and hides(maker.original))))


def lets_light_through(obj) -> bool:
    """Whether a material of an object may show what lies behind it.  Such an object hides no splats: it lies over them."""
    nodes = [node for slot in obj.material_slots if slot.material and slot.material.node_tree for node in slot.material.node_tree.nodes]
    if any(node.bl_idname in THROUGH for node in nodes):
        return True
    return any(socket.is_linked or socket.default_value != opaque
               for node in nodes if node.bl_idname == 'ShaderNodeBsdfPrincipled'
               for name, opaque in (("Alpha", 1.0), ("Transmission Weight", 0.0)) for socket in [node.inputs[name]])


def triangles(depsgraph, wanted=lambda obj, maker: True, ray: str = "visible_camera") -> np.ndarray | None:
    """The triangles [F, 3, 3] float32 of surfaces(); None without any."""
    found = [each for _, _, each in surfaces(depsgraph, wanted, ray)]
    return np.concatenate(found) if found else None


def surfaces(depsgraph, wanted=lambda obj, maker: True, ray: str = "visible_camera"):
    """Yields (an object, what makes the instance or the object itself, triangles [F, 3, 3] float32 in the world) for each of the scene's
    surfaces as the depsgraph has evaluated them, instances included.

    wanted(obj, maker) is asked about each object that has a surface; maker makes the instance, or is the object itself.
    ray  the rays that must see it: the property of Ray Visibility
    """
    aside, local = helpers(depsgraph.scene), {}
    for instance in depsgraph.object_instances:
        obj = instance.object
        maker = instance.parent if instance.is_instance else obj
        if obj.type not in objects.MESHABLE or not instance.show_self or objects.is_splat(obj) or obj.name in aside:
            continue
        if obj.hide_render or maker.hide_render:  # what a viewport shows and no render
            continue
        if ray == "visible_camera" and maker.original.indirect_only_get(view_layer=depsgraph.view_layer):
            continue
        if not (getattr(obj, ray) and getattr(maker, ray) and wanted(obj, maker)):
            continue
        matrix = np.array(instance.matrix_world, np.float64)
        key = obj.data.as_pointer()
        if key not in local:
            local[key] = own_triangles(obj)
        yield obj, maker, transformed(local[key], matrix).astype(np.float32)


def own_triangles(obj) -> np.ndarray:
    """An evaluated object's triangles [F, 3, 3] in its own space."""
    mesh = obj.to_mesh()
    try:
        return arrays.points(mesh)[arrays.triangles(mesh)]
    finally:
        obj.to_mesh_clear()
