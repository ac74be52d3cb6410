# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders panoramas: pinhole pictures all around, which fade into each other, so that no edge is seen.

A splat that reaches over an edge is projected, and sorted, a little differently on either side.  Therefore faces overlap by
twice panorama.MARGIN, and what both see is mixed by how far it lies within each.
"""
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..cameras.panorama import FACES, MARGIN, Panorama
from .exposure import Exposure
from .lookup import between_pixels
from .passes import PASSES, PassSettings


def render_panorama(render: Callable[..., dict[str, np.ndarray]], camera: Panorama, passes: Sequence[str], settings: PassSettings,
                    exposure: Exposure | None, progress: Callable[[float], None]) -> dict[str, np.ndarray]:
    """The passes, as render() returns them.

    render  render() of a pinhole camera, but for its model and what else these passes do not change

    Depths are distances from the camera.  There are no vectors: they are 0.  The lens is a pinhole.
    """
    seen = camera.directions()
    shares, places = zip(*(_seen_by(seen, face) for face in FACES), strict=True)
    total = np.maximum(sum(shares), 1e-30)
    wanted = [PASSES[name] for name in passes]
    shape = seen.shape[:2]
    out = {p.name: np.zeros(shape if p.channels == 1 else (*shape, p.channels)) if p.mixes else
           np.full(shape if p.channels == 1 else (*shape, p.channels), p.empty) for p in wanted}
    best, used = np.zeros(shape), [i for i in range(len(FACES)) if shares[i].any()]
    for number, i in enumerate(used):
        found = render(camera.face(i), passes=tuple(out), settings=replace(settings, before=None, after=None),
                       exposure=exposure and _of_face(exposure, i),
                       progress=lambda f, number=number: progress((number + f) / len(used)))
        at = np.nonzero(shares[i] > 0)
        eye, (x, y) = camera.face(i), places[i][at].T
        x, y = x * eye.fx + eye.cx - 0.5, y * eye.fy + eye.cy - 0.5
        nearer = shares[i][at] > best[at]
        nearest = tuple(np.clip(np.round(v).astype(int), 0, eye.width - 1)[nearer] for v in (y, x))
        target = tuple(index[nearer] for index in at)
        best[target] = shares[i][target]
        for p in wanted:
            if p.mixes:
                share = (shares[i] / total)[at]
                values = between_pixels(found[p.name], x, y)
                out[p.name][at] += values * (share if p.channels == 1 else share[:, None])
            elif p.name != "vector":
                stretch = np.linalg.norm(np.c_[places[i][target], np.ones(len(target[0]))], axis=1) if p.empty == np.inf else 1.0
                out[p.name][target] = found[p.name][nearest] * stretch
    blank = np.isnan(seen[..., 0])
    for p in wanted:
        out[p.name][blank] = p.empty
    if "normal" in out:
        length = np.linalg.norm(out["normal"], axis=-1, keepdims=True)
        out["normal"] = np.divide(out["normal"], length, out=np.zeros_like(out["normal"]), where=length > 0)
    return {name: np.ascontiguousarray(image, np.float32) for name, image in out.items()}


def _seen_by(seen: np.ndarray, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much a face counts in each pixel [h, w], and where the pixel lies in its plane [h, w, 2]."""
    with np.errstate(all="ignore"):
        turned = seen @ face.T
        place = turned[..., :2] / turned[..., 2:]
        angle = np.arctan(np.abs(place).max(-1))
        share = np.clip((np.pi / 4 + MARGIN - angle) / (2 * MARGIN), 0, 1)
        share = share * share * (3 - 2 * share)
    return np.where(turned[..., 2] > 0, np.nan_to_num(share), 0), place


def _of_face(exposure: Exposure, index: int) -> Exposure | None:
    """The exposure with the camera of one face instead of the panorama."""
    panoramas: list[Any] = [moment.camera for moment in exposure.moments]
    moments = tuple(replace(moment, camera=panorama.face(index)) for moment, panorama in zip(exposure.moments, panoramas))
    return replace(exposure, moments=moments, aperture=None) if exposure.moves else None
