# SPDX-License-Identifier: GPL-3.0-or-later
"""Stories in Blender's window (see inside.py): the tools that erase splats, New Camera from View, and the panels as artists see them."""
from __future__ import annotations

from importlib import import_module

import bpy
from background import ADDON, bring, look
from mathutils import Euler
from window import area_of, press, seen_by, settled, shot, sidebar, through_camera, turns, within


def drag(places, **held):
    """Press the left button at the first of some places of the window, move through the others, let go; `held`: shift=True, ctrl=True."""
    window = bpy.context.window_manager.windows[0]
    places = [(int(x), int(y)) for x, y in places]
    window.event_simulate(type='MOUSEMOVE', value='NOTHING', x=places[0][0], y=places[0][1])
    yield from turns()
    for key in held:
        window.event_simulate(type=f"LEFT_{key.upper()}", value='PRESS', x=places[0][0], y=places[0][1], **held)
    yield from turns()
    window.event_simulate(type='LEFTMOUSE', value='PRESS', x=places[0][0], y=places[0][1], **held)
    yield from turns()
    for x, y in places[1:]:
        window.event_simulate(type='MOUSEMOVE', value='NOTHING', x=x, y=y, **held)
        yield from turns()
    window.event_simulate(type='LEFTMOUSE', value='RELEASE', x=places[-1][0], y=places[-1][1], **held)
    yield from turns()
    for key in held:
        window.event_simulate(type=f"LEFT_{key.upper()}", value='RELEASE', x=places[-1][0], y=places[-1][1])
    yield from turns()


def splat():
    """The object that shows splats; undo replaces objects, so that it must be looked for again."""
    return next(o for o in bpy.context.scene.objects if o.fastgs.filepath)


def choose(tool, area):
    """Choose a tool of the toolbar, which is shown."""
    area.spaces.active.show_region_toolbar = True
    with within(area):
        bpy.ops.wm.tool_set_by_id(name=tool)
    yield from turns()


def erasing(model):
    """A box that is dragged over the left half of the picture hides what is there; undo brings it back."""
    area, facts = yield from through_camera(model, 12)
    bpy.context.view_layer.objects.active = splat()
    left, top, width, height = facts["box"]
    low, high = (bpy.context.window_manager.windows[0].height - y for y in (top + height - 5, top + 5))
    with within(area):
        bpy.ops.ed.undo_push(message="Imported")  # a script's import is no undo step, a user's is
    yield from choose("fastgs.erase_box", area)
    yield from drag([(left + 5, low), (left + width / 2, high)])
    facts["mask"] = splat().fastgs.mask
    area.spaces.active.show_region_toolbar = False
    yield from settled("brushed")
    with within(area):
        bpy.ops.ed.undo()
    facts["undone"] = splat().fastgs.mask
    yield from settled("brush-undone")
    return facts


def strokes(model):
    """A stroke of the round brush, some of it restored with Shift; all restored; a lasso.  Each is one step of undo."""
    scene = bring(model)
    look(scene, 640, 420)
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_rotation, view.view_location, view.view_distance = Euler((1.1, 0, 0.3)).to_quaternion(), (0, 0, 0.6), 6.0
    scene.frame_set(12)
    yield from settled("tools-before")
    with within(area):
        bpy.ops.ed.undo_push(message="Imported")
        bpy.ops.object.select_all(action='DESELECT')
    bpy.context.view_layer.objects.active = None
    region = next(region for region in area.regions if region.type == 'WINDOW')
    middle = region.x + region.width / 2, region.y + region.height / 2
    across = [(middle[0] + dx, middle[1] + 0.2 * dx) for dx in range(-140, 141, 20)]
    yield from choose("fastgs.erase_brush", area)
    yield from drag([middle, middle])
    facts = {"nothing": splat().fastgs.mask}
    splat().select_set(True)
    bpy.context.view_layer.objects.active = splat()
    scene.fastgs.brush_radius = 30
    yield from press('RIGHT_BRACKET', area)
    facts.update(radius=scene.fastgs.brush_radius, frame=scene.frame_current - splat().fastgs.start_frame, **seen_by(area))
    facts["path"] = [(int(x) - region.x, int(y) - region.y) for x, y in across]
    yield from drag(across)
    shot("eraser-dragged")
    facts["erased"] = splat().fastgs.mask
    yield from drag(across[:5], shift=True)
    facts["restored"] = splat().fastgs.mask
    yield from settled("tools-erased")
    with within(area):
        bpy.ops.ed.undo()
    facts["undone"] = splat().fastgs.mask
    with within(area):
        bpy.ops.fastgs.show_hidden()
    yield from choose("fastgs.erase_lasso", area)
    around = [(middle[0] + dx, middle[1] + dy) for dx, dy in ((-150, -60), (-100, 90), (20, 40), (120, 110), (90, -80))]
    facts["lasso"] = [(int(x) - region.x, int(y) - region.y) for x, y in around]
    yield from drag(around)
    facts["lassoed"] = splat().fastgs.mask
    yield from settled("tools-lassoed")
    return facts


