# SPDX-License-Identifier: GPL-3.0-or-later
"""What the cameras of a capture saw of each Gaussian, and what their pictures would miss without it: evidence for Clean Up (clean.py).

A small picture of each camera is rendered and differentiated, at several times.  The blending weights of a Gaussian are the light that it
gives to the picture; they tell where it is hidden, too.  A weighted mean of the inverse depths of what the pixels show, times its own
depth, tells whether it hangs before that.  What the picture would miss without it comes from its opacity's gradient of random signs, as in
formats/sensitivity.py.  One picture gives all three: its first channel has the colours, seen along a random direction of colour space, and
the others, which are black, take the weights.
"""
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from ..cameras.camera import Camera
from ..cameras.viewpoints import camera_of
from ..model.appearance import RGB
from ..model.edits import state_of
from ..model.gaussians import GaussianModel
from ..model.slicing import positions_at, sigmoid
from ..rendering.api import render
from ..util.backends import load_backend
from .light import small

SIDE = 200
"""Pixels of the longer side of the pictures."""
PICTURES = 32
"""Of all cameras together, at least."""
CHECKED = 8
"""Pictures by which it is checked what is missed."""
GOLDEN = 0.6180339887498949
"""Its multiples, modulo 1, are spread evenly over 0..1."""
OPAQUE = 4.5
"""Logit of the largest opacity: beyond it alpha is clamped, and gradients are 0."""
LIT = 0.05
"""Pixels of light from which on a camera sees a Gaussian."""
CONTRAST = 0.03
"""Difference of colours (0..1) from what is behind a Gaussian that is assumed at least: random signs may cancel."""
ALIVE = 0.5
"""Of a Gaussian's temporal opacity: a picture at such a time can judge it."""
SIZES, CLOSE, MOST = (-40.0, 40.0), 1e-12, 1e12
"""Bounds of the logarithms of sizes, the least squared distance and the largest area that are computed with: files hold any numbers."""


class SampledView(NamedTuple):
    """A picture: which of the cameras, that camera with few pixels, and its time."""

    number: int
    camera: Camera
    t: float


@dataclass(frozen=True, eq=False)
class Sightings:
    """What the cameras saw of N Gaussians; float32, pixels are those of pictures SIDE pixels large.

    best     [N]  pixels of light that one picture got at most
    area     [N]  pixels that it would cover before the nearest camera, if nothing hid it
    before   [N]  its depth divided by that of what the same pixels show, weighted by its light; 1 where nobody saw it
    seen     [N]  cameras that got LIT pixels of it or more; chances [N]: those with a picture at a time when it is opaque
    cost     [N]  mean squared change of the pictures (colours 0..1) without it alone
    """

    best: np.ndarray
    area: np.ndarray
    before: np.ndarray
    seen: np.ndarray
    chances: np.ndarray
    cost: np.ndarray


