# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies of splat objects that other engines render: an object beside the splat object holds what it shows on the current frame.

In Blender 5.3 and later it is a point cloud of Blender's own Gaussian splats, which EEVEE and Cycles light and reflect.  In 5.2 it can
be a point cloud, and in every version a mesh of discs, each with the colours.  It is updated whenever a frame, or the splat object, has
been evaluated: a handler writes the datablock, and Blender evaluates a datablock that a handler has changed once more, in final renders and
on their sub-frames too.  Its data is not saved: files hold an empty datablock, which is filled when the file is opened.
"""
import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...fastgs_blender.formats.scenes import as_seen
from ...fastgs_blender.model.appearance import SH_C0
from ...fastgs_blender.model.gaussians import GaussianModel
from ...fastgs_blender.model.slicing import sigmoid
from ...fastgs_blender.util import rotations
from ...fastgs_blender.util.errors import FastGSError
from .. import arrays, model_space, objects, snapshot
from ..colour import linear, rec709_to_working
from . import proxy_nodes
from .proxy_nodes import COLOUR

NAME = "FAST-GS Discs"
"""Of the material."""
CORNERS = 6
"""Of a disc."""
EDGE = 1.5
"""Standard deviations to which an opaque Gaussian is shown as a disc or a point; the area of others is less by their opacity."""

_written: dict[int, tuple] = {}
"""What each copy holds, as a value that can be compared, by its datablock's session_uid."""
_pairs: dict[int, int] = {}
"""The copies that were there at the last look, and their splat objects: session_uid of both."""


def kinds() -> list[tuple[str, str, str]]:
    """What a copy can be in this Blender, as items of a menu; the best one is the first."""
    found = [('DISCS', "Discs", "A mesh: each Gaussian is a disc along its two longest axes")]
    if hasattr(bpy.types.PointCloud.bl_rna, "functions") and "resize" in bpy.types.PointCloud.bl_rna.functions:
        found.insert(0, ('POINTS', "Points", "A point cloud: each Gaussian is a ball"))
    if "type" in bpy.types.PointCloud.bl_rna.properties:
        found.insert(0, ('SPLATS', "Gaussian Splats", "Blender's own splats, which EEVEE and Cycles render soft"))
    return found


def copies() -> list[bpy.types.Object]:
    """The copies in the open file whose splat objects are there."""
    return [obj for obj in bpy.data.objects if is_copy(obj) and objects.is_splat(obj.fastgs.copy_of)]


def is_copy(obj) -> bool:
    """Whether an object is such a copy."""
    return obj.fastgs.copy_of is not None


def make(context, obj, kind: str) -> bpy.types.Object:
    """A copy of a splat object, beside it and its child; the copy that it has already is taken again.

    The object's own points are no longer rendered by other engines, where they would stand in the copy.
    """
    name = f"{obj.name} Native"
    found = next((each for each in copies() if each.fastgs.copy_of == obj and (each.type == 'MESH') == (kind == 'DISCS')), None)
    if found is None:
        found = bpy.data.objects.new(name, bpy.data.meshes.new(name) if kind == 'DISCS' else bpy.data.pointclouds.new(name))
        found.parent = obj
        found.fastgs.copy_of = obj
        for collection in obj.users_collection or (context.scene.collection,):
            collection.objects.link(found)
    if kind != 'SPLATS':
        found.data.materials.clear()
        found.data.materials.append(_material())
    if "type" in bpy.types.PointCloud.bl_rna.properties and found.type == 'POINTCLOUD':
        found.data.type = 'GAUSSIAN_SPLAT' if kind == 'SPLATS' else 'POINTS'
    modifier = proxy_nodes.modifier_of(obj)
    if modifier is not None:
        modifier.show_render = False
    _written.pop(found.data.session_uid, None)
    _pairs[found.session_uid] = obj.session_uid
    follow(context.scene, context.evaluated_depsgraph_get())
    return found


