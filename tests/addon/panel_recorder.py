# SPDX-License-Identifier: GPL-3.0-or-later
"""A layout that records what a panel draws: Blender gives out none in background.  It refuses what Blender would refuse."""
from types import SimpleNamespace

import bpy

ICONS = set(bpy.types.UILayout.bl_rna.functions["prop"].parameters["icon"].enum_items.keys())


class Layout:
    """Records (kind, text, alert) of everything drawn; containers share one record."""

    def __init__(self, record=None, alert=False):
        self.record = [] if record is None else record
        self.alert = alert
        self.use_property_split = self.use_property_decorate = True
        self.alignment = 'EXPAND'

    def _inside(self, **options):
        assert set(options) <= {"align", "factor", "heading"}
        return Layout(self.record, self.alert)

    row = column = box = split = _inside

    def _note(self, kind, text, icon):
        assert icon in ICONS, icon
        self.record.append((kind, text, self.alert))

    def label(self, text="", icon='NONE'):
        self._note("label", text, icon)

    def prop(self, data, name, text=None, icon='NONE', icon_only=False):
        assert name in data.bl_rna.properties, name
        self._note("prop", name, icon)

    def template_curve_mapping(self, data, name):
        assert name in data.bl_rna.properties, name
        self._note("curve", name, 'NONE')

    def separator(self):
        """Space that says nothing."""

    def operator(self, name, text="", icon='NONE'):
        module, function = name.split(".")
        assert function in dir(getattr(bpy.ops, module)), name
        self._note("operator", name, icon)
        return SimpleNamespace()

    def operator_menu_enum(self, name, prop, icon='NONE'):
        module, function = name.split(".")
        assert prop in getattr(getattr(bpy.ops, module), function).get_rna_type().properties, (name, prop)
        self._note("operator", name, icon)