def sampled_views(model: GaussianModel) -> list[SampledView]:
    """The pictures, camera by camera, their times spread over the clip; none where the file knows no cameras.

    A model that stands still is looked at as often: each picture has other signs.
    """
    cameras = [small(camera_of(view), SIDE) for view in model.surroundings.cameras]
    each = -(-PICTURES // max(len(cameras), 1))
    return [SampledView(number, camera, (k + number * GOLDEN % 1) / each) for number, camera in enumerate(cameras) for k in range(each)]


def sightings(model: GaussianModel, progress: Callable[[float], None] = lambda share: None) -> Sightings:
    """What the cameras that a model's file knows saw of it; kept as long as the model lives.

    progress  called with 0..1; what it raises ends the work and passes through
    """
    with _lock:
        found = _known.get(model)
    if found is None:
        found = _sighted(model, progress)
        with _lock:
            _known[model] = found
    return found


def change(model: GaussianModel, hidden: np.ndarray) -> float:
    """Mean squared change (colours 0..1) of CHECKED of the cameras' pictures, over grey, without some Gaussians [N] bool together.

    Gaussians in a layer, or around a border, are missed more together than the sum of their costs says.
    """
    if not hidden.any():
        return 0.0
    series = sampled_views(model)
    series = [series[k] for k in np.linspace(0, len(series) - 1, min(CHECKED, len(series))).round().astype(int)]
    with _lock:
        whole = _whole.get(model)
    if whole is None:
        whole = [_over_grey(model, view) for view in series]
        with _lock:
            _whole[model] = whole
    left = model.take(~hidden)
    pairs = zip(series, whole, strict=True)
    return float(np.mean([np.square(_over_grey(left, view) - before, dtype=np.float64).mean() for view, before in pairs]))


def _over_grey(model: GaussianModel, view: SampledView) -> np.ndarray:
    """A picture [h, w, 3] over grey, so that holes show before bright and dark things."""
    picture = render(model, view.camera, view.t, backend="cpu")
    return picture["rgb"] + 0.5 * (1 - picture["alpha"])[..., None]


_known: WeakKeyDictionary = WeakKeyDictionary()
_whole: WeakKeyDictionary = WeakKeyDictionary()
_lock = threading.Lock()


def _sighted(model: GaussianModel, progress: Callable[[float], None]) -> Sightings:
    """sightings(), computed."""
    n, series = len(model), sampled_views(model)
    backend, opacity = load_backend("cpu"), np.minimum(model.opacity, np.float32(OPAQUE))
    size = np.sort(np.exp(np.clip(model.scale.astype(np.float64), *SIZES)), 1)
    shown = 2 * np.pi * sigmoid(model.opacity) * size[:, 1] * size[:, 2]
    best, total, behind, cost, seen, chances, area = (np.zeros(n, np.float32) for _ in range(7))
    for k, (number, camera, t) in enumerate(series):
        if not k or series[k - 1].number != number:
            lit, could = np.zeros(n, bool), np.zeros(n, bool)
        place = camera.local(np.nan_to_num(positions_at(model, t)))
        pixels = shown * abs(camera.fx * camera.fy) / np.maximum((place**2).sum(1), CLOSE)
        light, inverse, change = _weights(model, opacity, camera, t, k, backend)
        best, area = np.maximum(best, light), np.maximum(area, np.minimum(pixels, MOST)).astype(np.float32)
        total, behind = total + light, behind + np.nan_to_num(place[:, 2] * inverse).astype(np.float32)
        least = CONTRAST**2 * light**2 / np.maximum(np.maximum(pixels, light), 1e-9)
        cost += (np.maximum(change**2, least) / (camera.width * camera.height * len(series))).astype(np.float32)
        lit |= light >= LIT
        could |= model.temporal_kind.factor(t, model.mu_tau, model.temporal) >= ALIVE
        if k + 1 == len(series) or series[k + 1].number != number:
            seen, chances = seen + lit, chances + could
        progress((k + 1) / len(series))
    before = np.where(total > 0, behind / np.maximum(total, np.float32(1e-30)), 1)
    return Sightings(best, area, before.astype(np.float32), seen, chances, cost)


def _weights(model: GaussianModel, opacity: np.ndarray, camera: Camera, t: float, seed: int, backend: Any) -> tuple[np.ndarray, ...]:
    """Of a picture: pixels of light of each Gaussian [N]; their sum weighted by the inverse depth of what the pixels show; a sum over the
    pixels, with random signs, of what it changes in them."""
    rng = np.random.default_rng([seed, 34])
    along = rng.normal(size=3)
    features = np.zeros((len(model), 3), np.float32)
    features[:, 0] = state_of(model, t).colour @ (along / np.linalg.norm(along))
    plain = replace(model, features=features, appearance=RGB(), opacity=opacity)
    deep = render(plain, camera, t, ["median_depth"], "cpu")["median_depth"]
    picture = backend.forward({name: backend.array(array) for name, array in plain.arrays.items()}, plain, camera, float(t))
    asked = np.ones((*deep.shape, 3), np.float32)
    asked[..., 0] = 2 * rng.integers(0, 2, deep.shape) - 1
    asked[..., 2] = np.where(np.isfinite(deep), 1 / np.maximum(deep, 1e-9), 0)
    slopes = backend.backward(picture, backend.array(asked))
    light, change = backend.numpy(slopes["features"]), backend.numpy(slopes["opacity"])
    return light[:, 1], light[:, 2], change / (1 - sigmoid(opacity))
