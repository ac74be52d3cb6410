# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators: thin modules, one a menu entry, over what scene/ and engine/ do.  All modules of this folder are registered."""
from importlib import import_module
from pkgutil import iter_modules

import bpy

from ..scene.registration import classes_of

CLASSES = classes_of(*(import_module(f".{module.name}", __package__) for module in iter_modules(__path__)))
register, unregister = bpy.utils.register_classes_factory(CLASSES)
