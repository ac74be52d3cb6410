# SPDX-License-Identifier: GPL-3.0-or-later
"""Defines what the add-on stores in a .blend: one property group for each kind of datablock, behind a pointer named `fastgs`."""
from dataclasses import fields

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..fastgs_blender.rendering.instances import LOOKS, ObjectSettings
from ..fastgs_blender.rendering.passes import PASSES
from . import paths, updates
from .settings import BLEND_RELATIVE
from .time import Retime
from .training.options import FASTGS_PG_training

_OWN = {'LIBRARY_OVERRIDABLE'}
_SHOWN = {"override": _OWN, "update": updates.shown}

BACKDROP = (
    ('INSIDE', "From Inside", "Show the backdrop to cameras and views that stand inside it", 0),
    ('SHOWN', "Always", "Show the backdrop from outside too, where it hides what it surrounds", 1),
    ('HIDDEN', "Never", "Show what the backdrop surrounds and nothing behind it", 2),
)


class FASTGS_PG_crop(bpy.types.PropertyGroup):
    """A shape that crops a splat object."""

    object: PointerProperty(
        name="Object", description="An empty or a mesh, whose place and size are the shape's", type=bpy.types.Object, override=_OWN,
        poll=lambda self, obj: obj != self.id_data and obj.type in {'EMPTY', 'MESH'}, update=updates.viewports)
    mode: EnumProperty(
        name="Mode", description="What happens to the Gaussians whose centres are in the shape",
        items=(
            ('KEEP', "Keep", "Only what is in this or another shape to keep is shown", 'SELECT_INTERSECT', 0),
            ('REMOVE', "Remove", "What is in the shape is not shown", 'SELECT_SUBTRACT', 1),
        ), default='KEEP', **_SHOWN)
    shape: EnumProperty(
        name="Shape", description="What of the object crops",
        items=(
            ('BOX', "Box", "The box around it: its bounds, or an empty's size", 'CUBE', 0),
            ('SPHERE', "Sphere", "The ellipsoid within that box", 'SPHERE', 1),
            ('MESH', "Mesh", "The inside of the mesh, which must be closed; modifiers and animation count", 'MESH_MONKEY', 2),
        ), default='BOX', **_SHOWN)
    soft: FloatProperty(
        name="Soft Edge", description="Depth within the shape over which it begins to count, by half of its extent; 0 is a sharp edge",
        min=0.0, max=1.0, subtype='FACTOR', **_SHOWN)
    use: BoolProperty(name="Use", description="Crop with this shape", default=True, **_SHOWN)


class FASTGS_PG_filter(bpy.types.PropertyGroup):
    """A filter that hides Gaussians of a splat object for what they are."""

    kind: EnumProperty(
        name="Filter", description="What the filter looks at",
        items=(
            ('SIZE', "Size", "The longest axis of a Gaussian, in the model's units", 0),
            ('OPACITY', "Opacity", "The opacity that the file gives, without fading in and out", 1),
            ('SPEED', "Speed", "The mean speed while it can be seen, in the model's units per second", 2),
            ('LIFETIME', "Lifetime", "Seconds in which it can be seen", 3),
            ('COLOUR', "Colour", "Difference from a colour, 0 to 1", 4),
            ('NEIGHBOURS', "Neighbours", "How many other Gaussians are around it; floaters have few", 5),
            ('CAMERAS', "Cameras", "How many cameras of the capture have it in their pictures; few of them knew what it looks like", 6),
        ), default='SIZE', **_SHOWN)
    low: FloatProperty(name="From", description="Least value of those that are meant", default=0.0, precision=3, **_SHOWN)
    high: FloatProperty(name="To", description="Largest value of those that are meant", default=1.0, precision=3, **_SHOWN)
    colour: FloatVectorProperty(
        name="Colour", description="The colour from which the difference counts", subtype='COLOR_GAMMA', size=3, default=(0.0, 1.0, 0.0),
        min=0.0, max=1.0, **_SHOWN)
    mode: EnumProperty(
        name="Mode", description="What happens to the Gaussians that are meant",
        items=(
            ('HIDE', "Hide", "They are not shown", 0),
            ('KEEP', "Keep", "Only they are shown", 1),
        ), default='HIDE', **_SHOWN)
    use: BoolProperty(name="Use", description="Filter by this", default=True, **_SHOWN)


