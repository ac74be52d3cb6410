# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the sensitivity of a model's pictures to each of its parameters: the mean squared change of the pictures.

The gradient of sum(r C) of a picture C with random signs r is computed by the backward pass.  The expected square of a parameter's gradient
is the sum over the pixels of (dC/dp)^2 (Hutchinson 1990), the diagonal of the Gauss-Newton matrix.  A small error e of p adds about that
times e^2 to the squared error of the pictures.  Blending is linear in each splat's opacity, so this is exact for leaving a Gaussian out.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..cameras.camera import Camera
from ..cameras.opening import RIGHT_DOWN_FORWARD
from ..cameras.viewpoints import camera_of
from ..model.appearance import Features
from ..model.filmed_from import BAKED, mean_direction, one_sided
from ..model.framing import is_subject, without_backdrop
from ..model.gaussians import GaussianModel
from ..model.pruning import scores
from ..model.slicing import sigmoid
from ..rendering.api import render
from ..util.backends import load_backend
from ..util.errors import FastGSError

WIDTH = 400
"""Pixels of the longer side of the pictures that sensitivities are measured on."""
GOLDEN = 0.6180339887498949
"""Its multiples, modulo 1, are spread evenly over 0..1."""
PLASTIC = 0.7548776662466927
"""Multiples of it and of its square, modulo 1, spread points evenly in a square (Roberts 2018)."""
SIDEWAYS = 0.15
"""Largest distance of a shot from the camera's own position, divided by the distance of the scene."""
FRAMED, FILM = 0.65, 16 / 9
"""The part of the width of a capture's picture that half of the shots show, and their shape.  A capture's cameras keep all that moves in
their pictures, with room around it.  A film shows more of the subject, and a loss that is judged by whole pictures is too low for it."""
NEIGHBOURS = 4
"""Of a capture's camera: the nearest others.  A model that was refitted to pictures from near the cameras alone was worse between them."""
WIDE = 0.54
"""Focal length divided by the width, for every second guessed camera: a wide lens shows Gaussians at the border."""
RIG = ((0.0, 0.0, 0.0), (-0.12, 0.05, 0.0), (0.12, -0.05, 0.0), (0.05, 0.04, 0.02), (-0.06, -0.05, 0.0), (-0.3, 0.0, 0.05),
       (0.1, 0.03, 0.0), (0.3, -0.03, 0.05), (0.0, 0.0, 0.2), (0.0, 0.05, -0.1))
"""Guessed positions of cameras that look forward: right, down and forward of the origin, divided by the distance of the scene."""
BACKGROUNDS = 0.0, 0.5, 0.0, 1.0
"""Of the pictures: over black, as renders are looked at most, what is missing of a bright surface shows; over white, of a dark one."""
OPAQUE = 4.5
"""Logit of the largest opacity at which sensitivities are measured: beyond it alpha is clamped, and gradients are 0."""
UNSEEN = 0.03
"""Weight of a Gaussian's promise (Sensitivity.promise) beside its measured error."""