@persistent
def follow(scene, depsgraph=None) -> None:
    """Handler, after each evaluation: update all copies to what their splat objects show."""
    if depsgraph is None:
        return
    for copy in copies():
        evaluated = copy.fastgs.copy_of.evaluated_get(depsgraph)
        if evaluated.is_evaluated:
            _renew(copy, evaluated, depsgraph)


@persistent
def tidy(scene, depsgraph=None) -> None:
    """Handler, after each evaluation: remove copies whose splat object is gone, and render the points of splat objects whose copy is
    gone."""
    if depsgraph is not None and depsgraph.mode != 'VIEWPORT':  # a render's own evaluation, perhaps in a thread
        return
    if _pairs:
        here = {obj.session_uid: obj for obj in bpy.data.objects}
        for copy, splat in ((here.get(copy), here.get(splat)) for copy, splat in _pairs.items()):
            there = splat is not None and splat.users_collection  # a pointer of ours keeps objects that no collection holds
            if copy is not None and copy.library is None and not there:
                data = copy.data
                bpy.data.objects.remove(copy)
                if not data.users:
                    (bpy.data.meshes if isinstance(data, bpy.types.Mesh) else bpy.data.pointclouds).remove(data)
            elif there and splat.is_editable and (copy is None or not copy.users_collection):
                modifier = proxy_nodes.modifier_of(splat)
                if modifier is not None and not any(other.fastgs.copy_of == splat and other.users_collection for other in bpy.data.objects):
                    modifier.show_render = True
    _pairs.clear()
    _pairs.update({obj.session_uid: obj.fastgs.copy_of.session_uid for obj in bpy.data.objects if is_copy(obj)})


@persistent
def forget(*_) -> None:
    """Handler, after undo and redo: forget what was written, because datablocks have been restored."""
    _written.clear()


@persistent
def empty(*_) -> None:
    """Handler, before the file is saved: empty the copies, so that the file does not hold their data."""
    tidy(None)
    for copy in copies():
        _resize(copy.data, 0)
    _written.clear()


@persistent
def fill(*_) -> None:
    """Handler, after the file was saved or opened: fill the copies again."""
    _written.clear()
    _pairs.clear()
    tidy(None)
    if copies() and bpy.context.view_layer is not None:
        follow(bpy.context.scene, bpy.context.evaluated_depsgraph_get())


def _renew(copy, obj, depsgraph):
    """Write a copy, unless it holds already what the evaluated splat object shows."""
    place = model_space.model_matrix(obj)
    item = snapshot.instance_of(obj, depsgraph, place)
    frame, fps = snapshot.clock(depsgraph.scene)
    state = item.state, frame, fps, objects.reloads()
    if _written.get(copy.data.session_uid) == state:
        return
    _written[copy.data.session_uid] = state
    model = _shown(snapshot.Snapshot([item], frame, fps))
    if copy.type == 'MESH':
        _write_discs(copy.data, model)
    else:
        _write_points(copy.data, model, getattr(copy.data, "type", None) == 'GAUSSIAN_SPLAT')
    copy.data.update_tag()


def _shown(shown: snapshot.Snapshot) -> GaussianModel | None:
    """What an object shows as one static model in its own space, without Gaussians that cannot be seen; None where that is nothing.

    A file that cannot be read shows nothing; the panel and FAST-GS itself say why.
    """
    try:
        model, _ = as_seen(shown.load()[0])
    except FastGSError:
        return None
    finite = np.isfinite(np.concatenate([model.position, model.scale, model.features], 1)).all(1)
    alive = finite & (sigmoid(model.opacity) >= model.raster.alpha_cut) & (model.scale.max(1) > -80)
    return model.take(np.flatnonzero(alive)) if alive.any() else None


def _resize(data, count: int):
    if isinstance(data, bpy.types.Mesh):
        data.clear_geometry()
    elif len(data.points) != count:
        data.resize(count)


