# SPDX-License-Identifier: GPL-3.0-or-later
"""`.ftgs.ply`: FreeTimeGS models as one PLY (FreeTimeGsVanilla, FTGS player; version 1).

Columns: those of INRIA's PLY, then time, log_duration (ln of the temporal standard deviation), velocity_0..2 (per unit of time).
Time is normalised: the first frame is 0, the last one 1, so a clip of n frames has n - 1 steps and t here is the file's own time.
Comments: ftgs_version, time_units, sh_degree, use_velocity, min_duration, opacity_floor, n_frames.  The floor (1e-4) lies far under
what a rasteriser draws; where it does not, that is said.
"""
import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..model.appearance import SH
from ..model.gaussians import Clip, GaussianModel, Raster
from ..model.motion import Polynomial
from ..model.temporal import Radial
from ..util.errors import FastGSError, LossWarning
from . import ply
from .base import STEEP, Format, generator
from .fitting import bell_opacity, polynomial_motion, still_rotation
from .inria import NORMAL, POSITION, ROTATION, SCALE, harmonics, in_file_order
from .static import plain_harmonics
from .straight import straight
from .turning import into_rdf, turned

TIME = ("time", "log_duration")
VELOCITY = ("velocity_0", "velocity_1", "velocity_2")
MIN_DURATION, FLOOR, FRAMES = 0.02, 1e-4, 300
"""What holds where the header does not say another."""
GSPLAT = Raster(alpha_max=0.999, near=0.01)
"""The constants of gsplat up to 1.5, with which FreeTimeGS is trained."""


class FreeTimePly(Format):
    name = "FreeTimeGS PLY"
    extensions = (".ftgs.ply",)
    reads = (".ply",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith(b"ply") and ply.read_header(path).names.issuperset(TIME)

    def load(self, path: Path) -> GaussianModel:
        header = ply.read_header(path)
        said = _settings(header.comments)
        moves = said["use_velocity"] != 0
        degree, groups = static_columns(header, path)
        columns = ply.read_vertices(path, header, groups | {"time": TIME, "velocity": VELOCITY if moves else ()})
        time, velocity = columns.pop("time"), columns.pop("velocity")
        if said["opacity_floor"] >= GSPLAT.alpha_cut:
            warnings.warn(LossWarning(f"{path}: the opacity that its Gaussians keep for ever ({said['opacity_floor']:g}) is left out."),
                          stacklevel=3)
        lives = straight(columns.pop("position"), velocity if moves else None, time[:, 0],
                         np.maximum(time[:, 1], math.log(said["min_duration"])))
        return GaussianModel(**columns, **lives, appearance=SH(degree), raster=GSPLAT, clip=clip_of(said["n_frames"]))

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        return straight_model(model, degree=4)

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        ln_s = model.temporal[:, 0] if isinstance(model.temporal_kind, Radial) else np.full(len(model), -STEEP)
        ln_sigma = -0.5 * (math.log(2) + ln_s.astype(np.float64))
        shortest = min(MIN_DURATION, float(np.exp(ln_sigma.min(initial=0))))
        said = {"ftgs_version": 1, "time_units": "normalized", "sh_degree": model.appearance.degree, "use_velocity": 1,
                "min_duration": f"{0.999 * shortest:.6g}", "opacity_floor": 0, "n_frames": model.clip.frame_count + 1}
        velocity = model.motion[:, 0] if model.basis.terms else np.zeros((len(model), 3), np.float32)
        columns = [(POSITION, model.position), (NORMAL, np.broadcast_to(np.float32(0), (len(model), 3))), *in_file_order(model),
                   (("opacity",), model.opacity[:, None]), (SCALE, model.scale), (ROTATION, model.rotation),
                   (TIME, np.stack([model.mu_tau, ln_sigma], -1).astype(np.float32)), (VELOCITY, velocity)]
        ply.write(targets[-1], [f"Written by {generator()}", *(f"{key} {value}" for key, value in said.items())], columns)


def straight_model(model: GaussianModel, degree: int) -> tuple[GaussianModel, list[str]]:
    """The model in the axes RDF with straight motion, bell-shaped lives, no turning and spherical harmonics, and clauses."""
    model, lost = bell_opacity(model)
    for step in (lambda m: polynomial_motion(m, 1), still_rotation, lambda m: plain_harmonics(m, degree)):
        model, clauses = step(model)
        lost += clauses
    if model.raster != GSPLAT:
        lost.append("the rasteriser's constants that it was trained with")
    if model.colour_space == "linear":
        lost.append("that its colours are linear, not sRGB")
    if model.provenance.keys() - {"source", "format"}:
        lost.append("its provenance")
    turn = into_rdf(model.axes)
    motion = model.motion.astype(np.float64) @ turn.T
    basis = {"basis": Polynomial(1), "motion": motion[:, :1]} if model.basis.terms else {}
    return replace(turned(model, turn), axes="RDF", **basis), lost


def static_columns(header: ply.Header, path: Path) -> tuple[int, dict[str, Sequence[str]]]:
    """The degree of spherical harmonics and the columns that every static Gaussian has, for read_vertices()."""
    degree, colours = harmonics(header, path)
    return degree, {"position": POSITION, "rotation": ROTATION, "scale": SCALE, "opacity": "opacity", "features": colours}


def clip_of(frames: int, fps: float = 30.0) -> Clip:
    """The clip of so many frames, of which the first lies at t = 0 and the last at t = 1."""
    return Clip(max(1, frames - 1), fps)


def _settings(comments: tuple[str, ...]) -> dict[str, Any]:
    """The header's numbers; raises FastGSError for another version, unit, or what is no such number."""
    said = dict(comment.split(None, 1) for comment in comments if len(comment.split(None, 1)) == 2)
    if said.get("ftgs_version", "1") != "1":
        raise FastGSError(f"it is version {said['ftgs_version'][:20]} of the format, and this program reads version 1.")
    if said.get("time_units", "normalized") != "normalized":
        raise FastGSError(f"its unit of time is {said['time_units'][:20]!r}, and only 'normalized' is defined; export it again.")
    checks = {"use_velocity": (1, lambda v: v in (0, 1)), "min_duration": (MIN_DURATION, lambda v: 0 < v < math.inf),
              "opacity_floor": (FLOOR, lambda v: 0 <= v < 1), "n_frames": (FRAMES, lambda v: v == int(v) and 1 <= v <= 10_000_000)}
    numbers = {}
    for key, (default, good) in checks.items():
        try:
            value = float(said.get(key, default))
            if not math.isfinite(value) or not good(value):
                raise ValueError
        except ValueError as error:
            raise FastGSError(f"its comment {key} cannot be {said[key][:20]!r}; export it again.") from error
        numbers[key] = value
    return numbers | {"n_frames": int(numbers["n_frames"])}