class Shot(NamedTuple):
    """A picture of a model: its camera, its time and the grey of its background."""

    camera: Camera
    t: float
    background: float


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The mean squared error of pictures (colours 0..1) for each unit of squared error of a parameter: averages over shots, float64.

    rows [N, D] by name of the array: position and rotation summed over their columns (D = 1), scale, features and temporal by column,
    opacity and mu_tau as one column
    promise [N] the expected contribution of a Gaussian, from its size as the nearest camera sees it, its opacity and its lifetime; no unit
    """

    rows: dict[str, np.ndarray]
    promise: np.ndarray

    def take(self, index: np.ndarray) -> Sensitivity:
        """The sensitivity of a part of the Gaussians."""
        return Sensitivity({name: array[index] for name, array in self.rows.items()}, self.promise[index])


def shots(model: GaussianModel, count: int, first: int = 0, width: int | None = None, span: tuple[float, float] = (0.0, 1.0)) -> list[Shot]:
    """`count` cameras and times at which a model's pictures are measured; another `first` gives other ones.

    width  pixels of the pictures' longer side, instead of WIDTH
    span   the times between which they lie

    The cameras are those of its capture, each moved towards one of its NEIGHBOURS by another part of the way, else guessed_cameras().  Each
    is also moved sideways by a different amount, because Gaussians that are hidden from one place may be visible from a place beside it.
    Of a capture's cameras every second four shots are framed(); guessed ones have lenses of their own.
    """
    known = [(camera_of(view), view.distance) for view in model.surroundings.cameras]
    eyes = known or [(eye, 0.0) for eye in guessed_cameras(model)]
    places = np.array([np.linalg.inv(camera.world_to_camera)[:3, 3] for camera, _ in eyes])
    nearest = np.argsort(np.linalg.norm(places[:, None] - places, axis=2), axis=1, kind="stable")[:, 1:]
    part = _seen(model)
    middle, found = np.median(part.position if len(part) else np.zeros((1, 3)), axis=0), []
    for k in range(first, first + count):
        chosen = int(len(eyes) * ((k * GOLDEN * GOLDEN + 0.37) % 1))
        camera, distance = eyes[chosen]
        pose = np.linalg.inv(camera.world_to_camera)
        distance = distance or max(float(np.linalg.norm(middle - pose[:3, 3])), 1e-6)
        across, up = (SIDEWAYS * distance * (2 * ((k * step) % 1) - 1) for step in (PLASTIC, PLASTIC * PLASTIC))
        aim = pose[:3, 3] + distance * pose[:3, 2]
        place = pose[:3, 3] + pose[:3, :3] @ [across, up, 0.0]
        if len(known) > NEIGHBOURS:
            other, away = eyes[nearest[chosen][k % NEIGHBOURS]]
            there = np.linalg.inv(other.world_to_camera)
            part_way = (k * PLASTIC**3) % 1
            place = place + part_way * (there[:3, 3] - pose[:3, 3])
            aim = aim + part_way * (there[:3, 3] + (away or distance) * there[:3, 2] - aim)
        camera = resized(framed(camera) if known and k // len(BACKGROUNDS) % 2 else camera, width or WIDTH)
        moved = replace(camera, world_to_camera=np.vstack([looking(place, aim - place, pose[:3, 1]), [0, 0, 0, 1]]))
        time = span[0] + (span[1] - span[0]) * ((0.5 + k * GOLDEN) % 1)
        found.append(Shot(moved, time, BACKGROUNDS[k % len(BACKGROUNDS)]))
    return found


def _seen(model: GaussianModel) -> GaussianModel:
    """The model without its backdrop, unless it has nothing else."""
    part = without_backdrop(model)
    return part if len(part) else model


def framed(camera: Camera) -> Camera:
    """The middle of the picture of a capture's camera: FRAMED of its width, in the shape of a film."""
    width = max(1, round(FRAMED * camera.width))
    height = max(1, min(camera.height, round(width / FILM)))
    cx, cy = camera.cx - (camera.width - width) / 2, camera.cy - (camera.height - height) / 2
    return Camera(width, height, camera.fx, camera.fy, cx, cy, camera.world_to_camera)


