# SPDX-License-Identifier: GPL-3.0-or-later
"""The unlit colour of a capture, estimated: its colours without the smooth part of the light that it was filmed in.

A captured colour c is about a E(n): the surface's own colour a, times a light that depends on the normal n.  Two places of one chroma that
are near each other mostly have the same a, so the ratio of their colours tells the light:

    log c_p - log c_q  =  log E(n_p) - log E(n_q),      log E(n) = sum_lm h_lm Y_lm(n),  l = 1, 2

The coefficients h, for each channel, are fitted to pairs of pixels of small pictures, robustly: pairs of two materials, or with a shadow's
edge between them, do not fit, and count little.  The normals are smooth (normals.py), and one E serves the whole clip and is kept with
the model: so nothing flickers, and what turns towards the light becomes brighter in the capture, not in the estimate.

What stays in the estimate: cast shadows, gloss, and light that differs from place to place.  How bright the whole is, and its tint, cannot
be told from the colour of things: E is 1, in the mean of the channels, for those normals that have the most light.
"""
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..cameras.camera import Camera
from ..cameras.parallel import parallel_camera
from ..cameras.viewpoints import camera_of
from ..model.filmed_from import directions
from ..model.framing import is_subject
from ..model.gaussians import GaussianModel
from ..model.slicing import positions_at
from ..util.threads import product
from .colour import scene_linear, straight
from .instances import Instance
from .layout import Layout
from .normals import normal

CAMERAS, TIMES, PIXELS = 8, 3, 72
"""Most cameras, most times, and pixels of the longer side of the pictures that are looked at."""
STEPS = (1, 2, 4, 8, 16)
"""Pixels between the two of a pair."""
CHROMA = 0.04
"""Difference of their chroma, as shares of the sum of the channels, with which a pair counts half."""
TURNED = 0.1
"""Squared distance between the normals of a pair from which on it tells anything."""
RESIDUALS = (0.6, 0.4, 0.25, 0.15, 0.1, 0.1)
"""In each round of the fit: residual, in logarithms, with which a pair counts half."""
RIDGE = 0.02
"""Share of the mean of the diagonal that is added to it: lights that no pair tells of are even."""
DARK, BRIGHT = 0.01, 0.9
"""Linear colours between which a channel can be told: what is clipped tells no ratio."""
MOST = 6.0
"""Largest factor from captured to unlit."""

_known: WeakKeyDictionary[GaussianModel, CapturedLight] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class CapturedLight:
    """The smooth light of a capture: log E = basis(n) @ weights - level.

    weights  [8, 3]  for each channel
    level    the logarithm of the most light, in the mean of the channels
    """

    weights: np.ndarray
    level: float

    def unlit(self, normal: np.ndarray) -> np.ndarray:
        """Factors [M, 3] from captured to unlit linear colour for unit normals [M, 3] in the model's space."""
        return np.minimum(np.exp(self.level - product(self.weights.T, basis(normal).T).T), MOST)


def basis(normal: np.ndarray) -> np.ndarray:
    """The harmonics of the first and second degree [..., 8] of unit vectors [..., 3], without their constant factors."""
    x, y, z = np.moveaxis(normal, -1, 0)
    return np.stack([x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], -1)


def captured_light(model: GaussianModel, backend: Any) -> CapturedLight:
    """The light that a model was captured in; computed once and kept as long as the model."""
    if model not in _known:
        _known[model] = _fitted(model, backend)
    return _known[model]


