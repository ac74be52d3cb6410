# SPDX-License-Identifier: GPL-3.0-or-later
"""The target of a training step: a shot's pixels at the step's size, the background, and the weight of each pixel."""
from dataclasses import dataclass, replace

import numpy as np

from ...cameras.camera import Camera
from ...captures.capture import Capture, Shot
from ...captures.pixels.store import Pixels
from .schedule import BACKGROUND, generator
from .settings import Settings

FIXED = {"black": 0.0, "white": 1.0}
FOREGROUND = 2.0
"""How many times what a mask shows counts."""
WHOLE = 0.99
"""Cover of a pixel from which on its colour is that of the subject alone."""


@dataclass(frozen=True, eq=False)
class Target:
    """rgb [h, w, 3] over `background`; stored: the same as uint8, in 255ths, where it is one of the files' own pictures; weight [h, w] or
    None; opaque: the picture shows something in every pixel; least [h, w, 3] bool, where rgb is only a lower bound of the colour, or None:
    nowhere."""

    camera: Camera
    t: float
    rgb: np.ndarray
    stored: np.ndarray | None
    weight: np.ndarray | None
    background: np.ndarray | None
    opaque: bool
    least: np.ndarray | None = None


def use_of_mask(settings: Settings, capture: Capture, shot: Shot, mask: np.ndarray | None) -> str:
    """How a shot's mask is used: cut, weight, only, off where it has none; around: a scan shows the place around its subject."""
    if mask is None or settings.masks == "off":
        return "off"
    if shot.place and shot.mask is not None and capture.mask_means == "foreground":
        return "around"
    if settings.masks != "auto":
        return settings.masks
    if shot.mask is None:
        return "cut"
    return "only" if capture.mask_means == "valid" else "weight"


def cover_of(use: str, pixels: Pixels) -> np.ndarray | None:
    """The share of each pixel [h, w] that the model must cover; None: all of it.  use: the result of use_of_mask()."""
    return pixels.mask if use == "cut" else None if use == "off" else pixels.alpha


def target(capture: Capture, pixels: Pixels, shot: Shot, settings: Settings, reduction: int, *key: int,
           moving: np.ndarray | None = None, hidden: np.ndarray | None = None) -> Target:
    """The target of a shot with these pixels (captures.pixels.store.Pixels).

    key     seeds the random background, where the settings ask for one
    moving  [h, w] how much each pixel moves (MovingPixels.share), or None: not known
    hidden  [h, w] bool, pixels that do not count, or None: all do
    """
    assert shot.camera is not None
    rgb, mask = smaller(pixels.rgb, reduction), None if pixels.mask is None else smaller(pixels.mask, reduction)
    use = use_of_mask(settings, capture, shot, mask)
    background = weight = None
    cover = cover_of(use, pixels)
    if cover is not None:
        cover = smaller(cover, reduction)
        kind = "random" if settings.background == "auto" else settings.background
        value = FIXED.get(kind)
        background = np.full(3, value, np.float32) if value is not None else \
            generator(settings.seed, BACKGROUND, *key).uniform(0, 1, 3).astype(np.float32)
        rgb = rgb * cover[..., None] + (1 - cover)[..., None] * background
    elif FIXED.get(settings.background):
        background = np.full(3, FIXED[settings.background], np.float32)
    if use == "weight" and mask is not None:
        weight = 1 + (FOREGROUND - 1) * mask
    elif use == "only":
        weight = mask
    elif use == "around" and mask is not None:
        weight = np.float32(1) - mask
    elif use == "off" and moving is not None:
        weight = 1 + (settings.moving_weight - 1) * smaller(moving, reduction)
    if hidden is not None:
        shown = smaller((~hidden).astype(np.float32), reduction)
        weight = shown if weight is None else weight * shown
    if pixels.valid is not None:
        inside = smaller(pixels.valid.astype(np.float32), reduction)
        weight = inside if weight is None else weight * inside
    least = None
    if pixels.least is not None:
        least = smaller(pixels.least.astype(np.float32), reduction) > 0
        least = least if cover is None else least & (cover[..., None] > WHOLE)
    return Target(small_camera(shot.camera, reduction), shot.t, np.ascontiguousarray(rgb, np.float32),
                  pixels.stored if reduction == 1 and cover is None else None,
                  None if weight is None else np.ascontiguousarray(weight, np.float32),
                  background if background is not None and background.any() else None, cover is None and use in ("off", "weight", "around"),
                  least)


def smaller(image: np.ndarray, reduction: int) -> np.ndarray:
    """Means over blocks of r x r pixels [h // r, w // r, ...]; incomplete blocks at the right and at the bottom are left out."""
    if reduction == 1:
        return image
    h, w = (n // reduction for n in image.shape[:2])
    if not h or not w:
        return image
    blocks = image[:h * reduction, :w * reduction].reshape(h, reduction, w, reduction, *image.shape[2:])
    return blocks.mean((1, 3), dtype=np.float32)


def small_camera(camera: Camera, reduction: int) -> Camera:
    """The camera of smaller(image, reduction)."""
    w, h = camera.width // reduction, camera.height // reduction
    if reduction == 1 or not h or not w:
        return camera
    return replace(camera, width=w, height=h, fx=camera.fx / reduction, fy=camera.fy / reduction, cx=camera.cx / reduction,
                   cy=camera.cy / reduction, window=(0, 0, w, h))
