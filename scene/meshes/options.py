# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of a bake, for the operator and for scripts."""
from types import SimpleNamespace

from bpy.props import EnumProperty, FloatProperty, IntProperty


class BakeOptions:
    """The frames to bake, and how they are sampled and fitted."""

    frame_start: IntProperty(name="Start", description="First frame; by default the scene's")
    frame_end: IntProperty(name="End", description="Last frame; by default the scene's")
    count: IntProperty(
        name="Gaussians", description="How many Gaussians to spread over the surface", default=100_000, min=1, max=50_000_000,
        soft_max=2_000_000)
    tolerance: FloatProperty(
        name="Tolerance", description="Mean distance from the true motion that is allowed, in percent of the object's size",
        subtype='PERCENTAGE', default=0.5, min=0.001, max=100.0, soft_max=5.0, precision=3)
    tail_tolerance: FloatProperty(
        name="99 % Within",
        description="Distance from the true motion that 99 % of the Gaussians keep to, in percent of the object's size: "
        "it holds hands and feet, which the mean hides",
        subtype='PERCENTAGE', default=1.0, min=0.001, max=100.0, soft_max=10.0, precision=3)
    max_order: IntProperty(
        name="Most Motion Terms", description="Largest number of terms that describe a path; 0: as many as the frames safely support",
        default=0, min=0, soft_max=100)
    basis: EnumProperty(
        name="Basis",
        description="Functions of time that describe the motion",
        items=(
            ('AUTO', "Automatic", "The basis that needs the fewest coefficients", 0),
            ('COSINE', "Cosine", "Half-period cosines: any motion within a clip", 1),
            ('FOURIER', "Fourier", "Sines and cosines with a linear term: turns, cycles and steady travel", 2),
            ('PAPER', "Fourier, Periodic", "As published: the motion returns to where it began", 3),
            ('KEYFRAMES', "Keyframes", "A smooth curve through evenly spaced keys: impacts and jerks", 4),
        ),
        default='AUTO')
    samples_per_frame: IntProperty(
        name="Samples per Frame",
        description="Number of times per frame at which the objects are sampled. 0: two, or four or eight where motion is too fast to be "
        "followed with fewer. Simulations are sampled on whole frames only",
        default=0, min=0, max=16)
    lighting: EnumProperty(
        name="Lighting",
        description="Light to paint onto the Gaussians",
        items=(
            ('NONE', "None", "The plain colours of the materials", 0),
            ('CYCLES', "Cycles", "The scene's diffuse light and shadows, the mean over the clip, computed by Cycles", 1),
        ),
        default='NONE')
    light_samples: IntProperty(
        name="Light Samples", description="Cycles samples per Gaussian for baked lighting", default=64, min=1, soft_max=4096)
    light_frames: IntProperty(
        name="Light Frames", description="Number of frames of the clip on which the light is sampled; they share the samples",
        default=8, min=1, soft_max=64)


def bake_options(**given) -> SimpleNamespace:
    """The options as plain values: those that are given, and the defaults of all others."""
    return SimpleNamespace(**{name: option.keywords.get("default") for name, option in BakeOptions.__annotations__.items()} | given)