def _fitted(model: GaussianModel, backend: Any) -> CapturedLight:
    times = np.unique((np.arange(TIMES) + 0.5) / TIMES) if model.clip.frame_count > 1 else np.zeros(1)
    looked = [_look(model, camera, t, backend) for t in times for camera in _cameras(model, t)]
    pairs = [pair for picture in looked for step in STEPS for pair in _pairs(*picture, step)]
    turns, ratios, weights = (np.concatenate(each) for each in zip(*pairs)) if pairs else (np.zeros((0, 8)), np.zeros((0, 3)), np.zeros(0))
    found = np.zeros((8, 3))
    for residual in RESIDUALS if len(weights) else ():
        off = np.abs(ratios - turns @ found).max(1)
        counted = (weights / (1 + (off / residual) ** 2))[:, None] * turns
        matrix = turns.T @ counted
        found = np.linalg.solve(matrix + (RIDGE * np.trace(matrix) / 8 + 1e-9) * np.eye(8), counted.T @ ratios)
    seen = np.concatenate([normals[there] for _, normals, there in looked]) if looked else np.zeros((0, 3))
    lights = basis(seen) @ found
    return CapturedLight(found, float(np.percentile(lights.mean(1), 95)) if len(lights) else 0.0)


def _cameras(model: GaussianModel, t: float) -> list[Camera]:
    """Cameras of the capture, those of small pictures; if the file knows none, from all around its subject."""
    known = model.surroundings.cameras
    if known:
        chosen = [camera_of(known[i]) for i in np.unique(np.linspace(0, len(known) - 1, CAMERAS).astype(int))]
        return [_small(camera) for camera in chosen]
    place = positions_at(model, t)
    place = place[np.isfinite(place).all(1)]
    place = place[is_subject(place)] if len(place) else np.zeros((1, 3))
    return [parallel_camera(towards, place.min(0), place.max(0), PIXELS) for towards in directions(CAMERAS)]


def _small(camera: Camera) -> Camera:
    """The camera with few pixels."""
    by = PIXELS / max(camera.width, camera.height)
    width, height = max(round(camera.width * by), 1), max(round(camera.height * by), 1)
    x, y = width / camera.width, height / camera.height
    return Camera(width, height, camera.fx * x, camera.fy * y, camera.cx * x, camera.cy * y, camera.world_to_camera)


def _look(model: GaussianModel, camera: Camera, t: float, backend: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a camera sees: linear colours [h, w, 3], unit normals [h, w, 3], and which pixels tell anything [h, w]."""
    viewed = [Instance(model, np.eye(4), float(t)).viewed(camera)]
    layout = Layout(viewed, False, {"normal": normal(viewed, backend)})
    buffers = backend.draw(viewed, camera, layout, (), lambda share: None)
    alpha = backend.numpy(buffers.alpha).astype(np.float64)
    rgb = backend.numpy(backend.colour(buffers, layout, camera)).astype(np.float64)
    colour = straight(scene_linear(rgb, alpha, model.colour_space), alpha)
    total = backend.numpy(buffers.sums["normal"]).astype(np.float64)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    there = (alpha > 0.9) & (length[..., 0] > 0.7) & (colour.max(-1) < BRIGHT) & (colour.min(-1) > DARK)
    return colour, total / np.maximum(length, 1e-9), there


def _pairs(colour: np.ndarray, normals: np.ndarray, there: np.ndarray, step: int) -> Iterator[tuple[np.ndarray, ...]]:
    """Of pixels so far apart: (differences of the harmonics [P, 8], of the logarithms of colour [P, 3], weights [P])."""
    logs, chroma = np.log(np.maximum(colour, DARK)), colour / np.maximum(colour.sum(-1, keepdims=True), 1e-9)
    harmonics, (height, width) = basis(normals), there.shape
    for down, right in ((0, step), (step, 0), (step, step), (step, -step)):
        if down >= height or abs(right) >= width:
            continue
        one = slice(0, height - down), slice(max(-right, 0), width - max(right, 0))
        other = slice(down, height), slice(max(right, 0), width + min(right, 0))
        both = there[one] & there[other]
        both &= ((normals[one] - normals[other]) ** 2).sum(-1) > TURNED
        unlike = ((chroma[one] - chroma[other])[both] ** 2).sum(-1)
        yield (harmonics[one] - harmonics[other])[both], (logs[one] - logs[other])[both], 1 / (1 + unlike / CHROMA**2) ** 2
