# SPDX-License-Identifier: GPL-3.0-or-later
"""Stories without a window (see inside.py)."""
from __future__ import annotations

import os
import sys

import addon_utils
import bpy

ADDON = "bl_ext.user_default.fastgs_blender"
HEAVY = ("numba", "llvmlite", "torch", "OpenEXR", "scipy")
EYE = (3.2, -4.4, 3.0)
TARGET = (0.0, 0.0, 0.75)


def environment():
    """What this Blender is, and what the extension's installation gave it."""
    import numpy as np

    places = {}
    for name in ("numba", "safetensors", "OpenEXR"):
        try:
            places[name] = __import__(name).__file__
        except ImportError:
            places[name] = None
    versions = {"version": list(bpy.app.version), "python": sys.version.split()[0], "numpy": np.__version__}
    enabled = any(name.endswith(".fastgs_blender") for name, _ in bpy.context.preferences.addons.items())
    return {**versions, "places": places, "enabled": enabled,
            "engine": bpy.types.RenderEngine.bl_rna_get_subclass_py("FASTGS") is not None}


def enabling():
    """Enabling the installed extension in a Blender that has just begun."""
    before = set(sys.modules)
    module = addon_utils.enable(ADDON)
    return {"enabled": module is not None, "heavy": sorted(set(HEAVY) & (set(sys.modules) - before))}


def going():
    """Off, on, off; then uninstalled.  What is left behind, of Python's and on the disk."""
    def traces():
        return {"types": dir(bpy.types),
                "properties": sorted(bpy.types.Object.bl_rna.properties.keys() + bpy.types.Scene.bl_rna.properties.keys()),
                "handlers": {name: len(found) for name in dir(bpy.app.handlers)
                             if isinstance(found := getattr(bpy.app.handlers, name), list)}}

    here = traces()
    addon_utils.disable(ADDON, default_set=True)
    nothing = traces()
    addon_utils.enable(ADDON, default_set=True)
    again = traces()
    repository = next(r for r in bpy.context.preferences.extensions.repos if r.module == "user_default")
    bpy.ops.extensions.package_uninstall(repo_directory=repository.directory, pkg_id="fastgs_blender")
    gone = traces()
    folder = bpy.utils.user_resource("EXTENSIONS")
    left = [os.path.relpath(os.path.join(path, name), folder) for path, _, names in os.walk(folder) for name in names]
    return {"same": here == again, "gone": gone == nothing, "differ": here != nothing,
            "ours": [name for name in nothing["types"] if "fastgs" in name.lower()] + ["fastgs"] * ("fastgs" in nothing["properties"]),
            "enabled": ADDON in bpy.context.preferences.addons,
            "left": [name for name in left if "fastgs" in name.lower() or "numba" in name.lower() or name.endswith(".so")]}


def look(scene, width, height, eye=EYE, target=TARGET, lens=38):
    """The scene's camera before the model, and a picture whose numbers say what the splats are: no view transform of looks."""
    from mathutils import Vector

    camera = scene.camera or bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    if camera.name not in scene.collection.all_objects:
        scene.collection.objects.link(camera)
    scene.camera = camera
    camera.location = eye
    camera.rotation_euler = (Vector(target) - Vector(eye)).to_track_quat('-Z', 'Y').to_euler()
    camera.data.lens, camera.data.sensor_width, camera.data.sensor_fit = lens, 36, 'HORIZONTAL'
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.dither_intensity, render.film_transparent = 0, True
    scene.view_settings.view_transform = 'Standard'
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = 'IMAGE'
    render.image_settings.file_format, render.image_settings.color_mode = 'PNG', 'RGBA'
    bpy.context.view_layer.update()
    return {"matrix": [list(row) for row in camera.matrix_world], "width": width, "height": height, "focal": lens / 36 * width}


def bring(path):
    """A file with nothing but the imported model in it."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.import_scene.fastgs(filepath=os.path.abspath(path), use_engine=True, set_scene_range=True)
    return bpy.context.scene


def picture(model, output, width, height, frame):
    """Import, F12 on a frame, and the same again from the saved file."""
    scene = bring(model)
    camera = look(scene, width, height)
    scene.frame_set(int(frame), subframe=frame % 1)
    scene.render.filepath = os.path.abspath(output)
    bpy.ops.render.render(write_still=True)
    bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(f"{output}.blend"))
    obj = next(o for o in scene.objects if o.type == 'MESH')
    return {"camera": camera, "range": [scene.frame_start, scene.frame_end], "fps": scene.render.fps,
            "engine": scene.render.engine, "path": obj.fastgs.filepath, "count": obj.fastgs.gaussian_count,
            "start": obj.fastgs.start_frame}


def page(model, output, frames):
    """Import, and export the scene's first frames as a web page."""
    scene = bring(model)
    camera = look(scene, 320, 240)
    bpy.ops.fastgs.export_page(filepath=os.path.abspath(output), frame_start=scene.frame_start, frame_end=scene.frame_start + frames - 1)
    return {"camera": camera}


def opened():
    """The file that Blender was started with: what it says of its splats."""
    scene = bpy.context.scene
    return {"engine": scene.render.engine,
            "objects": {o.name: [o.fastgs.filepath, o.fastgs.gaussian_count, o.fastgs.start_frame]
                        for o in scene.objects if o.type == 'MESH'}}
