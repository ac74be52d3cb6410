# SPDX-License-Identifier: GPL-3.0-or-later
"""GLSL that draws splats, for Blender's viewports (engine/viewport/) and for web pages (formats/web/): one text, which each gives its head.

Its equations are those of rendering/oracle.py, which the comments name; its textures are laid out by model_texels.py and the modules of
tables (..._table.py), and all constants are filled in from there and from the library.

Written to be translated to Vulkan and Metal, and as GLSL ES 3.00: no integer textures, no arrays of samplers, no mixing of int and float.
"""
from .resolve import FRAGMENT as RESOLVE_FRAGMENT
from .resolve import SHOW as SHOW_FRAGMENT
from .resolve import VERTEX as RESOLVE_VERTEX
from .splat import FRAGMENT as SPLAT_FRAGMENT
from .splat import VERTEX as SPLAT_VERTEX

__all__ = ["RESOLVE_FRAGMENT", "RESOLVE_VERTEX", "SHOW_FRAGMENT", "SPLAT_FRAGMENT", "SPLAT_VERTEX"]
