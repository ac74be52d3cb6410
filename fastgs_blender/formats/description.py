# SPDX-License-Identifier: GPL-3.0-or-later
"""describe() gives a model's kinds and constants as JSON values; understand() reads them back and checks each.

The native file holds it whole, PLY files in comments and .splatv in its JSON, so that these read back exactly too.
"""
import json
import math
from dataclasses import MISSING, asdict, fields
from typing import Any

import numpy as np

from ..model.appearance import APPEARANCES, RGB, SH, Appearance, Changing
from ..model.gaussians import AXES, Clip, GaussianModel, Raster
from ..model.motion import BASES, Basis, Polynomial, Static, basis_from_dict, basis_to_dict
from ..model.surroundings import Backdrop, Surroundings, Viewpoint
from ..model.temporal import Always, Radial, temporal_by_name
from ..util.arguments import like, one_of, shown
from ..util.errors import FastGSError

MAX_PROVENANCE = 1 << 16
"""Characters of JSON; foreign formats do without a longer one."""
KINDS = ("basis", "rotation_basis", "temporal_kind", "appearance", "raster", "clip", "axes", "colour_space", "provenance", "surroundings")
"""What understand() gives, by the names that GaussianModel has for it."""


def describe(model: GaussianModel) -> dict:
    """The model's kinds and constants as JSON values; a decoder's weights are arrays and not among them."""
    around = {key: value for key, value in asdict(model.surroundings).items() if value}  # only what is known
    return {
        "basis": basis_to_dict(model.basis), "rotation_basis": basis_to_dict(model.rotation_basis),
        "temporal": model.temporal_kind.name, "appearance": _described(model.appearance), "raster": asdict(model.raster),
        "clip": asdict(model.clip), "axes": model.axes, "colour_space": model.colour_space,
        "provenance": {str(k): str(v) for k, v in model.provenance.items()},
    } | ({"surroundings": around} if around else {})


def understand(values: dict) -> dict:
    """The inverse of describe(): keyword arguments for GaussianModel, for those keys that `values` has.

    An appearance with a decoder comes back as Features with no weights yet.  Unknown keys are ignored.
    Raises FastGSError for anything that is not what it should be.
    """
    if not isinstance(values, dict):
        raise FastGSError("the description of the model is no table of names and values.")
    readers = {
        "basis": ("basis", _basis), "rotation_basis": ("rotation_basis", _basis),
        "temporal": ("temporal_kind", lambda v: temporal_by_name(_typed(v, "", "the kind of temporal opacity"))),
        "appearance": ("appearance", _appearance),
        "raster": ("raster", lambda v: _from_fields(Raster, v, "rasteriser constant")),
        "clip": ("clip", lambda v: _from_fields(Clip, v, "clip's")),
        "axes": ("axes", lambda v: one_of(v, "its axes", AXES)),
        "colour_space": ("colour_space", lambda v: one_of(v, "its colour space", ("srgb", "linear"))),
        "provenance": ("provenance", _provenance),
        "surroundings": ("surroundings", _surroundings),
    }
    return {name: read(values[key]) for key, (name, read) in readers.items() if key in values}


def without_gaussians(kinds: dict) -> GaussianModel:
    """A model of no Gaussians, of the kinds that understand() gave."""
    width = kinds["appearance"].width if "appearance" in kinds else 3
    return GaussianModel(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, width)), **kinds)


def is_json_table(head: bytes) -> bool:
    """Whether a file begins as JSON of a table does, after a mark of UTF-8 as Windows' programs write it."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"{"


def read_json(text: str | bytes) -> Any:
    """Decoded JSON; raises FastGSError for anything else."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FastGSError("the JSON in its header is damaged; copy or export the file again.") from error


def read_table(text: str | bytes) -> dict:
    """Decoded JSON of a table; raises FastGSError for anything else."""
    table = read_json(text)
    if not isinstance(table, dict):
        raise FastGSError("the JSON in its header is no table; the file is damaged, so copy or export it again.")
    return table


