# SPDX-License-Identifier: GPL-3.0-or-later
"""Lens distortion, its inverse, and the pinhole camera that replaces a lens.

A lens maps a pinhole's image plane (x/z, y/z) to the distorted plane; the intrinsics then make pixels of it, centres at +0.5:
u = fx (x' + skew y') + cx, v = fy y' + cy.  OpenCV documents its models with pixel centres at whole numbers: whoever reads such a
calibration adds 0.5 to its principal point.

opencv   radial-tangential (OpenCV "Camera Calibration and 3D Reconstruction"), r^2 = x^2 + y^2:
         x' = x g + 2 p1 x y + p2 (r^2 + 2 x^2), y' = y g + p1 (r^2 + 2 y^2) + 2 p2 x y,
         g = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
fisheye  OpenCV's fisheye (Kannala-Brandt): angle a = atan r, x' = x / r * a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..util.errors import FastGSError
from .camera import Camera

COEFFICIENTS = {"pinhole": (), "opencv": ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"), "fisheye": ("k1", "k2", "k3", "k4")}
LARGEST_ANGLE = np.radians(89)
"""Rays further off the axis than this have no place on a pinhole's image plane."""
SMALLEST_FOCAL = 0.5
"""Of the lens' focal length: a pinhole that is chosen automatically shows the middle at half its resolution at worst."""