class FASTGS_PG_probe(bpy.types.PropertyGroup):
    """An empty at whose place the splats light the meshes of *Render With Meshes*."""

    use: BoolProperty(
        name="Light Probe", description="Light the meshes of Render With Meshes by what the splats look like from this object",
        default=False, update=updates.viewports)
    strength: FloatProperty(name="Strength", description="Factor on the light of the splats", default=1.0, min=0.0, soft_max=10.0)
    highlights: FloatProperty(
        name="Highlights", description="How many times as bright as captured white is: captures cut off the light of fires and lamps. "
        "Colours below a linear value of 0.5 stay", default=4.0, min=1.0, soft_max=32.0)
    width: IntProperty(
        name="Width", description="Pixels of the panorama around; half as many from top to bottom. More show more in mirrors",
        default=512, min=64, max=8192, subtype='PIXEL')


def _look(name, look):
    """The property of a look in the library's table."""
    default = getattr(ObjectSettings, name)
    made = FloatVectorProperty if isinstance(default, tuple) else FloatProperty
    return made(name=look.label, description=look.tooltip, default=default, min=look.low, max=look.high, **look.options, **_SHOWN)


_TIMES = {member.name: {float: FloatProperty, int: IntProperty, str: EnumProperty}[type(member.default)](
    default=member.default, **member.metadata, **_SHOWN) for member in fields(Retime) if member.metadata}
_Shared = type("_Shared", (), {"__annotations__": {name: _look(name, look) for name, look in LOOKS.items()} | _TIMES})


