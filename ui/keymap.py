# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's shortcuts in the 3D view."""
import bpy

_items = []


def register():
    keys = bpy.context.window_manager.keyconfigs.addon
    if keys is None:  # in background there are no shortcuts
        return
    keymap = keys.keymaps.new("Object Mode")
    for button in ('LEFTMOUSE', 'RIGHTMOUSE'):  # the operator knows which of them selects
        for shift in (False, True):
            item = keymap.keymap_items.new("fastgs.select", button, 'CLICK', shift=shift)
            item.properties.toggle = shift
            _items.append((keymap, item))
    keymap = keys.keymaps.new("3D View", space_type='VIEW_3D')
    _items.append((keymap, keymap.keymap_items.new("fastgs.key_from_view", 'K', 'PRESS', ctrl=True, alt=True)))


def unregister():
    for keymap, item in _items:
        keymap.keymap_items.remove(item)
    _items.clear()
