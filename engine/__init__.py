# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine: final frames, passes and what viewports draw."""
from . import compiling, handlers, panels, render_engine, viewport

_MODULES = (render_engine, panels, handlers, viewport)


def register():
    for module in _MODULES:
        module.register()


def unregister():
    for module in reversed(_MODULES):
        module.unregister()
    compiling.stop()