class FASTGS_PG_object(_Shared, bpy.types.PropertyGroup):
    """A splat object: the file it shows, what is known of it, and its place in time."""

    filepath: StringProperty(
        name="File", description="The 4D Gaussian file that this object shows", subtype='FILE_PATH', options=BLEND_RELATIVE,
        get=paths.shown, set=paths.put)
    file: PointerProperty(name="Cache File", description="The datablock that holds the path of the file", type=bpy.types.CacheFile)
    file_hash: StringProperty(
        name="File Hash", description="Fingerprint of the file when it was imported or last reloaded")
    gaussian_count: IntProperty(name="Gaussians", description="Number of Gaussians in the file", min=0)
    frame_count: IntProperty(name="Frames", description="Number of frames of the capture", min=0)
    fps: FloatProperty(
        name="Frame Rate", description="Frames per second of the capture; 0 where it has none and follows the scene's", min=0.0)

    has_backdrop: BoolProperty(name="Has a Backdrop", description="Whether the file says which Gaussians are sky or far walls")
    camera_count: IntProperty(name="Cameras", description="Number of the capture's cameras whose places the file knows", min=0)
    backdrop: EnumProperty(
        name="Backdrop", description="When to show the Gaussians that stand for sky and far walls", items=BACKDROP, default='INSIDE',
        override=_OWN, update=updates.viewports)

    subframes: EnumProperty(
        name="Sub-Frames", description="What a sequence of files shows between two of its frames",
        items=(
            ('INTERPOLATE', "Interpolate", "What lies between the two; the nearer one where their Gaussians do not match", 0),
            ('HOLD', "Hold", "The nearer frame", 1),
        ), default='INTERPOLATE', **_SHOWN)
    use_capture_frame: BoolProperty(
        name="Key the Capture Frame", description="Show the capture frame below, and ignore start, speed and time shift. Its keys make "
        "speed ramps, freezes and reverses", default=False, **_SHOWN)
    capture_frame: FloatProperty(
        name="Capture Frame", description="The frame of the capture to show; 0 is its first, fractions lie between frames", **_SHOWN)
    points: EnumProperty(
        name="Modifiers Change", description="What modifiers of this object, such as Geometry Nodes, lattices and armatures, change",
        items=(
            ('SOME', "Stand-Ins", "Only the few points that other render engines show in place of the splats", 0),
            ('ALL', "Splats", "The splats themselves: the object's mesh gets a point for each Gaussian, on every frame", 1),
        ), default='SOME', **_SHOWN)
    still_frame: FloatProperty(
        name="Freeze Frame", description="The frame of the capture to which nodes can freeze splats. Each point carries its place and "
        "opacity on that frame, as the attributes still_position and still_opacity", default=0.0, min=0.0, **_SHOWN)
    follow_points: BoolProperty(
        name="Turn and Stretch", description="Gaussians turn and stretch with the points around them where a lattice, an armature or "
        "another modifier deforms these; with Geometry Nodes alone they are only moved", default=True, **_SHOWN)
    crops: CollectionProperty(
        type=FASTGS_PG_crop, name="Crops", description="Shapes outside or inside which nothing of the model is shown",
        override=_OWN | {'USE_INSERTION'})
    filters: CollectionProperty(
        type=FASTGS_PG_filter, name="Filters", description="Which Gaussians are hidden for what they are",
        override=_OWN | {'USE_INSERTION'})

    probe: PointerProperty(type=FASTGS_PG_probe, name="Light Probe", description="How an empty lights meshes by splats")
    copy_of: PointerProperty(
        name="Copy Of", description="The splat object whose current frame this object holds, for other engines", type=bpy.types.Object)
    surface_of: PointerProperty(
        name="Surface Of", description="The splat object whose surface this mesh is, and with which it moves", type=bpy.types.Object)
    hides_splats: BoolProperty(
        name="Hides Splats", description="Let this object hide the splats behind it where the scene's Meshes Hide Splats is on. "
        "What lets light through, such as glass, never hides them", default=True, override=_OWN, update=updates.viewports)
    splat_shadow: BoolProperty(
        name="Splat Shadow", description="Let splats take the light of this lamp from meshes, in a pass Splat Shadow of its own",
        default=False, override=_OWN, update=updates.lamps)
    part: StringProperty(
        name="Part", description="Which Gaussians of the file are this object's own, packed; empty: all", options={'HIDDEN'}, **_SHOWN)
    mask: StringProperty(name="Erased", description="Which Gaussians were erased by hand, packed", options={'HIDDEN'}, **_SHOWN)
    selection: StringProperty(name="Selection", description="Which Gaussians are selected, packed", options={'HIDDEN'}, override=_OWN)
    wanted: StringProperty(
        name="Wanted", description="Which Gaussians were drawn over to be selected, packed: where Grow begins",
        options={'HIDDEN'}, override=_OWN)
    refused: StringProperty(
        name="Refused", description="Which Gaussians were drawn over to be taken out of the selection, packed: where Grow ends",
        options={'HIDDEN'}, override=_OWN)
    unsure: StringProperty(
        name="Unsure", description="Of which Gaussians Grow could not tell whether they belong to the thing, packed", options={'HIDDEN'},
        override=_OWN)
    viewport_density: FloatProperty(
        name="Viewport Density", description="Share of the Gaussians that viewports show, the most important ones first", default=1.0,
        min=0.0, max=1.0, subtype='FACTOR', **_SHOWN)
    density: FloatProperty(
        name="Render Density", description="Share of the Gaussians that final renders and exports show, the most important ones first",
        default=1.0, min=0.0, max=1.0, subtype='FACTOR', **_SHOWN)
    antialias: BoolProperty(
        name="Antialias", description="Draw splats as the capture's cameras saw them: finer in coarser pixels, so that small pictures "
        "stay sharp, and softer in finer pixels, so that close-ups show no needles. The file must know those cameras",
        default=True, **_SHOWN)


