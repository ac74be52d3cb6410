# SPDX-License-Identifier: GPL-3.0-or-later
"""What passes look like on a screen: colours [h, w, 3] for their numbers, 0 to 1 and sRGB-encoded, black where there is nothing.

Numbers without natural limits, such as depths, are spread over what the picture holds, but for a few stray pixels.
"""
import numpy as np

STRAY = 1.0
"""Percent of the pixels at each end beyond which a range of numbers does not reach."""
STILL = 1.0
"""Pixels a frame that a picture's fastest motion counts as at the least: what hardly moves stays dark."""
HEAT = np.array([[0, 0, 0], [0.15, 0.1, 0.5], [0.7, 0.15, 0.45], [0.98, 0.55, 0.15], [1, 1, 0.75]])
"""Colours from none to the most."""
GOLDEN = 0.6180339887498949
"""The golden ratio's fraction: its multiples, modulo 1, lie far apart."""


def grey(values: np.ndarray) -> np.ndarray:
    """Numbers [h, w] that lie between 0 and 1."""
    return np.repeat(np.clip(values, 0, 1)[..., None], 3, -1)


def near_to_far(depth: np.ndarray) -> np.ndarray:
    """Depths [h, w], infinite where nothing is: what is near is bright, and the farthest is still brighter than nothing.

    Greys go by ratios of depths: before a sky that is far away, what is near still has shades.
    """
    there = np.isfinite(depth)
    ratios = np.log(np.where(there, np.maximum(depth, 1e-6), 1))
    return np.where(there[..., None], grey(1 - 0.85 * _spread(ratios, there)), 0)


def directions(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors [h, w, 3], 0 where nothing is: -1 to 1 becomes 0 to 1."""
    return np.where(vectors.any(-1, keepdims=True), np.clip(0.5 + 0.5 * vectors, 0, 1), 0)


def places(points: np.ndarray) -> np.ndarray:
    """Points [h, w, 3], 0 where nothing is: each axis from dark to bright over the picture."""
    there = points.any(-1)
    return np.where(there[..., None], np.stack([0.1 + 0.9 * _spread(points[..., i], there) for i in range(3)], -1), 0)


def motion(vectors: np.ndarray) -> np.ndarray:
    """Blender's speed vectors [h, w, 4]: the hue is where to a pixel goes in the next frame, the brightness how fast."""
    x, y = -vectors[..., 2], -vectors[..., 3]
    speed = np.hypot(x, y)
    moving = speed[speed > 0]
    most = max(float(np.percentile(moving, 100 - STRAY)) if moving.size else 0.0, STILL)
    return _hues(np.arctan2(y, x) / (2 * np.pi)) * np.clip(speed / most, 0, 1)[..., None]


def numbered(numbers: np.ndarray) -> np.ndarray:
    """Whole numbers [h, w]: a colour for each, black for 0."""
    return np.where(numbers[..., None] != 0, _hues(GOLDEN * np.round(numbers).astype(np.float64)), 0)


def mattes(level: np.ndarray) -> np.ndarray:
    """A level of Cryptomatte [h, w, 4]: a colour for each object, as bright as it covers the pixel."""
    bits = np.ascontiguousarray(level[..., 0::2], np.float32).view(np.uint32)
    return np.clip((_hues(GOLDEN * (bits >> np.uint32(3)) % 1) * level[..., 1::2, None]).sum(-2), 0, 1)


def heat(values: np.ndarray) -> np.ndarray:
    """Counts [h, w] of 0 or more: from black over blue and red to nearly white, the most of the picture."""
    many = values[values > 0]
    share = np.clip(values / max(float(np.percentile(many, 100 - STRAY)) if many.size else 0.0, 1e-30), 0, 1)
    return np.stack([np.interp(share, np.linspace(0, 1, len(HEAT)), HEAT[:, i]) for i in range(3)], -1)


def _spread(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """0 to 1 from the lowest to the highest of the values that are there, but for stray ones; 0 where they are all one, or elsewhere."""
    if not there.any():
        return np.zeros(values.shape)
    low, high = np.percentile(values[there], (STRAY, 100 - STRAY))
    return np.clip((np.where(there, values, low) - low) / max(high - low, 1e-30), 0, 1)


def _hues(turns: np.ndarray) -> np.ndarray:
    """Bright colours [..., 3] of hues in turns of the wheel, 0 is red."""
    return np.clip(np.abs((turns[..., None] + np.array([0, 2 / 3, 1 / 3])) % 1 * 6 - 3) - 1, 0, 1)