def comments(model: GaussianModel, keys: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Lines for a PLY header that describe the model, and what could not be written (clauses)."""
    values, lost = describe(model), []
    if "provenance" in keys and len(json.dumps(values["provenance"])) > MAX_PROVENANCE:
        keys = tuple(k for k in keys if k != "provenance")
        lost = ["its long provenance is left out"]
    return [f"fastgs {key} {json.dumps(values[key], allow_nan=False)}" for key in keys if key in values], lost


def from_comments(lines: tuple[str, ...], keys: tuple[str, ...]) -> dict:
    """understand() of the lines that comments() wrote; other lines are ignored, whoever wrote them."""
    values = {}
    for line in lines:
        tag, key, text = [*line.split(" ", 2), "", ""][:3]
        if tag == "fastgs" and key in keys:
            values[key] = read_json(text)
    return understand(values)


def _typed(value: Any, example: object, what: str) -> Any:
    """The value, if it is of the example's type and within reason."""
    if (found := like(value, example)) is None:
        raise FastGSError(f"{what} cannot be {shown(value)}.")
    return found


def _from_fields(cls: type, values: object, what: str) -> Any:
    """A dataclass from a table of values of its fields' types; absent ones keep their default."""
    if not isinstance(values, dict):
        raise FastGSError(f"its {what} values are no table of names and values.")
    known = {f.name: f.default for f in fields(cls) if f.default is not MISSING}
    return cls(**{k: _typed(values[k], example, f"its {what} {k}") for k, example in known.items() if k in values})


def _basis(values: Any) -> Basis:
    name = values.get("name") if isinstance(values, dict) else None
    if not isinstance(name, str) or name not in BASES:
        raise FastGSError(f"the basis of time {shown(name)} is unknown; this version knows {', '.join(BASES)}.")
    examples = {f.name: f.default for f in fields(BASES[name])}
    return basis_from_dict({k: _typed(v, examples[k], f"the basis {name}'s {k}") if k in examples else v for k, v in values.items()})


def _described(appearance: Appearance) -> dict:
    usual = {key: getattr(type(appearance), key) for key in appearance.optional}
    recorded = {key: getattr(appearance, key) for key in appearance.recorded}
    values = {"name": appearance.name} | {key: value for key, value in recorded.items() if value != usual.get(key)}
    if isinstance(appearance, Changing):
        values |= {"look": _described(appearance.look), "basis": basis_to_dict(appearance.basis)}
    return values


def _appearance(values: Any) -> Appearance:
    name = values.get("name") if isinstance(values, dict) else None
    if not isinstance(name, str) or name not in APPEARANCES:
        raise FastGSError(f"the appearance {shown(name)} is unknown; this version knows {', '.join(APPEARANCES)}.")
    kind = APPEARANCES[name]
    if kind is Changing:
        given = values.get("look")
        appearance = _appearance(given) if isinstance(given, dict) and given.get("name") != Changing.name else None
        if not isinstance(appearance, (RGB, SH)):
            raise FastGSError("colours that change in time are of nothing known; the file is damaged.")
        return Changing(appearance, _basis(values.get("basis")))
    return kind(**{key: _typed(values.get(key), getattr(kind, key), f"the appearance {name}'s {key}") for key in kind.recorded
                   if key in values or key not in kind.optional})


def _surroundings(values: object) -> Surroundings:
    if not isinstance(values, dict):
        raise FastGSError("its surroundings are no table of names and values.")
    cameras = values.get("cameras", [])
    if not isinstance(cameras, list):
        raise FastGSError("the cameras of its surroundings are no list.")
    backdrop, view = (None if values.get(key) is None else _from_fields(kind, values[key], f"{key}'s")
                      for key, kind in (("backdrop", Backdrop), ("view", Viewpoint)))
    return Surroundings(backdrop, tuple(_from_fields(Viewpoint, camera, "cameras'") for camera in cameras), view)


def _provenance(values: object) -> dict[str, str]:
    if not isinstance(values, dict) or not all(isinstance(v, str) for v in values.values()):
        raise FastGSError("its provenance is no table of texts.")
    return values


def whole_number(value: object, what: str) -> int:
    """A JSON number that must be a count; raises FastGSError."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 2**53 or math.floor(value) != value:
        raise FastGSError(f"{what} cannot be {shown(value)}.")
    return int(value)


def frame_rate(value: Any, default: float) -> float:
    """A JSON value that is a number of frames per second; else the default."""
    return float(value) if type(value) in (int, float) and 0 < value < 1e6 else default


def restored(arrays: dict, kinds: dict) -> dict:
    """The arrays of a layout that always has cubic motion, linear rotation and Radial, in the poorer kinds that `kinds`
    records, where the numbers agree with them.  Returns keyword arguments for GaussianModel, kinds included."""
    kinds = {"basis": Polynomial(3), "rotation_basis": Polynomial(1), "temporal_kind": Radial()} | kinds
    for name, array in (("basis", "motion"), ("rotation_basis", "rotation_motion")):
        kind, values = kinds[name], arrays[array]
        if isinstance(kind, (Polynomial, Static)) and kind.terms < values.shape[1] and not values[:, kind.terms:].any():
            arrays[array] = values[:, :kind.terms]
        elif kind.terms != values.shape[1]:
            kinds[name] = Polynomial(values.shape[1])
    if isinstance(kinds["temporal_kind"], Always):
        arrays["temporal"] = None
    else:
        kinds["temporal_kind"] = Radial()
    return arrays | kinds
