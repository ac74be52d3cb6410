# SPDX-License-Identifier: GPL-3.0-or-later
"""The constants that shaders share with Python, as #define lines."""
from enum import IntEnum

from ..equations.text import CONSTANTS
from . import frame_table, model_texels
from .resolve_table import HIDDEN, ResolveTexel

FARTHEST = 6e4
"""Depth at which that of splats is cut off: half floats hold it."""


def defines(**values: float) -> str:
    """One #define for each value, in brackets, so that signs bind to their numbers."""
    return "".join(f"#define {name} ({value!r})\n" for name, value in values.items())


def texels(prefix: str, names: type[IntEnum]) -> dict[str, int]:
    """Places in a row of a table, by names such as VIEW_SIZE."""
    return {f"{prefix}_{name}": int(place) for name, place in names.__members__.items()}


VIEW = defines(**texels("VIEW", frame_table.ViewTexel))
INSTANCES = f"#ifndef WIDTH\n{defines(WIDTH=model_texels.WIDTH)}#endif\n" + defines(
    FARTHEST=FARTHEST, ORDER_WIDTH=frame_table.ORDER_WIDTH,
    INSTANCE_TEXELS=frame_table.HEAD,
    **texels("INSTANCE", frame_table.InstanceTexel),
    BASIS_WEIGHTS=frame_table.WEIGHTS, BASIS_POWERS=frame_table.POWERS, COLOURS_HARMONICS=CONSTANTS["APPEARANCE_SH"])
RESOLVE = defines(**texels("RESOLVE", ResolveTexel), DECODER_HIDDEN=HIDDEN, DECODE_PREMULTIPLIED=CONSTANTS["DECODE_PREMULTIPLIED"])