class Intrinsics(NamedTuple):
    """Focal lengths and principal point in pixels from the top left corner (pixel centres at +0.5), and the image's size."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int


@dataclass(frozen=True)
class Lens:
    """A model of distortion: `model` is "pinhole", "opencv" or "fisheye", `k` its k1, k2, ..., `p` opencv's p1 and p2."""

    model: str = "pinhole"
    k: tuple[float, ...] = ()
    p: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0

    def __post_init__(self) -> None:
        if self.model not in COEFFICIENTS:
            raise FastGSError(f"the lens model {self.model!r} is not known; there are {', '.join(COEFFICIENTS)}.")
        k, p = tuple(float(v) for v in self.k), tuple(float(v) for v in self.p)
        names = COEFFICIENTS[self.model]
        if len(k) > sum(name.startswith("k") for name in names) or len(p) != 2 or not np.isfinite([*k, *p, self.skew]).all():
            raise FastGSError(f"the lens model {self.model!r} takes the finite coefficients {', '.join(names) or '(none)'}.")
        object.__setattr__(self, "k", k + (0.0,) * (6 - len(k)))
        object.__setattr__(self, "p", p)

    @classmethod
    def named(cls, model: str, coefficients: dict, skew: float = 0.0) -> Lens:
        """The lens with these named coefficients (k1 ..., p1, p2), those not named being 0."""
        names = COEFFICIENTS.get(model, ())
        unknown = set(coefficients) - set(names or coefficients)
        if unknown:
            raise FastGSError(f"the lens model {model!r} has no {', '.join(sorted(unknown))}; it has {', '.join(names)}.")
        try:
            values = {name: float(value) for name, value in coefficients.items()}
        except (TypeError, ValueError) as error:
            raise FastGSError(f"the coefficients of the lens model {model!r} must be numbers.") from error
        k = [values.get(name, 0.0) for name in names or () if name.startswith("k")]
        return cls(model, tuple(k), (values.get("p1", 0.0), values.get("p2", 0.0)), skew)

    @property
    def is_pinhole(self) -> bool:
        """Whether straight lines stay straight and pixels need no moving."""
        return self.model != "fisheye" and not any(self.k) and not any(self.p) and not self.skew

    def distort(self, xy: ArrayLike) -> np.ndarray:
        """Points [..., 2] of a pinhole's image plane on the distorted plane; NaN where the model folds over or has no image."""
        xy = np.asarray(xy, np.float64)
        x, y = xy[..., 0], xy[..., 1]
        r = np.hypot(x, y)
        with np.errstate(all="ignore"):
            r = np.where(r <= self._table[0][-1], r, np.nan)
            factor = np.where(r > 1e-12, self._radius(r) / r, np.where(np.isnan(r), np.nan, 1.0))
            x, y = self._shift(x, y, factor)
        return np.stack([x + self.skew * y, y], -1)

    def undistort(self, xy: ArrayLike) -> np.ndarray:
        """The inverse of distort(), to 1e-9; NaN where nothing in front of the lens is seen at that place."""
        xy = np.asarray(xy, np.float64)
        target = np.stack([xy[..., 0] - self.skew * xy[..., 1], xy[..., 1]], -1)
        rd = np.hypot(target[..., 0], target[..., 1])
        inside, outside = self._table
        with np.errstate(all="ignore"):
            guess = np.where(rd > 1e-12, np.interp(rd, outside, inside) / rd, 1.0)[..., None] * target
            for _ in range(12):  # Newton from a guess that ignores the tangential part
                guess = guess - self._newton_step(guess, target)
            wrong = np.abs(self._plain(guess) - target).max(-1) > 1e-9
            wrong |= ~(np.hypot(guess[..., 0], guess[..., 1]) <= inside[-1])
        return np.where(wrong[..., None], np.nan, guess)

    def _newton_step(self, at: np.ndarray, target: np.ndarray, step: float = 1e-6) -> np.ndarray:
        off = self._plain(at) - target
        dx = (self._plain(at + [step, 0]) - self._plain(at - [step, 0])) / (2 * step)
        dy = (self._plain(at + [0, step]) - self._plain(at - [0, step])) / (2 * step)
        det = dx[..., 0] * dy[..., 1] - dx[..., 1] * dy[..., 0]
        x = off[..., 0] * dy[..., 1] - off[..., 1] * dy[..., 0]
        y = off[..., 1] * dx[..., 0] - off[..., 0] * dx[..., 1]
        return np.stack([x, y], -1) / det[..., None]

    def _plain(self, xy: np.ndarray) -> np.ndarray:
        """distort() without the skew and without its limit."""
        x, y = xy[..., 0], xy[..., 1]
        r = np.hypot(x, y)
        return np.stack(self._shift(x, y, np.where(r > 1e-12, self._radius(r) / r, 1.0)), -1)

    def _radius(self, r: np.ndarray) -> np.ndarray:
        """Radius on the distorted plane of a radius on the image plane."""
        k = self.k
        if self.model == "fisheye":
            a = np.arctan(r)
            s = a * a
            return a * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
        s = r * r
        return r * (1 + s * (k[0] + s * (k[1] + s * k[2]))) / (1 + s * (k[3] + s * (k[4] + s * k[5])))

    def _shift(self, x: np.ndarray, y: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p1, p2 = self.p
        s = x * x + y * y
        return x * factor + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * factor + p1 * (s + 2 * y * y) + 2 * p2 * x * y

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Radii on the image plane and on the distorted plane, as far out as the latter grow."""
        inside = np.tan(np.linspace(0, LARGEST_ANGLE, 8192))
        with np.errstate(all="ignore"):
            outside = self._radius(inside)
        grows = np.diff(outside) > 0
        end = len(inside) if grows.all() else int(np.argmin(grows)) + 1
        return inside[:end], outside[:end]


def undistortion_map(lens: Lens, source: Intrinsics, camera: Camera) -> np.ndarray:
    """Where in the source picture each pixel of the camera's picture comes from.

    source  the lens' own (fx, fy, cx, cy, width, height)
    Returns [h, w, 2] float32: x and y in source pixels, centres at +0.5; NaN where the lens has no image of the pixel's ray.
    """
    fx, fy, cx, cy = source[:4]
    xy = np.empty((camera.height, camera.width, 2))
    with np.errstate(over="ignore", invalid="ignore"):  # a lens may throw rays as far as it likes
        xy[..., 0] = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
        xy[..., 1] = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy)[:, None]
        return (lens.distort(xy) * [fx, fy] + [cx, cy]).astype(np.float32)


def inside(source_positions: np.ndarray, width: int, height: int, tolerance: float = 0.0) -> np.ndarray:
    """Mask [h, w], True where undistortion_map()'s positions lie within a source picture of that size."""
    x, y = source_positions[..., 0], source_positions[..., 1]
    return (x >= -tolerance) & (x <= width + tolerance) & (y >= -tolerance) & (y <= height + tolerance)


def pinhole_for(lens: Lens, source: Intrinsics, world_to_camera: np.ndarray, scale: float = 1.0, focal: float | None = None) -> Camera:
    """The pinhole camera whose picture replaces the lens', of the source's size times `scale`.

    focal   factor on the focal lengths, with the principal point kept; what is then outside the lens' picture is masked.  None: the
            widest field of view that has no empty border, but never less than half the focal length; square pixels stay square;
            a pinhole stays as it is.
    """
    source = Intrinsics(*source)
    w, h = max(1, round(source.width * scale)), max(1, round(source.height * scale))
    fx, fy, cx, cy = source[:4]
    if focal is not None:
        fx, fy = fx * focal, fy * focal
    elif not lens.is_pinhole:
        fx, fy, cx, cy = _without_border(lens, source)
    sx, sy = w / source.width, h / source.height
    return Camera(w, h, fx * sx, fy * sy, cx * sx, cy * sy, world_to_camera)


@lru_cache(maxsize=256)  # many pictures are taken through one lens
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _without_border(lens: Lens, source: Intrinsics) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a pinhole of the source's size that shows the largest rectangle between the edges of the lens' picture."""
    fx, fy, cx, cy, width, height = source
    along = np.linspace(0, 1, 257)

    def edge(x: ArrayLike, y: ArrayLike) -> np.ndarray:
        pixels = np.stack(np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64)), -1)
        return lens.undistort((pixels - [cx, cy]) / [fx, fy])

    left, right = edge(0, along * height)[:, 0], edge(width, along * height)[:, 0]
    top, bottom = edge(along * width, 0)[:, 1], edge(along * width, height)[:, 1]
    centre, factor = np.array([width / 2 - cx, height / 2 - cy]) / [fx, fy], SMALLEST_FOCAL
    if all(np.isfinite(side[128]) for side in (left, right, top, bottom)):  # an edge's ends may be places that no ray reaches
        left, right, top, bottom = np.nanmax(left), np.nanmin(right), np.nanmax(top), np.nanmin(bottom)
        centre = np.array([left + right, top + bottom]) / 2
        factor = max(width / (fx * (right - left)), height / (fy * (bottom - top)), factor)
    around = np.concatenate([np.c_[along, 0 * along], np.c_[along, 0 * along + 1], np.c_[0 * along, along], np.c_[0 * along + 1, along]])
    for _ in range(200):
        xy = centre + (around - 0.5) * [width / (fx * factor), height / (fy * factor)]
        if inside(lens.distort(xy) * [fx, fy] + [cx, cy], width, height, 1e-6).all():
            break
        factor *= 1.005
    return fx * factor, fy * factor, *(np.array([width, height]) / 2 - centre * [fx * factor, fy * factor])
