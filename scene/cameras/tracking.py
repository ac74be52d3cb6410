# SPDX-License-Identifier: GPL-3.0-or-later
"""Computes the path of a region of Gaussians, which a camera follows."""
import bpy
import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.util.rotations import transformed
from .. import model_space, objects, parts, snapshot
from ..time import clip_frame

ROWS = 512
"""Frames that are smoothed at once."""
LEAST_OPACITY = 0.1
"""Of the Gaussians that are followed, on the current frame."""


def region_track(scene: bpy.types.Scene, obj: bpy.types.Object, radius: float, frames: np.ndarray, smooth: float) -> np.ndarray:
    """The region's middle in the world [F, 3] on each of the scene's frames [F].

    The region is made of the Gaussians of the splat object that are visible on the current frame within `radius` of the 3D cursor;
    `smooth` is the number of frames over which its motion is averaged.  Raises FastGSError where there are none.
    """
    model = parts.part_of(objects.load_one_model(obj, "followed from frame to frame"), obj.fastgs.part)
    fps = scene.render.fps / scene.render.fps_base
    world = model_space.placement(obj)

    def seen(at, subset):
        shown = clip_frame(at, fps, snapshot.retime_of(obj, at), model.clip)
        s = fg.slice_model(subset, model.clip.t_of_frame(shown or 0.0), cull=False)
        return transformed(s.position, world), s.opacity

    position, opacity = seen(scene.frame_current, model)
    near = np.linalg.norm(position - np.array(scene.cursor.location), axis=1) <= radius
    near &= opacity >= LEAST_OPACITY
    if not near.any():
        raise fg.FastGSError("there are no visible Gaussians around the 3D cursor; place it on what is to be followed (Shift + right "
                             "click) or enlarge the radius.")
    chosen = model.take(np.flatnonzero(near))
    middles = []
    for at in frames:
        position, opacity = seen(at, chosen)
        weight = opacity + 1e-6
        middles.append((position * weight[:, None]).sum(0) / weight.sum())
    return smoothed(np.array(middles), smooth)


def smoothed(places: np.ndarray, frames: float) -> np.ndarray:
    """Places [F, 3] averaged over about so many frames, with a Gaussian's weights; 0 leaves them as they are."""
    if frames <= 0:
        return places
    reach, out = np.arange(len(places)), []
    for first in range(0, len(places), ROWS):
        bell = np.exp(-0.5 * ((reach[first:first + ROWS, None] - reach) / max(frames / 2, 1e-3)) ** 2)
        out.append(bell @ places / bell.sum(1, keepdims=True))
    return np.concatenate(out)
