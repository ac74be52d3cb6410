# SPDX-License-Identifier: GPL-3.0-or-later
"""What operators have in common: when they can be called, how they report, and how they take what nobody has set from the scene."""
from collections.abc import Callable
from typing import NamedTuple

import bpy
from bpy.props import IntProperty

from ..fastgs_blender.util.errors import FastGSError, printable
from ..scene import objects
from ..scene.splats.splat_object import sentence


class Need(NamedTuple):
    """A condition under which an operator can be called, and what its button's tooltip says where it is not met."""

    met: Callable[[bpy.types.Context], bool]
    reason: str


OBJECT_MODE = Need(lambda context: context.mode == 'OBJECT', "Go to Object Mode first")
SPLATS = Need(lambda context: objects.is_splat(context.object), "Select an object that shows splats")
EDITABLE_SPLATS = Need(lambda context: objects.is_splat(context.object) and context.object.is_editable,
                       "Select an object that shows splats; a linked one can be changed once it is local, or an override")
VIEW_3D = Need(lambda context: context.space_data is not None and context.space_data.type == 'VIEW_3D', "A 3D view is needed")
IN_VIEW = Need(lambda context: VIEW_3D.met(context) and context.region_data is not None, VIEW_3D.reason)
"""With the mouse in it, from a script with its region."""


class Action:
    """Base class of operators.

    needs  what must be met, in the order in which it is told
    act()  does the work of an operator that is done at once; it returns what is reported, if anything
    """

    bl_options = {'REGISTER', 'UNDO'}
    needs: tuple[Need, ...] = ()

    @classmethod
    def poll(cls, context):
        unmet = next((need for need in cls.needs if not need.met(context)), None)
        if unmet is not None:
            cls.poll_message_set(unmet.reason)
        return unmet is None

    def act(self, context) -> str | None:
        """Do the work.  Raises FastGSError, which is reported."""
        raise NotImplementedError

    def execute(self, context):
        return self._ended(lambda: self.act(context))

    def _ended(self, work: Callable[[], str | None]) -> set[str]:
        """Do the work and report how it ended."""
        try:
            done = work()
        except FastGSError as error:
            return self.fail(error)
        if done:
            self.report({'INFO'}, printable(done))
        return {'FINISHED'}

    def fail(self, error: FastGSError | str) -> set[str]:
        """Report an error; returns what an operator returns then."""
        self.report({'ERROR'}, sentence(error))
        return {'CANCELLED'}

    def warn(self, text: FastGSError | str) -> None:
        """Report a warning."""
        self.report({'WARNING'}, sentence(text))

    def fill(self, **values) -> None:
        """Give the properties that nobody has set these values."""
        for name, value in values.items():
            if not self.properties.is_property_set(name):
                setattr(self, name, value)


def check_frames(operator) -> None:
    """Raise FastGSError where an operator's last frame comes before its first."""
    if operator.frame_end < operator.frame_start:
        raise FastGSError(f"the last frame, {operator.frame_end}, comes before the first, {operator.frame_start}; choose another range.")


def draw_options(operator, *names: str):
    """Draw properties of an import or export in its dialog; returns the layout."""
    layout = operator.layout
    layout.use_property_split, layout.use_property_decorate = True, False
    for name in names:
        layout.prop(operator, name)
    return layout


def draw_column(layout, owner, *names: str, active: bool = True, align: bool = False):
    """Draw properties of an owner in a column, which is returned; greyed out where it is not active."""
    col = layout.column(align=align)
    col.active = active
    for name in names:
        col.prop(owner, name)
    return col


def keep_text(context, name: str, content: str) -> str:
    """Keep a text in the .blend, in place of an earlier one of that name; text editors show it.  Returns its name."""
    text = bpy.data.texts.get(name) or bpy.data.texts.new(name)
    text.use_fake_user = False
    text.from_string(content)
    text.cursor_set(0)
    for area in context.screen.areas if context.screen else ():
        if area.type == 'TEXT_EDITOR':
            area.spaces.active.text, area.spaces.active.top = text, 0
    return text.name


class OnItem(Action):
    """An operator on one of the items of a list of the active object's.

    items  the list's name, "crops" or "filters"
    """

    items: str

    index: IntProperty(name="Index", description="Which item of the list", min=0)

    @classmethod
    def listed(cls, context):
        """The list."""
        return getattr(context.object.fastgs, cls.items)

    def item(self, context):
        """The item.  Raises FastGSError where there is none of that number."""
        items = self.listed(context)
        if self.index >= len(items):
            raise FastGSError(f"there is no number {self.index}; choose one of the {len(items)} in the list, counted from 0.")
        return items[self.index]


class Remove(OnItem):
    """Base class of operators that remove such an item."""

    def act(self, context):
        self.item(context)
        self.listed(context).remove(self.index)
        context.object.update_tag()


def listed(name: str) -> tuple[Need, ...]:
    """The needs of an operator on the items of a list, by its name."""
    return EDITABLE_SPLATS, Need(lambda context: len(getattr(context.object.fastgs, name)) > 0, f"The object has no {name}")
