# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the shared equations: with their constants filled in, as WGSL or as GLSL (also GLSL ES 3.0, which has the same functions).

The equations are WGSL of a kind that differs from GLSL in declarations and names of types only: conditions stand in brackets, each `let`
and `var` has its type, choices are made by `if`.  So a line of GLSL is the same line of WGSL, and errors of either compiler lead to it.
numbered() shows a shader as compilers count its lines.
"""
import re
from functools import cache
from pathlib import Path

import numpy as np

from ...model.appearance import ACTIVATIONS, APPEARANCES, DECODES, SH_C0, SH_C1, SH_C2, SH_C3, SH_C4
from ...model.temporal import KINDS
from ...rendering.colour import SRGB_CUT, SRGB_GAMMA, SRGB_LINEAR_CUT, SRGB_OFFSET, SRGB_SLOPE
from ...rendering.distance import BOX, MARGIN, STEEP
from ...rendering.oracle import REACH

FOLDER = Path(__file__).parent
BACKWARD = "//backward\n"
"""In a file that is included: what follows is for stages of the backward pass alone."""
CONSTANTS = {
    "REACH": REACH, "BOX": BOX, "MARGIN": MARGIN, "STEEP": STEEP,
    "SH_C0": SH_C0, "SH_C1": SH_C1, **{f"SH_C{degree}_{i}": value for degree, values in ((2, SH_C2), (3, SH_C3), (4, SH_C4))
                                       for i, value in enumerate(values)},
    "SRGB_CUT": SRGB_CUT, "SRGB_GAMMA": SRGB_GAMMA, "SRGB_LINEAR_CUT": SRGB_LINEAR_CUT, "SRGB_OFFSET": SRGB_OFFSET,
    "SRGB_SLOPE": SRGB_SLOPE,
    **{f"TEMPORAL_{name.upper()}".replace("-", "_"): kind.code for name, kind in KINDS.items()},
    **{f"APPEARANCE_{name.upper()}": appearance.code for name, appearance in APPEARANCES.items() if hasattr(appearance, "code")},
    **{f"ACTIVATION_{name.upper()}": code for code, name in enumerate(ACTIVATIONS)},
    **{f"DECODE_{name.upper()}": code for code, name in enumerate(DECODES)},
}
"""The numbers that the equations take from the library: each is written there alone."""
TYPES = {"f32": "float", "i32": "int", "u32": "uint"} | {
    f"vec{n}{wgsl}": f"{glsl}vec{n}" for n in (2, 3, 4) for wgsl, glsl in (("f", ""), ("i", "i"), ("u", "u"))} | {
    f"mat{n}x{n}f": f"mat{n}" for n in (2, 3, 4)}


@cache
def read(path: Path) -> str:
    """The text of a shader's file."""
    return path.read_text("utf-8")


def filled(text: str, values: dict) -> str:
    """A text with its {NAME}s filled in; raises KeyError for one that has no value."""
    return re.sub(r"\{([A-Z][A-Z0-9_]*)\}", lambda found: _literal(values[found[1]]), text)


def _literal(value: float) -> str:
    """A number as shaders write it: of float32 the nearest, whole ones as they are."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    return str(value) if isinstance(value, int) else f"{np.float32(value):.9e}"


@cache
def glsl(*names: str) -> str:
    """Equations of these names as GLSL, in this order, without their gradients."""
    return "\n".join(to_glsl(filled(read(FOLDER / f"{name}.wgsl").partition(BACKWARD)[0], CONSTANTS)) for name in names)


def to_glsl(text: str) -> str:
    """The GLSL of WGSL as the equations are written, line by line."""
    def function(found: re.Match[str]) -> str:
        given = re.sub(r"(\w+): (\w+)", r"\2 \1", found[2])
        return f"{found[3] or 'void'} {found[1]}({given}) {{"

    text = re.sub(r"//[ ]?(.*)", r"/* \1 */", text)
    text = re.sub(r"\bfn (\w+)\((.*)\)(?: -> (\w+))? \{", function, text)
    text = re.sub(r"\bvar<private> (\w+): array<(\w+), (\d+)>;", r"\2 \1[\3];", text)
    text = re.sub(r"\b(?:let|var) (\w+): (\w+)", r"\2 \1", text)
    text = re.sub(r"(?ms)^(struct \w+ \{.*?^\})", lambda found: re.sub(r"(\w+): (\w+),", r"\2 \1;", found[1]) + ";", text)
    return re.sub(r"\b\w+\b", lambda found: TYPES.get(found[0], found[0]), text)


def numbered(text: str) -> str:
    """A shader's text with the numbers of its lines, to read a compiler's message by."""
    return "".join(f"{number:4}  {line}\n" for number, line in enumerate(text.splitlines(), 1))
