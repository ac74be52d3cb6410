# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads Blender's shutter and the camera's depth of field as the library's exposure."""
import numpy as np

from ..fastgs_blender.rendering.exposure import Aperture, Exposure
from ..fastgs_blender.rendering.instances import Moment
from ..fastgs_blender.util.errors import FastGSError

LAST_FRAME = 1_048_574
"""Of Blender's scenes."""
MOMENTS = 9
"""Times at which the scene is looked at, at the most, while the shutter is open; objects and cameras go straight between them."""
CURVE = 65
"""Numbers by which the shutter's curve is known."""


def times(scene) -> list[float]:
    """When to look at the scene for its motion blur, in frames from the current one, evenly from opening to closing; none: no blur.

    Raises FastGSError where it is open for longer than there are frames.
    """
    render = scene.render
    length = render.motion_blur_shutter
    if not render.use_motion_blur or not length > 0:
        return []
    if abs(scene.frame_current) + length > LAST_FRAME:
        raise FastGSError(f"the shutter is open for {length:.6g} frames, and Blender knows none beyond {LAST_FRAME}; lower Shutter under "
                          "Motion Blur.")
    first = {'START': 0.0, 'CENTER': -0.5, 'END': -1.0}[render.motion_blur_position] * length
    return [first + length * i / (MOMENTS - 1) for i in range(MOMENTS)]


def aperture(camera_object, scene) -> Aperture | None:
    """The lens of an evaluated camera; None where everything is sharp, as in panoramas.

    As Cycles has it: the opening's radius is the focal length over twice the f-stop (an orthographic camera's is 1 over it), and a
    focus object's distance counts along the view axis.
    """
    data = camera_object.data
    dof = data.dof
    if not dof.use_dof or data.type == 'PANO':
        return None
    stop = 2 * max(dof.aperture_fstop, 1e-5)
    radius = 1 / stop if data.type == 'ORTHO' else 1e-3 * data.lens / stop
    distance = dof.focus_distance
    if dof.focus_object is not None:
        target = dof.focus_object.matrix_world
        bone = dof.focus_object.pose.bones.get(dof.focus_subtarget) if dof.focus_object.pose and dof.focus_subtarget else None
        place = (target @ bone.matrix if bone else target).translation
        pose = camera_object.matrix_world
        distance = abs(pose.col[2].xyz.normalized().dot(pose.translation - place))
    return Aperture(radius, max(distance, 1e-5), dof.aperture_blades if dof.aperture_blades >= 3 else 0, -dof.aperture_rotation,
                    dof.aperture_ratio, scene.fastgs.lens_samples)


def exposure(scene, moments: list[Moment], lens: Aperture | None) -> Exposure | None:
    """The exposure of a picture whose scene was looked at at times(), through a lens; None where neither blurs."""
    if not moments and lens is None:
        return None
    return Exposure(moments=tuple(moments), curve=_curve(scene.render) if moments else (1.0,), steps=scene.fastgs.blur_steps, aperture=lens)


def _curve(render) -> tuple[float, ...]:
    """How far the shutter is open from opening to closing; a curve that is never open counts as always open."""
    mapping = render.motion_blur_shutter_curve
    mapping.initialize()
    values = [max(mapping.evaluate(mapping.curves[0], float(x)), 0.0) for x in np.linspace(0, 1, CURVE)]
    return tuple(values) if max(values) > 0 else (1.0,)
