# SPDX-License-Identifier: GPL-3.0-or-later
"""A layout that records what a panel draws: Blender gives out none in background.  It refuses what Blender would refuse.

It also measures, with Blender's own font, how wide a panel must be so that no text is cut (panel_widths.py says how wide panels are).
"""
from types import SimpleNamespace

import blf
import bpy

ICONS = set(bpy.types.UILayout.bl_rna.functions["prop"].parameters["icon"].enum_items.keys())
UNIT, PADDING, NUMBER, NAME = 20, 10, 55, 60
"""Pixels of an icon or an arrow, of the space beside a text, of a number and of a name or path, which may be cut."""
LABELS = 0.4
"""Share of the width that labels have beside their properties."""


def text_width(text: str) -> float:
    """Pixels of a text in Blender's interface."""
    blf.size(0, bpy.context.preferences.ui_styles[0].widget.points)
    return blf.dimensions(0, text)[0]


class Layout:
    """Records (kind, text, alert) of everything drawn; containers share one record, and what is `pressable`: {operator: enabled}."""

    def __init__(self, above=None, kind="column", factor=LABELS):
        self.record, self.pressable = ([], {}) if above is None else (above.record, above.pressable)
        self.alert, self.active, self.enabled = False, True, True
        self.use_property_split, self.use_property_decorate = False, True
        if above is not None:
            self.alert, self.enabled = above.alert, above.enabled
            self.use_property_split, self.use_property_decorate = above.use_property_split, above.use_property_decorate
        self.alignment = 'EXPAND'
        self.kind, self.factor, self.items = kind, factor, []

    def _inside(self, kind, options):
        assert set(options) <= {"align", "factor", "heading"}
        inside = Layout(self, kind, options.get("factor", LABELS))
        self.items.append(inside)
        return inside

    def row(self, **options):
        return self._inside("row", options)

    def column(self, **options):
        return self._inside("column", options)

    def box(self, **options):
        return self._inside("box", options)

    def split(self, **options):
        return self._inside("split", options)

    def needs(self) -> float:
        """How wide the layout must be."""
        needs = [item.needs() for item in self.items] or [0]
        if self.kind == "row":
            return sum(needs)
        if self.kind == "split":
            return max(needs[0] / self.factor, sum(needs[1:]) / (1 - self.factor))
        return max(needs) + (PADDING if self.kind == "box" else 0)

    def cut(self, width: float) -> list[str]:
        """What is cut in a region of that width, each as the texts that stand in a line."""
        if self.needs() <= width:
            return []
        if self.kind in ("column", "box"):
            return [text for item in self.items for text in item.cut(width - (PADDING if self.kind == "box" else 0))]
        return [" | ".join(text for item in self.items for text in item.cut(0))]

    def _note(self, kind, text, icon, need=0.0, shown=""):
        assert icon in ICONS, icon
        self.record.append((kind, text, self.alert))
        need += UNIT if icon != 'NONE' else 0
        self.items.append(SimpleNamespace(needs=lambda: need, cut=lambda width: [shown or text] if need > width else []))

    def label(self, text="", icon='NONE', translate=True):
        self._note("label", text, icon, text_width(text) + (PADDING / 2 if text else 0))

    def prop(self, data, name, text=None, icon='NONE', icon_only=False, expand=False, toggle=False):
        assert name in data.bl_rna.properties, name
        known = data.bl_rna.properties[name]
        label = known.name if text is None else text
        beside = self.use_property_split and bool(label)
        if known.type == 'ENUM':
            words = [text_width(item.name) for item in known.enum_items] or [NAME]
            field = len(words) * (max(words) + PADDING) if expand else 2 * UNIT if icon_only else max(words) + UNIT + PADDING
            label = "" if expand else label
        else:
            field = {'BOOLEAN': UNIT, 'INT': NUMBER, 'FLOAT': NUMBER}.get(known.type, NAME)
        if beside and known.type == 'BOOLEAN':
            need = (field + text_width(label) + self.use_property_decorate * UNIT) / (1 - LABELS)
        elif beside:
            need = max((text_width(label) + PADDING / 2) / LABELS, (field + self.use_property_decorate * UNIT) / (1 - LABELS))
        else:
            need = field + (text_width(label) + PADDING if label else 0)
        self._note("prop", name, icon, need, label)

    def template_curve_mapping(self, data, name):
        assert name in data.bl_rna.properties, name
        self._note("curve", name, 'NONE')

    def separator(self):
        """Space that says nothing."""

    def progress(self, factor=0.0, text=""):
        assert 0 <= factor <= 1
        self._note("progress", text, 'NONE', text_width(text) + PADDING)

    def menu(self, name, text=None, icon='NONE'):
        label = getattr(bpy.types, name).bl_label if text is None else text
        self._note("menu", name, icon, text_width(label) + PADDING + UNIT, label)

    def operator(self, name, text=None, icon='NONE'):
        module, function = name.split(".")
        assert function in dir(getattr(bpy.ops, module)), name
        self.pressable[name] = self.enabled
        label = getattr(getattr(bpy.ops, module), function).get_rna_type().name if text is None else text
        self._note("operator", name, icon, text_width(label) + PADDING if label else 0, label)
        return SimpleNamespace()

    def prop_menu_enum(self, data, name, text=None, icon='NONE'):
        assert name in data.bl_rna.properties, name
        label = data.bl_rna.properties[name].name if text is None else text
        self._note("prop_menu_enum", name, icon, text_width(label) + PADDING + UNIT, label)

    def operator_menu_enum(self, name, prop, text=None, icon='NONE'):
        module, function = name.split(".")
        kind = getattr(getattr(bpy.ops, module), function).get_rna_type()
        assert prop in kind.properties, (name, prop)
        label = kind.name if text is None else text
        self._note("operator", name, icon, text_width(label) + PADDING + UNIT, label)
