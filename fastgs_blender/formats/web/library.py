# SPDX-License-Identifier: GPL-3.0-or-later
"""What the player takes from the library, so that nothing is written twice: the shaders' text, places in textures and tables, and the
numbers of the compressed file.  The player's modules import it as LIBRARY of "./library.js" and SHADERS of "./shaders.js".
"""
import json
from enum import IntEnum
from typing import Any

from ...kernels import gl
from ...kernels.equations.text import glsl
from ...kernels.gl import frame_table, model_texels, resolve_table
from ...model import motion
from ...model.appearance import ACTIVATIONS, APPEARANCES, DECODES, SH_C0, Features
from ...model.basis import MAX_TERMS
from ...model.gaussians import GaussianModel
from ...model.keyframes import LEAST_GAP
from ...model.surroundings import WITHIN
from ...model.temporal import KINDS
from ...rendering.distance import LENS, MARGIN
from ...rendering.instances import LIMIT
from ...rendering.looks import Look
from .. import columns, compressed, native, native_arrays, quantising, static

SCREEN = glsl("srgb") + """
/* scene-linear colour as screens take it: what save_image() writes */
void main()
{
  vec4 shown = texelFetch(t_shown, ivec2(v_uv * vec2(textureSize(t_shown, 0))), 0);
  out_colour = vec4(to_srgb(shown.r), to_srgb(shown.g), to_srgb(shown.b), shown.a);
}
"""
BASES = ("static", "fourier", "cosine", "polynomial", "keyframes")
TEMPORALS = ("always", "radial", "window", "radial-window")
LOOKS = ("rgb", "sh", "features", "changing")
"""What the player computes: in bases.js; in order.js, beside the shaders; in model.js and texels.js."""
MOST_GAUSSIANS, MOST_TEXELS = 1 << 24, 4096 * 4096
"""Of a page: as many as single precision counts, and as many texels as every graphics card with WebGL2 has room for."""

def modules() -> dict[str, str]:
    """The texts of the player's modules that are made of it, by their names."""
    shaders = {"SPLAT_VERTEX": gl.SPLAT_VERTEX, "SPLAT_FRAGMENT": gl.SPLAT_FRAGMENT, "RESOLVE_VERTEX": gl.RESOLVE_VERTEX,
               "RESOLVE_FRAGMENT": gl.RESOLVE_FRAGMENT, "SCREEN_FRAGMENT": SCREEN}
    return {"library.js": f"export const LIBRARY = {json.dumps(numbers())};\n",
            "shaders.js": f"export const SHADERS = {json.dumps(shaders)};\n"}


def numbers() -> dict[str, Any]:
    """Places, codes and limits, as JSON values, by the part of the player that needs them."""
    taken = {"columns": (columns, "DIRECT FIRST LAST MOST MOST_VALUES"),
             "quantising": (quantising, "ATTRIBUTES BOUNDS FINEST LARGEST LEAST_OPACITY LIVES SPREADS")}
    own: dict[str, Any] = {room: {name: getattr(module, name) for name in listed.split()} for room, (module, listed) in taken.items()}
    return own | {
        "files": {"VERSION": native.VERSION, "COMPRESSED": native.COMPRESSED, "SEGMENT": compressed.SEGMENT, "SMALL": static.SMALL,
                  "FEWEST_BYTES": static.FEWEST_BYTES},
        "kinds": {
            "LEAST_GAP": LEAST_GAP, "MAX_DEGREE": motion.MAX_DEGREE, "MAX_TERMS": MAX_TERMS, "SH_C0": SH_C0, "ACTIVATIONS": ACTIVATIONS,
            "DECODES": DECODES, "DECODER": {key: getattr(Features(), key).shape for key in native_arrays.DECODER},
            "APPEARANCES": {name: getattr(appearance, "code", -1) for name, appearance in APPEARANCES.items()},
            "TEMPORAL": {name: {"code": kind.code, "logarithms": kind.logarithms} for name, kind in KINDS.items()}},
        "order": {"MARGIN": MARGIN, "LOOK": _places(Look),
                  "TEMPORAL": {name: kind.code for name, kind in KINDS.items()}},
        "view": {"LENS": LENS, "LIMIT": LIMIT, "WITHIN": WITHIN},
        "tables": {
            "VIEW": _places(frame_table.ViewTexel), "INSTANCE": _places(frame_table.InstanceTexel), "HEAD": frame_table.HEAD,
            "NONE": frame_table.NONE, "WEIGHTS": frame_table.WEIGHTS, "POWERS": frame_table.POWERS, "NOTHING": frame_table.NOTHING,
            "RESOLVE": _places(resolve_table.ResolveTexel), "RESOLVE_TEXELS": resolve_table.TEXELS, "LOOK_GRADED": int(Look.GRADED)},
        "textures": {"WIDTH": model_texels.WIDTH, "ORDER_WIDTH": frame_table.ORDER_WIDTH},
    }


def _places(names: type[IntEnum]) -> dict[str, int]:
    return {name: int(place) for name, place in names.__members__.items()}


def cannot_play(model: GaussianModel) -> str | None:
    """Why a page could not play a model, as a sentence; None where it can."""
    layout = model_texels.layout_of(model)
    bases = (model.basis, model.rotation_basis, model_texels.changes_of(model))
    for what, names, known in (("a basis of time", [basis.name for basis in bases], BASES),
                               ("a temporal opacity", [model.temporal_kind.name], TEMPORALS),
                               ("an appearance", [model.appearance.name], LOOKS)):
        unknown = next((name for name in names if name not in known), None)
        if unknown is not None:
            return f"a web page cannot play {what} of the kind {unknown!r}; it plays {', '.join(known)}."
    most = min(MOST_GAUSSIANS, MOST_TEXELS // max(layout.geometry, layout.colour))
    if len(model) > most:
        return f"a web page plays at most {most} Gaussians of this kind, not {len(model)}; thin the model out, or cut a part of it."
    return None