class FASTGS_PG_scene(bpy.types.PropertyGroup):
    """Settings of the render engine."""

    device: EnumProperty(
        name="Device", description="What computes final pictures and trains models; viewports are drawn by the graphics card in any case",
        items=(
            ('CPU', "CPU", "The processor: the same picture on every machine, to the last bit", 0),
            ('GPU', "GPU", "The GPU that the preferences name. Automatic is one that is faster than the processor, else the processor", 1),
        ), default='GPU')
    depth: EnumProperty(
        name="Depth",
        description="Which depth the Depth pass holds where splats are translucent",
        items=(
            ('EXPECTED', "Expected", "Mean depth of the splats, weighted by how much each is seen", 0),
            ('MEDIAN', "Median", "Depth at which half of the light is blocked: sharp edges, no values between surfaces", 1),
            ('FIRST', "First Hit", "Depth of the nearest splat, however faint it is", 2),
        ),
        default='EXPECTED')
    sorting: EnumProperty(
        name="Sorting", description="Which splat final renders take to be in front of another",
        items=(
            ('CENTRE', "By Centre", "The one whose centre is nearer. Splats that reach through each other pop while the camera turns", 0),
            ('PIXEL', "By Pixel", "In each pixel the one that is nearer there: nothing pops, and it takes the processor much longer", 1),
        ),
        default='CENTRE')
    render_meshes: EnumProperty(
        name="Render With Meshes", description="Render the scene's meshes too, by another engine, and join both pictures",
        items=(
            ('OFF', "Off", "Splats alone are rendered", 0),
            ('CYCLES', "Cycles", "Path tracing: light, shadows and reflections of the meshes", 1),
            ('EEVEE', "EEVEE", "Fast, needs a GPU", 2),
        ), default='OFF', update=updates.meshes)
    write_passes: BoolProperty(
        name="Write Passes", description="Write the picture and all passes of splats and of meshes into one multi-layer EXR for each "
        "frame, beside the scene's own pictures", default=False, update=updates.meshes)
    splats_scene: PointerProperty(
        name="Splats", description="The scene whose meshes this one renders", type=bpy.types.Scene, options={'HIDDEN'})
    use_meshes: BoolProperty(
        name="Meshes Hide Splats", description="Leave out of final renders what of the splats lies behind the scene's meshes, which "
        "another engine renders. Objects and collections with Holdout hide splats in any case", default=False, update=updates.viewports)
    shadow_samples: IntProperty(
        name="Samples", description="Points of the light from which shadows are looked at; more make soft shadows smoother", default=32,
        min=1, soft_max=256, max=4096)
    shadow_bias: FloatProperty(
        name="Bias", description="How near to a mesh splats cast no shadow on it: the captured ground lies where the mesh is that stands "
        "in for it",
        default=0.05, min=0.0, soft_max=1.0, unit='LENGTH', precision=3)
    contact_distance: FloatProperty(
        name="Contact Distance", description="How near a mesh must be to splats to count in the pass Contact Occlusion", default=0.3,
        min=0.0, soft_max=2.0, unit='LENGTH', precision=3)
    blur_steps: IntProperty(
        name="Steps", description="Into how many steps motion blur divides the time in which the shutter is open, at the most. Where "
        "little moves, fewer are taken; a power of two is used", default=32, min=2, soft_max=256, max=4096)
    lens_samples: IntProperty(
        name="Lens Samples", description="Points of the lens through which the scene is seen for depth of field, at the most. Where the "
        "picture is sharp, fewer are taken; a power of two is used", default=64, min=2, soft_max=1024, max=16384)
    show_splats: BoolProperty(
        name="Splats in Viewports", description="Draw the Gaussians themselves over Solid, Material Preview and other engines' "
        "Rendered shading, with the scene's meshes", default=True, update=updates.viewports)
    brush_radius: FloatProperty(
        name="Radius", description="Radius of the brushes that select and erase Gaussians, in pixels", default=40.0, min=1.0, max=2000.0,
        soft_max=400.0, subtype='PIXEL', precision=0)
    select_through: BoolProperty(
        name="Through to the Back", description="Select all Gaussians under what is drawn, and not only those that are seen", default=False)
    viewport_density: FloatProperty(
        name="Density in Motion", description="Share of the Gaussians in view to draw while the view moves or the time changes: those "
        "that count most in the picture. 1 draws all, in exact order", subtype='FACTOR', min=0.01, max=1.0, default=0.7,
        update=updates.viewports)
    viewport_pixels: EnumProperty(
        name="Pixel Size", description="Draw splats in viewports at a lower resolution",
        items=(
            ('1', "1x", "One pixel for each of the viewport's", 0),
            ('2', "2x", "A quarter of the viewport's pixels", 1),
            ('4', "4x", "A sixteenth of the viewport's pixels", 2),
        ), default='1', update=updates.viewports)
    show_pictures: BoolProperty(
        name="Pictures on Cameras", description="Show what cameras have filmed, their background images, on their frusta in viewports; "
        "during playback the pictures stand still", default=False, update=updates.viewports)
    picture_size: FloatProperty(
        name="Picture Size", description="Size of the pictures on frusta; 1 is where the frustum ends that Blender draws",
        min=0.01, soft_max=10.0, default=1.0, update=updates.viewports)
    hide_baked: BoolProperty(
        name="Hide Baked Objects", description="What the last bake was told: hide the objects, so that the Gaussians take their place")
    training: PointerProperty(type=FASTGS_PG_training, name="Training", description="What the Train panel is set to")


