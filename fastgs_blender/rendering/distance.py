# SPDX-License-Identifier: GPL-3.0-or-later
"""Antialiasing: splats are drawn as the capture's cameras sampled them, in views with coarser pixels and in views with finer ones.

The rasteriser's blur b gives every splat a smallest size of about a pixel.  Training adapts the Gaussians to that blur, with the pixels of
the capture's cameras.  Let a pixel of the view have the size p at a Gaussian, and let C be the coarsest and F the finest pixel that the
capture's cameras had there (in units of the model, F <= C).  S is the splat's covariance without the blur.  R is the pixel of one of the
capture's cameras in the view's place, but at least F and at most C.

    p > R    The small picture is to be the large one, averaged.  The blur of training shrinks with the picture, and a pixel averages with
             about `box`: the blur becomes  b q + box (1 - q),  q = R^2/p^2.  With all of b, edges would grow thick, and fine detail would
             be lost or flicker.  Opacity, and the cut of it, are multiplied by  sqrt(det(S + b q) / det(S + b q + box (1 - q))).
    p < R    Nobody saw what lies between the pixels of the capture: needles and gaps appear.  The blur becomes  b R^2/p^2:  as wide on
             the surface as in training, with the opacity that training gave it.
    p = R    Nothing changes, so from the capture's own cameras pictures keep every byte.

This is what Mip-Splatting (Yu et al. 2024) does with its two filters, for models that were trained without them.  F, its sampling limit, is
too sharp alone: where cameras stand at all distances, the farther ones shaped the Gaussians, each with its own blur.

Coarsest: the cameras count as the smallest ball around them, with the shortest of their focal lengths.  Finest: a camera i sees a
Gaussian, whose centre lies at the depth z_i and r_i away from the camera's axis, with pixels of

    p_i = (|z_i| + STEEP max(0, (r_i - reach s) / T_i - z_i)) / f_i,     s: its largest standard deviation,

which is its depth by its focal length where any of the splat may touch the picture (T_i: tangent from the axis to the farthest corner), and
grows outside, so that nothing jumps where a Gaussian leaves a picture.  F is the least of them, and never more than C.

Files that hold no cameras have one pixel for all views (Sampling.usual()).

R has the focal length of the cameras around the view, see Sampling.zoom_at().  Orthographic views stand nowhere: their R is p, but at least
F and at most C.
"""
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..model.surroundings import Viewpoint
from ..util.rotations import to_matrices, unit

MARGIN = 1.01
"""How many times larger or smaller a pixel must be before anything changes: a camera's numbers are rounded on their way through files."""
STEPS = 200
"""Steps towards the centre of the ball, which is found to about one part in as many."""
BOX = 0.1
"""What a pixel averages over, as a Gaussian's variance in square pixels (Mip-Splatting's 2D filter)."""
LENS = 0.01
"""How far from a view a lens counts that is e times as long, in squared radii of the ball."""
STEEP = 8.0
"""How fast a camera's pixels grow outside of its picture: an eighth of its half diagonal beyond, they count as twice as large."""