def resized(camera: Camera, width: int) -> Camera:
    """The camera with pictures whose longer side has `width` pixels."""
    factor = width / max(camera.width, camera.height)
    across, down = (max(1, round(side * factor)) for side in (camera.width, camera.height))
    fx, fy, cx, cy = (value * factor for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return Camera(across, down, fx, fy, cx, cy, camera.world_to_camera)


def guessed_cameras(model: GaussianModel) -> list[Camera]:
    """Guesses the cameras of a capture for a model whose file does not name them.

    Reconstructions usually have their origin among the cameras.  Where all Gaussians lie to one side of the origin, the guessed cameras are
    around the origin and look to that side, some farther to the sides, nearer or farther away; else, and of a baked model, they are in a
    ring around the subject.
    """
    part = _seen(model)
    position = part.position[is_subject(part.position)].astype(np.float64)
    down = RIGHT_DOWN_FORWARD[model.axes][1]
    mean = mean_direction(position)
    if one_sided(position, -down) and model.provenance.get("source") != BAKED:
        depth = float(np.median(position @ mean) / np.linalg.norm(mean))
        frame = looking(np.zeros(3), mean, down)
        local = position @ frame[:, :3].T
        aspect = np.percentile(np.abs(local[:, 0]) / np.maximum(local[:, 2], 0.1 * depth), 80)
        focal = float(np.clip(0.5 / max(aspect, 1e-6), 0.5, 1.2)) * WIDTH
        places = [frame[:, :3].T @ (np.array(place) * depth) for place in RIG]
        aims = [0.3 * place + mean / np.linalg.norm(mean) * depth for place in places]
    else:
        middle = np.median(position, axis=0)
        reach = float(np.percentile(np.linalg.norm(position - middle, axis=1), 80)) + 2 * float(np.exp(np.median(part.scale)))
        side = np.cross(down, [0.36, 0.48, 0.8])
        side /= np.linalg.norm(side)
        other, focal = np.cross(down, side), 1.0 * WIDTH
        angles = np.arange(12) * 2 * np.pi / 12
        places = [middle + 2.4 * reach * (np.cos(a) * side + np.sin(a) * other - (0.2 + 0.3 * (k % 2)) * down)
                  for k, a in enumerate(angles)]
        aims = [middle] * len(places)
    height = round(0.75 * WIDTH)
    lens = [focal, min(focal, WIDE * WIDTH)]
    poses = [np.vstack([looking(place, aim - place, down), [0, 0, 0, 1]]) for place, aim in zip(places, aims, strict=True)]
    return [Camera(WIDTH, height, lens[k % 2], lens[k % 2], WIDTH / 2, height / 2, pose) for k, pose in enumerate(poses)]


def looking(place: np.ndarray, direction: np.ndarray, down: np.ndarray) -> np.ndarray:
    """World to camera [3, 4] of a camera at a place that looks in a direction."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(down, z)
    x /= max(np.linalg.norm(x), 1e-12)
    turn = np.array([x, np.cross(z, x), z])
    return np.concatenate([turn, (-turn @ place)[:, None]], 1)


def sensitivity(model: GaussianModel, series: list[Shot], progress: Callable[[float], None] = lambda fraction: None) -> Sensitivity:
    """The Sensitivity of these pictures of a model to the model's parameters.  Raises FastGSError where no backend can differentiate
    pictures."""
    backend = differentiable()
    parameters = parameters_of(model, backend)
    parameters["opacity"] = backend.array(np.minimum(model.opacity, OPAQUE))
    n, rows = len(model), dict[str, np.ndarray]()
    for k, (camera, t, background) in enumerate(series):
        picture = backend.forward(parameters, model, camera, float(t))
        rgb, alpha = backend.numpy(picture.rgb), backend.numpy(picture.alpha)
        seen = rgb + background * (1 - alpha)[..., None]
        signs = np.random.default_rng([k, 12]).integers(0, 2, rgb.shape).astype(np.float32) * 2 - 1
        signs *= (seen >= 0) & (seen <= 1)
        gradients = backend.backward(picture, backend.array(signs), backend.array(-background * signs.sum(2)))
        for name in ("position", "scale", "rotation", "opacity", "features", "mu_tau", "temporal"):
            found = backend.numpy(gradients[name]).reshape(n, -1).astype(np.float64) ** 2 / (rgb.size * len(series))
            found = found.sum(1, keepdims=True) if name in ("position", "rotation") else found
            rows[name] = rows[name] + found if name in rows else found
        progress((k + 1) / len(series))
    eyes = np.unique([np.linalg.inv(camera.world_to_camera)[:3, 3] for camera, *_ in series], axis=0)
    return Sensitivity(rows, scores(model, list(eyes)) * sigmoid(model.opacity))


def pictures(model: GaussianModel, series: list[Shot]) -> list[np.ndarray]:
    """Renders of the shots over their backgrounds, [h, w, 3] each, clipped to 0..1."""
    found = []
    for camera, t, background in series:
        out = render(model, camera, t)
        found.append(np.clip(out["rgb"] + background * (1 - out["alpha"])[..., None], 0, 1))
    return found


def mean_square(first: list[np.ndarray], second: list[np.ndarray]) -> float:
    """Mean squared difference of two series of pictures."""
    return float(np.mean([np.mean(np.square(a - b), dtype=np.float64) for a, b in zip(first, second, strict=True)]))


def removal(model: GaussianModel, found: Sensitivity) -> np.ndarray:
    """The mean squared error of the pictures that leaving out each Gaussian alone adds, [N].

    A Gaussian that no picture shows may be seen from elsewhere: it counts a little, in proportion to its promise.
    """
    opacity = sigmoid(np.minimum(model.opacity, OPAQUE))
    harm = found.rows["opacity"][:, 0] / (1 - opacity) ** 2
    shown = (harm > 0) & (found.promise > 0)
    usual = float(np.median(harm[shown] / found.promise[shown])) if shown.any() else 1.0
    return harm + UNSEEN * usual * found.promise


def parameters_of(model: GaussianModel, backend: Any) -> dict[str, Any]:
    """The model's arrays, its decoder's among them, as a TrainingBackend takes them."""
    appearance = model.appearance
    decoder = {"w1": appearance.w1, "w2": appearance.w2} if isinstance(appearance, Features) else {}
    return {name: backend.array(array) for name, array in (model.arrays | decoder).items()}


def differentiable() -> Any:
    """The TrainingBackend that pictures are differentiated with; raises FastGSError where it is missing."""
    try:
        return load_backend("cpu")
    except ImportError as error:
        raise FastGSError("compressing measures pictures of the model, which needs the Python package numba; install it.") from error
