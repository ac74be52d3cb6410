# SPDX-License-Identifier: GPL-3.0-or-later
"""The shaders' text.  Its equations are those of rendering/oracle.py, which the comments name; its textures are laid out by
model_texels.py and the modules of tables (..._table.py), and all constants are filled in from there and from the library.

Written to be translated to Vulkan and Metal too: no integer textures, no arrays of samplers, no mixing of int and float.
"""
from .covering import FRAGMENT as COVERING_FRAGMENT
from .resolve import FRAGMENT as RESOLVE_FRAGMENT
from .resolve import SHOW as SHOW_FRAGMENT
from .resolve import VERTEX as RESOLVE_VERTEX
from .splat import FRAGMENT as SPLAT_FRAGMENT
from .splat import VERTEX as SPLAT_VERTEX

__all__ = ["COVERING_FRAGMENT", "RESOLVE_FRAGMENT", "RESOLVE_VERTEX", "SHOW_FRAGMENT", "SPLAT_FRAGMENT", "SPLAT_VERTEX"]
