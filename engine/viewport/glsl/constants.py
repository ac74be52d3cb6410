# SPDX-License-Identifier: GPL-3.0-or-later
"""The constants that shaders share with Python, as #define lines."""
from __future__ import annotations

from enum import IntEnum

from ....fastgs_blender.model import appearance, temporal
from ....fastgs_blender.rendering import colour
from ....fastgs_blender.rendering.distance import MARGIN, STEEP
from ....fastgs_blender.rendering.oracle import REACH
from .. import frame_table, model_texels, textures
from ..covering_table import MARKS, CoveringTexel
from ..resolve_table import HIDDEN, ResolveTexel

FARTHEST = 6e4
"""Depth at which that of splats is cut off: half floats hold it."""


def defines(**values: float) -> str:
    """One #define for each value, in brackets, so that signs bind to their numbers."""
    return "".join(f"#define {name} ({value!r})\n" for name, value in values.items())


def texels(prefix: str, names: type[IntEnum]) -> dict[str, int]:
    """Places in a row of a table, by names such as VIEW_SIZE."""
    return {f"{prefix}_{name}": int(place) for name, place in names.__members__.items()}


VIEW = defines(**texels("VIEW", frame_table.ViewTexel))
INSTANCES = defines(
    REACH=REACH, FARTHEST=FARTHEST, MARGIN=MARGIN, STEEP=STEEP, WIDTH=textures.WIDTH, ORDER_WIDTH=textures.ORDER_WIDTH,
    INSTANCE_TEXELS=frame_table.HEAD,
    **texels("INSTANCE", frame_table.InstanceTexel),
    BASIS_WEIGHTS=frame_table.WEIGHTS, BASIS_POWERS=frame_table.POWERS, COLOURS_HARMONICS=model_texels.HARMONICS,
    **{f"TEMPORAL_{name.upper()}".replace("-", "_"): kind.code for name, kind in temporal.KINDS.items()})
HARMONICS = defines(
    SH_C0=appearance.SH_C0, SH_C1=appearance.SH_C1,
    **{f"SH_C{degree}_{number}": value for degree, values in ((2, appearance.SH_C2), (3, appearance.SH_C3), (4, appearance.SH_C4))
       for number, value in enumerate(values)})
COVERING = defines(**texels("COVERING", CoveringTexel), COVERING_MARKS=MARKS)
GRADE = defines(
    SRGB_CUT=colour.SRGB_CUT, SRGB_LINEAR_CUT=colour.SRGB_LINEAR_CUT, SRGB_SLOPE=colour.SRGB_SLOPE, SRGB_OFFSET=colour.SRGB_OFFSET,
    SRGB_GAMMA=colour.SRGB_GAMMA)
RESOLVE = defines(
    **texels("RESOLVE", ResolveTexel), DECODER_HIDDEN=HIDDEN,
    **{f"ACTIVATION_{name.upper()}": code for code, name in enumerate(appearance.ACTIVATIONS)},
    **{f"DECODE_{name.upper()}": code for code, name in enumerate(appearance.DECODES)})