def _put(data, name: str, kind: str, values: np.ndarray, domain: str = 'POINT'):
    """Write an attribute.  float32, C-contiguous: only then does foreach_set copy memory instead of asking for each number."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.data_type != kind or attribute.domain != domain:
        if attribute is not None:
            data.attributes.remove(attribute)
        attribute = data.attributes.new(name, kind, domain)
    member = next(name for name in ("vector", "color", "value") if hasattr(attribute.data[0], name))
    attribute.data.foreach_set(member, np.ascontiguousarray(values, np.float32).ravel())


def _write_points(cloud, model: GaussianModel | None, splats: bool):
    """Fill a point cloud: as Blender's splats, else as balls."""
    _resize(cloud, 0 if model is None else len(model))
    if model is None:
        return
    _put(cloud, "position", 'FLOAT_VECTOR', model.position)
    if not splats:
        _put(cloud, "radius", 'FLOAT', _edge(model) * np.exp(model.scale).prod(1) ** (1 / 3))
        _put(cloud, COLOUR, 'FLOAT_COLOR', np.concatenate([_light(model), np.ones((len(model), 1))], 1))
        return
    for name, kind, values in splat_attributes(model):
        _put(cloud, name, kind, values)
    bands = model.features.shape[1] // 3 - 1
    for attribute in [a for a in cloud.attributes if a.name.startswith("radiance:sh_") and int(a.name[12:]) >= bands]:
        cloud.attributes.remove(attribute)


def splat_attributes(model: GaussianModel) -> list[tuple[str, str, np.ndarray]]:
    """(name, type, values) of the attributes that Blender's own splats have beside their positions.

    Spherical harmonics stay as they were trained: Blender, too, takes them from files as they are.
    """
    coefficients = model.features.reshape(len(model), -1, 3)
    base = np.concatenate([coefficients[:, 0], sigmoid(model.opacity)[:, None]], 1)
    return [
        ("rotation", 'QUATERNION', rotations.unit(model.rotation.astype(np.float64))),
        ("scale", 'FLOAT_VECTOR', np.exp(model.scale)),
        ("radiance:base", 'FLOAT4', base),
        *((f"radiance:sh_{k - 1}", 'FLOAT_VECTOR', coefficients[:, k]) for k in range(1, coefficients.shape[1])),
    ]


def _write_discs(mesh, model: GaussianModel | None):
    """Fill a mesh with a disc for each Gaussian, along its two longest axes."""
    mesh.clear_geometry()
    if model is None:
        return
    count = len(model)
    order = np.argsort(-model.scale, 1)[:, :2]
    axes = np.take_along_axis(rotations.to_matrices(rotations.unit(model.rotation.astype(np.float64))), order[:, None, :], 2)
    axes = axes * (_edge(model)[:, None] * np.exp(np.take_along_axis(model.scale, order, 1)))[:, None, :]
    turn = 2 * np.pi * np.arange(CORNERS) / CORNERS
    corners = model.position[:, None] + np.einsum("nik,ck->nci", axes, np.stack([np.cos(turn), np.sin(turn)], 1))
    arrays.fill(mesh, corners.reshape(-1, 3), np.arange(count * CORNERS).reshape(-1, CORNERS))
    colour = np.concatenate([_light(model), np.ones((count, 1))], 1)
    _put(mesh, COLOUR, 'FLOAT_COLOR', np.repeat(colour, CORNERS, 0))
    mesh.update(calc_edges=True)


def _edge(model) -> np.ndarray:
    return EDGE * np.sqrt(sigmoid(model.opacity))


def _light(model) -> np.ndarray:
    """Scene-linear colours [N, 3], 0 or more, of the Gaussians seen from no particular side."""
    return linear(0.5 + SH_C0 * model.features[:, :3].astype(np.float64), model.colour_space) @ rec709_to_working().T


def _material() -> bpy.types.Material:
    """The material that emits the copy's colours, because captures contain their light; made once in each file."""
    found = next((m for m in bpy.data.materials if m.name == NAME and m.library is None), None)
    if found is not None:
        return found
    return proxy_nodes.shining_material(NAME)
