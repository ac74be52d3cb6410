# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists the operators that Blender's Object menu offers for the selected objects: its Python draws into a layout that records them."""
from __future__ import annotations

from types import SimpleNamespace

import bpy

WHOLE = {"OBJECT_MT_modifier_add": "Add Modifier", "OBJECT_MT_move_to_collection": "Move to Collection",
         "OBJECT_MT_link_to_collection": "Link to Collection"}
"""Menus that stand as one entry: they are drawn in C, or list what there is."""


def entries() -> dict[str, str]:
    """Operators by what a user reads, such as {"Transform > Shear": "transform.shear"}; add-ons' own are left out."""
    found: dict[str, str] = {}
    _draw(bpy.types.VIEW3D_MT_object, "", found)
    return found


def _draw(menu, path, found):
    draw = getattr(menu.draw, "_draw_funcs", [menu.draw])[0]
    draw(SimpleNamespace(layout=_Layout(path, found)), bpy.context)


class _Layout:
    """Writes down operators, and goes down into menus."""

    operator_context = 'INVOKE_DEFAULT'

    def __init__(self, path, found):
        self.path, self.found = path.replace("...", ""), found

    def _note(self, text, operator):
        self.found[self.path + text.strip(" .")] = operator

    def operator(self, name, text="", **_):
        self._note(text or _type(name).name, name)
        return SimpleNamespace(constraint_axis=[False] * 3)

    def operator_enum(self, name, prop):
        for item in _type(name).properties[prop].enum_items:
            self._note(item.name, name)

    def operator_menu_enum(self, name, prop="", text="", **options):
        below = _Layout(f"{self.path}{text or _type(name).name} > ", self.found)
        if len(_type(name).properties[options.get("property", prop)].enum_items):
            below.operator_enum(name, options.get("property", prop))
        else:  # a list of what there is
            self._note(text or _type(name).name, name)

    def menu(self, name, text="", **_):
        if name in WHOLE:
            self._note(text or WHOLE[name], name)
            return
        kind = getattr(bpy.types, name)
        _draw(kind, f"{self.path}{text or kind.bl_label} > ", self.found)

    def column(self, **_):
        """Entries that are shown or grey together."""
        return self

    def separator(self, **_):
        """A line."""

    def template_node_operator_asset_menu_items(self, **_):
        """Operators that users made of nodes."""


def _type(name):
    module, function = name.split(".")
    return getattr(getattr(bpy.ops, module), function).get_rna_type()
