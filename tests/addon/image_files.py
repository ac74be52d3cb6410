# SPDX-License-Identifier: GPL-3.0-or-later
"""Letting Blender write pictures, and reading them back."""
import numpy as np


def set_output(scene, kind):
    """Let a scene write multi-layer EXR ("EXR") or PNG with 8 or 16 bits ("PNG", "PNG16")."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5.0 and later
        settings.media_type = 'MULTI_LAYER_IMAGE' if kind == "EXR" else 'IMAGE'
    settings.file_format = 'OPEN_EXR_MULTILAYER' if kind == "EXR" else 'PNG'
    settings.color_depth = {"EXR": '32', "PNG": '8', "PNG16": '16'}[kind]
    if kind != "EXR":
        settings.color_mode = 'RGBA'


def read_exr(path) -> dict[str, np.ndarray]:
    """Passes of a multi-layer EXR by "Layer.Pass", float32 [h, w, channels]; Blender 4 writes one part, 5 one part a pass."""
    import OpenEXR

    order = "RGBArgbaXYZWV"
    planes: dict[str, dict[str, np.ndarray]] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                full = name if name.count(".") >= 2 else f"{part.header['name']}.{name}"
                group, letter = full.rsplit(".", 1)
                planes.setdefault(group, {})[letter] = np.array(channel.pixels, np.float32)
    return {group: np.stack([p[c] for c in sorted(p, key=order.index)], -1) for group, p in planes.items()}


def read_png(path) -> np.ndarray:
    """An image as its integers [h, w, 4], read by Blender without any conversion."""
    import bpy

    image = bpy.data.images.load(str(path), check_existing=False)
    image.colorspace_settings.name = 'Non-Color'
    width, height = image.size
    values = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    deep = image.is_float
    bpy.data.images.remove(image)
    return values.reshape(height, width, 4)[::-1] if deep else np.round(values.reshape(height, width, 4)[::-1] * 255).astype(np.uint8)


def fcurves(datablock):
    """The animation curves of a datablock; Blender 5 keeps them in channel bags, one for each slot."""
    action = datablock.animation_data.action
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    return [curve for layer in action.layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves]