def selecting(model):
    """Each tool that selects, in a view from the side: by what is seen and through, with Shift and Ctrl; one step of undo; the colours of
    the selection in every shading; then P makes a part, which moves aside."""
    scene = bring(model)
    look(scene, 640, 420)
    area = area_of()
    space = area.spaces.active
    view = space.region_3d
    view.view_rotation, view.view_location, view.view_distance = Euler((1.1, 0, 0.3)).to_quaternion(), (0, 0, 0.6), 6.0
    scene.frame_set(12)
    yield from settled("select-before")
    with within(area):
        bpy.ops.ed.undo_push(message="Imported")
    bpy.context.view_layer.objects.active = splat()
    region = next(region for region in area.regions if region.type == 'WINDOW')
    middle = region.x + region.width / 2, region.y + region.height / 2
    at = lambda *places: [(middle[0] + dx, middle[1] + dy) for dx, dy in places]  # noqa: E731
    facts = {"frame": scene.frame_current - splat().fastgs.start_frame, **seen_by(area), "selections": {},
             "box": [(int(x) - region.x, int(y) - region.y) for x, y in at((-120, -80), (10, 90))]}

    def keep(name):
        facts["selections"][name] = splat().fastgs.selection

    yield from choose("fastgs.select_box", area)
    yield from drag(at((-120, -80), (10, 90)))
    keep("seen")
    scene.fastgs.select_through = True
    yield from drag(at((-120, -80), (10, 90)))
    keep("box")
    yield from settled("select-solid")
    yield from choose("fastgs.select_lasso", area)
    yield from drag(at((20, -60), (120, -80), (90, 60), (30, 20)), shift=True)
    keep("added")
    yield from choose("fastgs.select_brush", area)
    yield from drag(at((-100, 0), (-60, 10), (-20, 0)), ctrl=True)
    keep("taken")
    facts["refused"] = splat().fastgs.refused
    for name, shading, engine in (("wireframe", 'WIREFRAME', 'FASTGS'), ("material", 'MATERIAL', 'FASTGS'),
                                  ("workbench", 'RENDERED', 'BLENDER_WORKBENCH'), ("rendered", 'RENDERED', 'FASTGS')):
        scene.render.engine, space.shading.type = engine, shading
        yield from settled(f"select-{name}")
    space.overlay.show_overlays = False
    yield from settled("select-without-overlays")
    space.overlay.show_overlays, space.shading.type = True, 'SOLID'
    with within(area):
        bpy.ops.ed.undo()
    keep("undone")
    yield from choose("fastgs.select_ball", area)
    yield from drag(at((-60, 0), (-30, 0)))
    keep("ball")
    yield from settled("select-ball")
    yield from press('P', area)
    part = bpy.context.view_layer.objects.active
    facts["part"] = [part.name, part.fastgs.part, part.parent.name if part.parent else ""]
    part.location.z += 1.0
    yield from sidebar(area)
    yield from settled("select-parted")
    return facts


def camera_here(model):
    """New Camera from View: the view before it, by Blender's own matrices, and the camera that was made."""
    scene = bring(model)
    scene.render.resolution_x, scene.render.resolution_y = 1200, 600
    area = area_of()
    view = area.spaces.active.region_3d
    view.view_rotation, view.view_location, view.view_distance = Euler((1.1, 0, 0.3)).to_quaternion(), (0.3, 0.1, 0.6), 6.0
    yield from settled("camera-before")
    facts = seen_by(area)
    with within(area):
        bpy.ops.fastgs.camera_from_view()
    yield from settled("camera-here")
    graph, camera = bpy.context.evaluated_depsgraph_get(), scene.camera
    picture = camera.evaluated_get(graph).calc_matrix_camera(graph, x=1200, y=600)
    return {**facts, "camera": [list(row) for row in camera.matrix_world], "picture": [list(row) for row in picture],
            "through": view.view_perspective}


def recorded(draw, drawn, name):
    """A panel's function draw() that adds the panel's name to a set."""
    def draw_and_tell(self, context):
        drawn.add(name)
        draw(self, context)

    return draw_and_tell


def panels():
    """Every panel with the example, open, in Blender's startup file: screenshots, how wide the regions are that panels lie in, and which
    panels were drawn: Blender draws none that is closed."""
    classes = [cls for cls in import_module(f"{ADDON}.ui").CLASSES if issubclass(cls, bpy.types.Panel)]
    drawn = set()
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
    for cls in classes:  # before a window shows them: it remembers which are closed
        cls.bl_options = set(getattr(cls, "bl_options", ())) - {'DEFAULT_CLOSED'}
        cls.draw = recorded(cls.draw, drawn, cls.__name__)
        bpy.utils.register_class(cls)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    area, editor, scene = area_of(), area_of('PROPERTIES'), bpy.context.scene
    with within(area):
        bpy.ops.fastgs.import_example('EXEC_DEFAULT')
        bpy.ops.fastgs.add_crop_box()
        bpy.context.view_layer.objects.active = splat()
        bpy.ops.fastgs.add_filter(preset='COLOUR')
    splat().fastgs.echoes, splat().fastgs.after, scene.fastgs.training.source = 3, 'LOOP', 'SCENE'
    scene.use_nodes, scene.fastgs.use_meshes, scene.fastgs.show_splats = False, True, False
    scene.camera.data.background_images.new()
    splat().display_type = 'BOUNDS'  # which is drawn at once
    yield from sidebar(area)
    widths = {"UI": next(region.width for region in area.regions if region.type == 'UI'),
              "WINDOW": next(region.width for region in editor.regions if region.type == 'WINDOW')}
    for context, engine in (('RENDER', 'FASTGS'), ('VIEW_LAYER', 'FASTGS'), ('OBJECT', 'FASTGS'), ('RENDER', 'BLENDER_WORKBENCH')):
        scene.render.engine, editor.spaces.active.context = engine, context
        yield from settled(f"panels-{context.lower()}-{engine.lower()}")
    return {"widths": widths, "drawn": sorted(drawn), "panels": [cls.__name__ for cls in classes]}
