# SPDX-License-Identifier: GPL-3.0-or-later
"""A story of exporting a web page in Blender's window (see inside.py and window.py): the menu, the dialog, what is said at the end."""
from __future__ import annotations

import os

import bpy
from background import bring, look
from on_gpu import part
from window import area_of, press, settled, turns, until, within

NAME = "knot.html"


def from_menu_to_report(model):
    """A scene with much that a page does not show; File > Export, the dialog as it opens and with a colour, and the end, with a warning."""
    scene = bring(model)
    look(scene, 640, 420)
    scene.view_settings.view_transform, scene.render.use_motion_blur = 'AgX', True
    scene.camera.data.dof.use_dof = True
    mesh = bpy.data.objects.new("Table", bpy.data.meshes.new("Table"))
    mesh.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    scene.collection.objects.link(mesh)
    scene.frame_end = 6
    bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'
    part("fastgs_blender.formats.web").LARGE = 0.3  # MB beyond which a page is large
    for module, name, value in (("sensitivity", "WIDTH", 64), ("rate", "SHOTS", 8), ("rate", "JUDGED", 3), ("rate", "SHOWN", 64)):
        setattr(part(f"fastgs_blender.formats.{module}"), name, value)  # compression looks at little
    yield from turns()
    area = area_of()
    with within(area):
        bpy.ops.wm.call_menu(name="TOPBAR_MT_file_export")
    yield from settled("page-menu")
    yield from press('ESC', area)
    with within(area):
        bpy.ops.fastgs.export_page('INVOKE_DEFAULT', filepath=os.path.abspath(NAME), title="A knot")
    yield from turns(10)
    browser = area_of('FILE_BROWSER')
    browser.spaces.active.params.display_type = 'LIST_VERTICAL'
    yield from settled("page-dialog")
    asked = browser.spaces.active.active_operator
    facts = {"frames": [asked.frame_start, asked.frame_end]}
    asked.background = 'COLOUR'
    asked.colour = (0.1, 0.2, 0.4)
    for region in browser.regions:
        region.tag_redraw()
    yield from settled("page-dialog-colour")
    yield from press('RET', browser)
    facts["written"] = yield from until(lambda: os.path.exists(NAME))
    yield from settled("page-exported")
    return facts
