# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks: Gaussians that were hidden by hand, as a short text; and which of them lie under a brush."""
from __future__ import annotations

import base64
import binascii
import zlib
from dataclasses import dataclass

import numpy as np

from ..cameras.camera import Camera
from ..util.backends import load_backend


@dataclass(frozen=True)
class Box:
    """A rectangle in the picture, from low to high, in pixels."""

    low: tuple[float, float]
    high: tuple[float, float]

    def holds(self, pixel: np.ndarray) -> np.ndarray:
        """Which of the pixels [M, 2] lie in it: [M] bool."""
        return ((pixel >= self.low) & (pixel <= self.high)).all(1)


@dataclass(frozen=True)
class Stroke:
    """What a round brush went over: middles, (x, y) in pixels, between which it moved straight, and its radius."""

    middles: tuple[tuple[float, float], ...]
    radius: float

    def holds(self, pixel: np.ndarray) -> np.ndarray:
        """Which of the pixels [M, 2] lie under it: [M] bool."""
        out = np.zeros(len(pixel), bool)
        for start, end in zip(self.middles, self.middles[1:] or self.middles, strict=False):
            along, offset = np.subtract(end, start), pixel - start
            share = np.clip(offset @ along / max(along @ along, 1e-12), 0, 1)
            out |= ((offset - share[:, None] * along) ** 2).sum(1) <= self.radius**2
        return out


def under(instance, camera: Camera, shape: Box | Stroke, backend: str = "auto") -> np.ndarray:
    """Indices of a ViewedInstance's Gaussians that the camera shows and whose centres lie in a shape, however deep."""
    index = load_backend(backend).front_to_back([instance], camera)
    model = instance.model
    moved, _ = model.basis.evaluate(model.motion[index], instance.t, model.mu_tau[index].astype(np.float64))
    to_camera = instance.model_to_camera
    pixel = camera.pixels((model.position[index] + moved) @ to_camera[:3, :3].T + to_camera[:3, 3])
    return np.sort(index[shape.holds(pixel)])


def pack_mask(bits: np.ndarray) -> str:
    """The text of a mask [N] bool; "" where nothing is hidden."""
    if not bits.any():
        return ""
    return f"{len(bits)} {base64.b85encode(zlib.compress(np.packbits(bits).tobytes(), 9)).decode()}"


def unpack_mask(text: str, count: int) -> np.ndarray:
    """The mask [count] bool of a text.  A text that is none, or belongs to another number of Gaussians, hides nothing."""
    length, _, packed = text.partition(" ")
    size = -(-count // 8)
    if length == str(count):
        try:
            found = zlib.decompressobj().decompress(base64.b85decode(packed), size + 1)
        except (ValueError, zlib.error, binascii.Error):
            found = b""
        if len(found) == size:
            return np.unpackbits(np.frombuffer(found, np.uint8), count=count).astype(bool)
    return np.zeros(count, bool)