FASTGS_PG_view_layer = type("FASTGS_PG_view_layer", (bpy.types.PropertyGroup,), {
    "__doc__": """Switches of the passes that Blender has no switch for, from the library's table.""",
    "__module__": __name__,
    "__annotations__": {
        entry.switch.removeprefix("fastgs."): BoolProperty(
            name=entry.title or entry.blender, description=entry.description, default=False, update=updates.passes)
        for entry in PASSES.values() if not entry.builtin},
})


def _viewport_passes():
    """Items of a menu: the picture, and Blender's passes that the library's table fills, by the name of the first that fills each."""
    found = {}
    for entry in PASSES.values():
        if not entry.colour and not entry.level:
            found.setdefault(entry.blender, (entry.name.upper(), entry.title or entry.blender, entry.shows))
    return [(*item, number) for number, item in enumerate([('COMBINED', "Combined", "The picture"), *found.values()])]


class FASTGS_PG_shading(bpy.types.PropertyGroup):
    """What a viewport shows in Rendered shading."""

    render_pass: EnumProperty(
        name="Render Pass", description="What to show: the picture, or a pass in false colours",
        update=updates.viewports, items=_viewport_passes())


class FASTGS_PG_window_manager(bpy.types.PropertyGroup):
    """What all viewports show.  No undo holds it: to look at what was erased does not end the panel of the operator that erased it."""

    show_erased: BoolProperty(
        name="Show Erased", description="Show in viewports, in red, what was erased", default=False, update=updates.viewports)


class FASTGS_PG_camera(bpy.types.PropertyGroup):
    """A camera that comes from a capture."""

    view: StringProperty(name="View", description="The capture's name for this camera; empty for cameras of one's own")
    width: IntProperty(name="Width", description="Width of the pictures that it filmed, in pixels; 0 if unknown", min=0)
    height: IntProperty(name="Height", description="Height of the pictures that it filmed, in pixels", min=0)
    pixel_aspect_x: FloatProperty(name="Pixel Width", description="Pixel aspect of the pictures that it filmed", min=1.0, default=1.0)
    pixel_aspect_y: FloatProperty(name="Pixel Height", description="Pixel aspect of the pictures that it filmed", min=1.0, default=1.0)
    clip_start: IntProperty(name="Clip Start", description="Scene frame of the capture's first picture")
    clip_frames: IntProperty(name="Clip Frames", description="Frames of the capture; 0 if unknown", min=0)
    clip_fps: FloatProperty(name="Clip Rate", description="The capture's frames per second", min=0.0)


CLASSES = (FASTGS_PG_training, FASTGS_PG_crop, FASTGS_PG_filter, FASTGS_PG_probe, FASTGS_PG_object, FASTGS_PG_scene, FASTGS_PG_view_layer,
           FASTGS_PG_camera, FASTGS_PG_shading, FASTGS_PG_window_manager)
POINTERS = (
    (bpy.types.Object, FASTGS_PG_object),
    (bpy.types.Scene, FASTGS_PG_scene),
    (bpy.types.ViewLayer, FASTGS_PG_view_layer),
    (bpy.types.Camera, FASTGS_PG_camera),
    (bpy.types.View3DShading, FASTGS_PG_shading),
    (bpy.types.WindowManager, FASTGS_PG_window_manager),
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for owner, group in POINTERS:
        owner.fastgs = PointerProperty(type=group, override=_OWN)


def unregister():
    for owner, _ in POINTERS:
        del owner.fastgs
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
