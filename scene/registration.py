# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds what modules define for Blender to register."""
from types import ModuleType


def classes_of(*modules: ModuleType) -> tuple[type, ...]:
    """The classes FASTGS_... that modules define, in the order in which they stand there."""
    return tuple(cls for module in modules for name, cls in vars(module).items()
                 if name.startswith("FASTGS_") and cls.__module__ == module.__name__)
