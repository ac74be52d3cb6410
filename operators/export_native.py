# SPDX-License-Identifier: GPL-3.0-or-later
"""Export Native Splats: Blender 5.3's own Gaussian-splat point clouds as files, which Blender itself cannot write.

Their point attributes: position; scale, standard deviations; rotation, a quaternion w x y z; radiance:base, the constant coefficients of
the spherical harmonics and the opacity (0..1); radiance:sh_<k>, the coefficients above.
"""
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from .. import fastgs_blender as fg
from ..fastgs_blender.formats.scenes import placed, together
from ..fastgs_blender.formats.straight import logit
from .action import Action, Need

BASE, HARMONIC = "radiance:base", "radiance:sh_{}"
NEEDED = {"position": ("vector", 3), "scale": ("vector", 3), "rotation": ("value", 4), BASE: ("vector", 4)}
"""The name and width of an attribute's values."""
DEGREES = {0: 0, 3: 1, 8: 2, 15: 3, 24: 4}


def is_native_splats(obj) -> bool:
    """Whether an object is a point cloud with the attributes of Gaussian splats."""
    return obj is not None and obj.type == 'POINTCLOUD' and all(name in obj.data.attributes for name in NEEDED if name != "position")


def model_of(attributes) -> fg.GaussianModel:
    """The model in a point cloud's attributes, in the object's space.  Raises FastGSError where they fit no model."""
    def read(name, key, width):
        data = attributes[name].data
        values = np.empty(len(data) * width, np.float32)
        data.foreach_get(key, values)
        return values.reshape(-1, width)

    arrays = {name: read(name, *layout) for name, layout in NEEDED.items()}
    count = 0
    while HARMONIC.format(count) in attributes:
        count += 1
    if count not in DEGREES:
        raise fg.FastGSError(f"the point cloud has {count} coefficients of spherical harmonics above the first, which fits no degree "
                             f"({', '.join(map(str, DEGREES))} do).")
    base = arrays[BASE]
    with np.errstate(divide="ignore"):
        scale = np.maximum(np.log(arrays["scale"].astype(np.float64)), -60)
    features = np.concatenate([base[:, :3], *(read(HARMONIC.format(k), "vector", 3) for k in range(count))], 1)
    return fg.GaussianModel(arrays["position"], arrays["rotation"], scale, np.clip(logit(base[:, 3]), -30, 30), features,
                            appearance=fg.SH(DEGREES[count]), axes="RFU")


def _chosen(context) -> list:
    """The active and the selected objects that are such point clouds."""
    return [obj for obj in dict.fromkeys((context.object, *context.selected_objects)) if is_native_splats(obj)]


class FASTGS_OT_export_native(Action, bpy.types.Operator, ExportHelper):
    """Write Gaussian-splat point clouds of Blender 5.3 and later as PLY, or in another format by the name's extension"""

    bl_idname = "fastgs.export_native"
    bl_label = "Export Native Splats"
    bl_options = {'PRESET'}
    needs = (Need(lambda context: bool(_chosen(context)), "No Gaussian-splat point cloud is selected; Blender 5.3 and later make them"),)

    filename_ext = ".ply"
    check_extension = None
    filter_glob: StringProperty(default="*.ply;*.spz;*.sog;*.splat;*.glb", options={'HIDDEN'})
    world: BoolProperty(name="In World Space", description="Write the splats where the objects stand, in Blender's axes; else as the "
                        "first object's own space has them", default=True)

    def act(self, context):
        depsgraph = context.evaluated_depsgraph_get()
        models = [(model_of(shown.data.attributes), np.array(shown.matrix_world, np.float64))
                  for shown in (obj.evaluated_get(depsgraph) for obj in _chosen(context))]
        origin = np.eye(4) if self.world else np.linalg.inv(models[0][1])
        model = together([placed(model, origin @ place) for model, place in models])
        fg.save(model, Path(bpy.path.abspath(self.filepath)))
        return f"Exported {len(model):,} splats of {len(models)} point cloud{'s' if len(models) > 1 else ''}"
