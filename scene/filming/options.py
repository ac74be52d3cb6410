# SPDX-License-Identifier: GPL-3.0-or-later
"""Options for filming the open scene."""
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty


class CaptureOptions:
    """Options of the pictures of a capture, shared by the panel and the operator."""

    cameras: EnumProperty(
        name="Cameras", description="Who films",
        items=(
            ('DOME', "Dome", "New cameras all around what moves", 0),
            ('ARC', "Arc", "New cameras in front of what moves", 1),
            ('SELECTED', "Selected Cameras", "The selected cameras of the scene, as they move", 2),
            ('ALL', "All Cameras", "All cameras of the scene, as they move", 3),
        ), default='DOME')
    count: IntProperty(name="Count", description="How many new cameras", default=12, min=2, max=1000, soft_max=100)
    angle: FloatProperty(
        name="Angle of View", description="Of the new cameras, across the picture's shorter side", subtype='ANGLE', default=0.733,
        min=0.05, max=2.6)
    distance: FloatProperty(
        name="Distance", description="Of the new cameras; at 1 the sphere in which the subject moves just fits", default=0.9, min=0.05,
        soft_max=5.0)
    subject: EnumProperty(
        name="Subject", description="What the new cameras look at and the masks show",
        items=(
            ('MOVING', "What Moves", "The objects that move, with all that hangs on the same parent", 0),
            ('SELECTED', "Selected Objects", "The selected objects and what hangs on them", 1),
        ), default='MOVING')
    width: IntProperty(name="Width", description="Of the pictures, in pixels", default=640, min=8, max=16384)
    height: IntProperty(name="Height", description="Of the pictures, in pixels", default=480, min=8, max=16384)
    quality: EnumProperty(
        name="Quality", description="How the scene's engine renders the pictures; the scene's own settings stay as they are",
        items=(
            ('FAST', "Few Samples", "Few samples and a fast denoiser", 0),
            ('SCENE', "As the Scene", "With the scene's own samples and denoiser", 1),
        ), default='FAST')
    world: EnumProperty(
        name="World", description="Background of the pictures, where the scene has no object",
        items=(
            ('AUTO', "Automatic", "Transparent if the world is a plain colour, which FAST-GS itself renders; else the world", 0),
            ('FILM', "Film It", "The world is filmed and becomes part of the model, far away", 1),
            ('LEAVE_OUT', "Leave Out", "Transparent: the model has only the scene's objects", 2),
        ), default='AUTO')
    samples: IntProperty(name="Samples", description="Samples per pixel, where few samples are chosen", default=16, min=1, soft_max=256)
    frame_step: IntProperty(name="Frame Step", description="Film only every n-th frame", default=1, min=1)
    hold_out: BoolProperty(
        name="Hold One View Out", description="Keep the first camera's pictures for evaluation instead of training on them", default=True)