class Sampling(NamedTuple):
    """How the capture's cameras and a view sample a model, in the model's space.

    ball     the ball that holds the capture's cameras: centre, radius
    pixel    size of a pixel of the view at depth 1, or, orthographic, at any; 0: nothing changes with the distance
    coarse   C is `coarse` times the distance to the farthest point of the ball; 0: no cameras are known
    least    no camera's pixels count as finer
    reach    standard deviations from its centre at which a splat still touches a picture
    fades    whether anything changes where p > R
    zoom     the view's focal length, by that of the cameras around it; 1: none is known, or the view is orthographic
    cameras  [K, 8] float64: place, 1 / f_i, the axis (a unit vector), 1 / T_i
    """

    ball: tuple[float, float, float, float]
    pixel: float
    coarse: float
    least: float
    reach: float
    fades: bool
    zoom: float
    cameras: np.ndarray

    @property
    def row(self) -> tuple[float, ...]:
        """All but the cameras, as ten numbers for kernels."""
        return (*self.ball, self.pixel, self.coarse, self.least, self.reach, float(self.fades), self.zoom)

    @property
    def known(self) -> bool:
        """Whether anything is known of the capture's pixels."""
        return self.coarse > 0 or self.least > 0

    def coarsest(self, position: np.ndarray) -> np.ndarray:
        """C at positions [M, 3]."""
        away = np.linalg.norm(position - np.array(self.ball[:3]), axis=1)
        return np.maximum(self.least, self.coarse * (away + self.ball[3]))

    def finest(self, position: np.ndarray, largest: np.ndarray) -> np.ndarray:
        """F of Gaussians at positions [M, 3] with these largest standard deviations [M]."""
        found = self.coarsest(position)
        for camera in self.cameras:
            found = np.minimum(found, _pixel(camera, position, self.reach * largest)[0])
        return np.maximum(self.least, found)

    def usual(self, position: np.ndarray) -> np.ndarray:
        """One pixel [M] for all views of Gaussians at positions [M, 3]: the mean over the cameras that have the centre in their picture."""
        total, weights, most = np.zeros(len(position)), np.full(len(position), 1e-30), self.coarsest(position)
        for camera in self.cameras:
            pixel, inside = _pixel(camera, position, 0.0)
            weight = inside**2
            total, weights = total + weight * np.minimum(pixel, most), weights + weight
        return np.maximum(total / weights, self.least)

    def zoom_at(self, place: np.ndarray, focal: float) -> float:
        """`zoom` of a view at a place [3] with a focal length in pixels: what is nearer counts more, so a camera has its own there alone.

        The mean of 1 / f_i by the fourth power of nearness, of which lenses unlike the view's take a little, for cameras in one place.
        """
        away = ((self.cameras[:, :3] - place) ** 2).sum(1) / max(self.ball[3], 1e-12) ** 2
        weight = np.maximum(away + LENS * np.log(focal * self.cameras[:, 3]) ** 2, 1e-12) ** -2
        return float(focal * np.average(self.cameras[:, 3], weights=weight)) if len(weight) else 1.0

    def blurs(self, blur: float, position: np.ndarray, largest: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The blur [M] with which Gaussians at depths [M] before the view are drawn, and the one whose share of opacity they keep."""
        if not self.pixel > 0:
            return np.full(len(position), blur), np.full(len(position), blur)
        size = np.maximum(self.pixel * depth, 1e-30)
        ratio = np.maximum(self.finest(position, largest), np.minimum(self.zoom * size, self.coarsest(position))) / size
        small = blur * np.maximum(ratio / MARGIN, 1) ** 2
        shrunk = np.minimum(ratio * MARGIN, 1) ** 2 if self.fades else 1
        return small * shrunk + min(BOX, blur) * (1 - shrunk), small * shrunk

    def most_blur(self, blur: float, position: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """What the blur [M] is at most, found without a look at each camera."""
        if not self.pixel > 0:
            return np.full(len(position), blur)
        return blur * np.maximum(self.coarsest(position) / (MARGIN * np.maximum(self.pixel * depth, 1e-30)), 1) ** 2


OFF = Sampling((0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, False, 1.0, np.zeros((0, 8)))
"""Nothing changes with the distance."""


def _pixel(camera: np.ndarray, position: np.ndarray, radius: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """p_i [M] of a row of Sampling.cameras for balls at positions [M, 3], and what of it is depth by focal length: 1 in its picture."""
    away = position - camera[:3]
    z = away @ camera[4:7]
    r = np.sqrt(np.maximum((away**2).sum(1) - z**2, 0))
    size = np.abs(z) + STEEP * np.maximum((r - radius) * camera[7] - z, 0)
    return size * camera[3], np.abs(z) / np.maximum(size, 1e-30)


@lru_cache(maxsize=64)
def camera_ball(cameras: tuple[Viewpoint, ...]) -> tuple[float, float, float, float, float]:
    """A ball that holds all cameras: its centre and its radius in the model's space, and the shortest focal length in pixels.

    The ball is the smallest but for about 1 % (Badoiu and Clarkson 2003: step towards the farthest point, each time by less).
    """
    places = np.array([camera.position for camera in cameras])
    centre = places.mean(0)
    for step in range(STEPS):
        centre = centre + (places[np.linalg.norm(places - centre, axis=1).argmax()] - centre) / (step + 2)
    radius = float(np.linalg.norm(places - centre, axis=1).max())
    x, y, z = map(float, centre)
    return (x, y, z, radius, min(float(np.sqrt(camera.fx * camera.fy)) for camera in cameras))


@lru_cache(maxsize=64)
def camera_rows(cameras: tuple[Viewpoint, ...], blur: float, alpha_cut: float) -> tuple[np.ndarray, float]:
    """Sampling.cameras and Sampling.reach, for splats that end where their opacity falls to alpha_cut.

    Where projections are linearised nearer than at the centre (oracle.nearness), splats are up to twice as large; the Jacobian's third
    column adds up to 1.3 T to its length.
    """
    end = float(np.sqrt(-2 * np.log(alpha_cut)))
    rows, widest = [], 0.0
    for camera in cameras:
        axis = to_matrices(unit(np.array(camera.rotation))[None])[0][:, 2]
        corner = np.hypot(max(abs(camera.cx), abs(camera.width - camera.cx)) / camera.fx,
                          max(abs(camera.cy), abs(camera.height - camera.cy)) / camera.fy)
        tangent = corner + end * np.sqrt(2 * blur) / min(camera.fx, camera.fy)
        rows.append([*camera.position, 1 / np.sqrt(camera.fx * camera.fy), *axis, 1 / tangent])
        widest = max(widest, tangent)
    return np.array(rows), 2 * end * float(np.sqrt(2 + (1.3 * widest) ** 2))


def share(small: np.ndarray, blur: np.ndarray, sharp: np.ndarray, trace: np.ndarray) -> np.ndarray:
    """What an opacity is multiplied by: sqrt(det(S + small) / det(S + blur)); sharp, trace: determinant and trace of S."""
    before, after = (sharp + b * trace + b**2 for b in (small, blur))
    return np.where(small < blur, np.sqrt(np.divide(before, after, out=np.ones_like(after), where=after > 0)), 1.0)
