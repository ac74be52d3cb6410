# SPDX-License-Identifier: GPL-3.0-or-later
"""Cuts out what stands before a plain background: one colour all around in all pictures, as renders without alpha have it.

Nothing tells how far away such a background is, so training would hang its colour in the air before each camera.
"""
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MOST, LEAST = 8 / 255, 2 / 255
"""Largest difference of a channel at which a pixel has the background's colour: in noisy pictures, and in exact ones."""
NOISE = 2.0, 0.95
"""Between both, so many times the difference that this share of the pictures' edges stays below."""
AROUND = 0.9
"""Share of the pixels at the pictures' edges that have this colour, at least: a subject may reach beyond some edges."""
FRAME = 0.5, 0.9
"""Where so much of the pictures and more stands out, and of it so much in all of them, a lens or an editor left a frame around them."""
REACH = 2
"""Pixels around one at the outline, among which is one that the subject covers."""
SIDE = 160
"""Outlines are compared at this size."""


@dataclass(frozen=True, eq=False)
class Plain:
    """A plain background: its colour [3], 0..1, and the largest difference of a channel at which a pixel is of it."""

    colour: np.ndarray
    within: float

    def cut_out(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The straight colours [h, w, 3] of a picture, and the share [h, w] of each pixel that the subject covers.

        At its outline colours are mixed: how far they are from the background's is compared with the pixel near them that differs most.
        """
        apart = _apart(image, self.colour)
        beyond = outside(apart <= self.within)
        outline = grown(beyond) & ~beyond
        share = np.where(outline, np.minimum(apart / np.maximum(_largest(apart), self.within), 1), ~beyond).astype(np.float32)
        straight = self.colour + (image - self.colour) / np.maximum(share, 1e-3)[..., None]
        return np.where(outline[..., None], np.clip(straight, 0, 1), image).astype(np.float32), share

    def tells(self, image: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Which pixels [h, w] of cut_out()'s result are surely the subject's, or beyond it.  Others have the background's colour inside of
        the outline, or lie beside such a one: they are a hole, or a part of that colour."""
        return ~grown((share >= 1) & (_apart(image, self.colour) <= self.within))


def background(pictures: Sequence[np.ndarray], valid: Sequence[np.ndarray | None]) -> Plain | None:
    """The plain background of pictures [h, w, 3], 0..1, whose pixels [h, w] are valid (None: all); None without one."""
    edges = [_edge(image.shape[:2]) & (True if known is None else known) for image, known in zip(pictures, valid)]
    wanted = AROUND * sum(_edge(image.shape[:2]).sum() for image in pictures)
    around = np.concatenate([image[edge] for image, edge in zip(pictures, edges)])
    if not 0 < wanted <= len(around):
        return None
    colour = np.median(around, axis=0).astype(np.float32)
    apart = _apart(around, colour)
    alike = apart[apart <= MOST]
    if len(alike) < wanted:
        return None
    times, share = NOISE
    found = Plain(colour, float(np.clip(times * np.quantile(alike, share), LEAST, MOST)))
    shown = [found.cut_out(image)[1] > 0 for image in pictures]
    shown = [each[np.ix_(*(np.arange(SIDE) * n // SIDE for n in each.shape))] for each in shown]
    large, same = FRAME
    framed = np.mean(shown) >= large and np.mean(np.all(shown, axis=0)) >= same * np.mean(shown)
    return found if np.any(shown) and not framed else None


def outside(mask: np.ndarray) -> np.ndarray:
    """The pixels of a mask [h, w] that are joined with the edge of the picture, through their sides."""
    found, count = mask & _edge(mask.shape), -1
    while count != (count := np.count_nonzero(found)):
        for lines, allowed in ((found, mask), (found[::-1], mask[::-1]), (found.T, mask.T), (found.T[::-1], mask.T[::-1])):
            for k in range(1, len(lines)):
                lines[k] |= lines[k - 1] & allowed[k]
    return found


def grown(mask: np.ndarray) -> np.ndarray:
    """The pixels [h, w] bool of a mask, and those beside them."""
    wide = np.pad(mask, 1)
    wide = wide[1:-1] | wide[:-2] | wide[2:]
    return wide[:, 1:-1] | wide[:, :-2] | wide[:, 2:]


def _edge(shape: tuple[int, ...]) -> np.ndarray:
    """The outermost pixels [h, w] of a picture."""
    edge = np.ones(shape, bool)
    edge[1:-1, 1:-1] = False
    return edge


def _apart(image: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """How far colours [..., 3] are from this one, in the channel in which they differ most."""
    red, green, blue = np.moveaxis(np.abs(image - colour), -1, 0)
    return np.maximum(np.maximum(red, green), blue)


def _largest(image: np.ndarray) -> np.ndarray:
    """The largest value within REACH pixels along rows and columns, for each pixel [h, w]."""
    for axis in (0, 1):
        wide = np.pad(image, [(REACH, REACH) if k == axis else (0, 0) for k in (0, 1)], "edge")
        image = np.lib.stride_tricks.sliding_window_view(wide, 2 * REACH + 1, axis).max(-1)
    return image
