# SPDX-License-Identifier: GPL-3.0-or-later
"""Assembles the text of a shader: wgsl/<stage>.wgsl with the files that it includes, and with its constants filled in.

A line `//include NAME` is replaced by wgsl/NAME.wgsl, or, for a device with subgroups, by wgsl/NAME_subgroups.wgsl where there is one.
{NAME} is replaced by a constant, from the caller's or from CONSTANTS, so that each number is written in one place only.
"""
from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np

from ...model.appearance import SH_C0, SH_C1, SH_C2, SH_C3, SH_C4
from ...rendering.colour import SRGB_CUT, SRGB_GAMMA, SRGB_LINEAR_CUT, SRGB_OFFSET, SRGB_SLOPE
from ...rendering.crops import SPHERE, VOLUME
from ...rendering.distance import MARGIN, STEEP
from ...rendering.holdout import EDGE, SAMPLES
from ...rendering.instances import LIMIT
from ...rendering.layout import CORE, DEPTH_FROM, REST
from ...rendering.looks import Look
from ...rendering.oracle import REACH, T_STOP

FOLDER = Path(__file__).parent / "wgsl"
TILE = 16
FARTHEST = 3e38
"""Stands for infinity, which shaders need not know."""

CONSTANTS = {
    "TILE": TILE, "LIMIT": LIMIT, "T_STOP": T_STOP, "REACH": REACH, "SPHERE": SPHERE, "VOLUME": VOLUME,
    "SAMPLES": SAMPLES, "EDGE": EDGE, "FARTHEST": FARTHEST, "MARGIN": MARGIN, "STEEP": STEEP,
    "MEDIAN_FROM": DEPTH_FROM["median"], "FIRST_FROM": DEPTH_FROM["first"], "CORE_FROM": CORE[0], "CORE_TO": CORE[1], "REST": REST,
    "SH_C0": SH_C0, "SH_C1": SH_C1, **{f"SH_C{degree}_{i}": value for degree, values in ((2, SH_C2), (3, SH_C3), (4, SH_C4))
                                       for i, value in enumerate(values)},
    "SRGB_CUT": SRGB_CUT, "SRGB_GAMMA": SRGB_GAMMA, "SRGB_LINEAR_CUT": SRGB_LINEAR_CUT, "SRGB_OFFSET": SRGB_OFFSET,
    "SRGB_SLOPE": SRGB_SLOPE, **{f"LOOK_{place.name}": int(place) for place in Look},
}


@cache
def source(stage: str, subgroups: bool = False, **constants) -> str:
    """The shader of a stage."""
    values = CONSTANTS | constants
    text = re.sub(r"(?m)^//include (\w+)$", lambda found: _text(_version(found[1], subgroups)), _text(stage))
    return re.sub(r"\{([A-Z][A-Z0-9_]*)\}", lambda found: _literal(values[found[1]]), text)


def _version(name: str, subgroups: bool) -> str:
    other = f"{name}_subgroups"
    return other if subgroups and (FOLDER / f"{other}.wgsl").is_file() else name


@cache
def _text(name: str) -> str:
    return (FOLDER / f"{name}.wgsl").read_text("utf-8")


def _literal(value) -> str:
    """A number as WGSL writes it: of float32 the nearest, whole ones as they are."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    return str(value) if isinstance(value, int) else f"{np.float32(value):.9e}"
