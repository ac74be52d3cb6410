# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns a sequence whose frames hold the same Gaussians in one order into one model: least squares in time.

Frames are read one after another and never held together: a fit's coefficients are weighted sums of the frames' values.
"""
import warnings
from typing import Any

import numpy as np

from ..util import rotations
from ..util.errors import FastGSError, LossWarning
from .appearance import Changing
from .fitting import Fit, choose, motion_families, rotation_families
from .gaussians import Clip, GaussianModel
from .motion import Family, Static
from .sequence import PROBES, Sequence
from .slicing import sigmoid

SIZE = 0.05
"""Of a Gaussian's median standard deviation: motion is fitted as well as this for 95 of 100 Gaussians on every frame."""
TURN = 0.02
"""Of quaternions, likewise: two degrees."""
SHADE = 0.02
"""Of colours' coefficients, likewise."""


def one_model(sequence: Sequence) -> GaussianModel:
    """The model that moves through the sequence's frames; one LossWarning says how well.

    Raises FastGSError where two frames do not hold the same Gaussians in the same order.
    """
    count = len(sequence.at)
    t = sequence.at / sequence.clip.frame_count
    probes = np.linspace(0, len(sequence) - 1, min(len(sequence), PROBES)).astype(int)
    probed: dict[str, list[np.ndarray]] = {name: [] for name in ("position", "rotation", "features", "scale", "opacity")}
    for i in range(count):
        model = sequence.frame(i)
        if i and not sequence.matches(i - 1, i):
            raise FastGSError(f"{sequence.about}: the frames {i - 1} and {i} do not hold the same Gaussians in the same order, so that no "
                              "one model moves through them; keep the sequence.")
        chosen = model.take(probes)
        for name, values in probed.items():
            values.append(_values(chosen, name))
    seen = {name: np.stack(values) for name, values in probed.items()}
    seen["rotation"] = rotations.one_sign(seen["rotation"])
    size = float(np.median(np.exp(seen["scale"])))
    moving = _fit(seen["position"], motion_families("auto", t), t, SIZE * size)
    turning = _fit(seen["rotation"], rotation_families(t), t, TURN)
    shading = _fit(seen["features"], motion_families("auto", t), t, SHADE)

    first, last = sequence.frame(0), None
    sums: dict[str, np.ndarray] = {}
    for i in range(count):
        model = sequence.frame(i)
        turn = _values(model, "rotation")
        if last is not None:
            turn = np.where(np.sum(turn * last, 1, keepdims=True) < 0, -turn, turn)
        last = turn
        parts = {"position": (moving.solve[:, i], model.position), "rotation": (turning.solve[:, i], turn),
                 "features": (shading.solve[:, i], model.features), "scale": (np.full(1, 1 / count), model.scale),
                 "opacity": (np.full(1, 1 / count), sigmoid(model.opacity))}
        for name, (weights, value) in parts.items():
            if name not in sums:
                sums[name] = np.zeros((len(weights), *value.shape), np.float32)
            for total, weight in zip(sums[name], weights):
                total += np.float32(weight) * value.astype(np.float32)
    odds = np.clip(sums["opacity"][0], 1e-7, 1 - 1e-7)
    appearance: Any = first.appearance
    features = sums["features"].transpose(1, 0, 2).reshape(len(first), -1)
    clip = Clip(sequence.clip.frame_count, sequence.clip.fps, sequence.clip.start_frame)
    fitted = GaussianModel(
        position=sums["position"][0], motion=sums["position"][1:].transpose(1, 0, 2), basis=moving.basis,
        rotation=sums["rotation"][0], rotation_motion=sums["rotation"][1:].transpose(1, 0, 2), rotation_basis=turning.basis,
        scale=sums["scale"][0], opacity=np.log(odds / (1 - odds)), features=features,
        appearance=appearance if isinstance(shading.basis, Static) else Changing(appearance, shading.basis),
        raster=first.raster, clip=clip, axes=first.axes, colour_space=first.colour_space, provenance=dict(sequence.provenance))
    warnings.warn(LossWarning(f"{sequence.about}: {_quality(seen, moving, turning, shading)}."), stacklevel=2)
    return fitted


def _values(model: GaussianModel, name: str) -> np.ndarray:
    values = getattr(model, name).astype(np.float64)
    return rotations.unit(values) if name == "rotation" else sigmoid(values) if name == "opacity" else values


def _fit(values: np.ndarray, families: list[Family], t: np.ndarray, tolerance: float) -> Fit:
    def error(fit: Fit) -> float:
        wrong = np.abs(fit(values)[1] - values).reshape(len(values), -1)
        return float(np.quantile(wrong, 0.95, axis=1).max()) / max(tolerance, 1e-12)

    return Fit.of(choose(families, t, error), t)


def _quality(seen: dict, moving: Fit, turning: Fit, shading: Fit) -> str:
    """Clauses on how well the fits reproduce the frames."""
    def rms(values: np.ndarray, fitted: np.ndarray) -> float:
        return float(np.sqrt(np.mean((values - fitted) ** 2)))

    place = np.linalg.norm(moving(seen["position"])[1] - seen["position"], axis=-1)
    fitted = rotations.unit(turning(seen["rotation"])[1])
    angle = np.degrees(2 * np.arccos(np.minimum(np.abs(np.sum(fitted * seen["rotation"], -1)), 1)))
    shade = rms(seen["features"], shading(seen["features"])[1])
    clauses = [f"its motion becomes {_named(moving)}, RMS error {np.sqrt(np.mean(place**2)):.3g} units, at most {place.max():.3g}",
               f"its rotations {_named(turning)}, RMS error {np.sqrt(np.mean(angle**2)):.3g} degrees",
               f"its colours {_named(shading)}, RMS error {shade:.3g}"]
    for name, what in (("scale", "sizes"), ("opacity", "opacities")):
        spread = rms(seen[name], seen[name].mean(0))
        if spread > 1e-4:
            clauses.append(f"its {what}, which change, stay at their means, RMS error {spread:.3g}")
    return "; ".join(clauses)


def _named(fit: Fit) -> str:
    return f"{fit.basis.name} ({fit.basis.terms} terms)"
