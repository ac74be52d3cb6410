# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges of meshes' shadows on splats, as sharp as pixels are.

relight.py asks for the shadows of each Gaussian, so an edge is as ragged as Gaussians are large.  Here the points that pixels show ask the
lamps again.  Around an edge the splats are drawn once more, without the meshes' shadows, and the pixel becomes, in light,

    (1 - c) before + c bright (1 - sum over lamps q (1 - m))

before  the picture with the Gaussians' own shadows
bright  the one without
q       which share of its light is a lamp's, as far as meshes can take it away; the mean over the pixel's splats
m       which share of the lamp's light comes past the meshes to the pixel's point
c       1 where the pixel and those around it show one surface each; 0 where they show several, one behind the other: there Gaussians
        know better, as they do on a floor that was filmed from one height, whose Gaussians lie at many depths

The passes of meshes' shadows become m in the same way.  A lamp of n points makes a soft shadow of n steps.  So m is averaged over as large
a square of pixels as it differs in by no more than two steps: a sharp edge stays, and no steps are seen.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..util.threads import PIECE, beside, joined, ranges, run
from .colour import linear_to_srgb, scene_linear, straight
from .exposure import Exposure
from .instances import Instance, ViewedInstance
from .layout import Layout
from .quantities import Quantity, Shown
from .seen import Seen, past_meshes
from .sheets import AROUND_ONE, WIDEST, believed, smooth
from .ways import without_colours

AROUND = 2.0
"""Standard deviations around Gaussians with an edge in which pixels are looked at again."""
SHARP = 0.01
"""Shares of light from 0 and 1 on that are those of an edge."""
FAINT = 1e-3
"""Alpha up to which nothing is seen of a pixel."""
NUMBERS = 5
"""Numbers of a lamp (Taken.numbers)."""
BLOCK = 8
"""Pixels of the side of the squares beside which there must be an edge for pixels to ask; a coarse picture has one pixel for each."""
MOST = 8
"""Samples of an exposure in which edges are looked at."""


@dataclass(frozen=True, eq=False)
class Taken:
    """What meshes take from the light of the M Gaussians of an instance that are lit.

    bright   the Instance of these, without the meshes' shadows
    numbers  [M, NUMBERS, L] of each lamp: which share of the light in each channel meshes can take away; which share of the lamp's light
             comes past the meshes, and past the splats
    normal   [M, 3] in the world
    wide     [M] standard deviations along the view
    edges    whether a shadow's edge lies on any of them
    """

    bright: Instance
    numbers: np.ndarray
    normal: np.ndarray
    wide: np.ndarray
    edges: bool


def on_edge(past: np.ndarray) -> np.ndarray:
    """Where a part of a lamp's light comes past the meshes."""
    return (past > SHARP) & (past < 1 - SHARP)


def sharpened(draw: Callable[[], Any], needs: set[str], instances: list[ViewedInstance], camera: Camera, settings: Any, backend: Any,
              holdout: np.ndarray | None, exposure: Exposure | None, averaged: bool) -> Any:
    """A picture (passes.Blended) of lit instances with sharp edges of meshes' shadows: its colours, and the sums of the passes that show
    shadows.  Edges are looked for while the picture is drawn.

    draw      draws the picture, with what it needs
    settings  passes.PassSettings
    averaged  whether it is the average over the exposure; else it is its middle
    """
    lamps = max((each.taken.numbers.shape[2] for each in instances if each.taken and each.taken.edges), default=0)
    names = [(name + (f"_{level + 1}" if level else ""), name, level) for level in range(lamps) for name in ("mesh_shadow", "lamp_shadow")]
    wanted = [each for each in names if each[0] in needs] if not averaged else []
    coloured = "rgb" in needs and any(each.settings.shadows > 0 for each in instances)
    if not lamps or settings.light is None or not (coloured or wanted):
        return draw()
    space = "srgb" if {each.model.colour_space for each in instances} == {"srgb"} else "linear"
    bright = [replace(each.taken.bright, taken=each.taken).viewed(camera) if each.taken else each for each in instances]
    kinds = NUMBERS if any(name == "lamp_shadow" for _, name, _ in wanted) else NUMBERS - 1
    around = partial(_Drawn, light=settings.light, lamps=lamps, kinds=kinds, backend=backend, by_pixel=settings.by_pixel, space=space)
    if not averaged or exposure is None:
        seen = (bright, camera, holdout) if exposure is None else exposure.middle(bright, camera, holdout)
        drawn, blended = beside(lambda: around(*seen), draw)
        if not drawn.pixels:
            return blended
        at, sums, alpha, one = drawn.pixels, dict(blended.sums), blended.alpha[drawn.pixels][:, None], drawn.one[:, None]
        for name, kind, level in wanted:
            now = drawn.past[:, level] * (1 if kind == "mesh_shadow" else drawn.splats[:, level])
            sums[name] = sums[name].copy()
            sums[name][at] += one * (alpha * now[:, None] - sums[name][at])
        if not coloured:
            return replace(blended, sums=sums)
        return replace(blended, sums=sums, rgb=_changed(
            blended, at, space, lambda before, rows: before + one[rows] * (drawn.light[rows] - before)))

    def samples() -> np.ndarray:
        """The change of the average's light [h, w, 3]."""
        change, levels = np.zeros((*camera.window[:1:-1], 3)), min(exposure.levels, int(np.log2(MOST)))
        for sample in exposure.samples(levels):
            if sample.weights[levels]:
                (moved, eye), (lit, _) = (exposure.scene(each, camera, sample.time, sample.point) for each in (bright, instances))
                drawn = around(moved, eye, exposure.holdout(holdout, sample.time))
                if drawn.pixels:
                    change[drawn.pixels] += sample.weights[levels] * drawn.one[:, None] * (drawn.light - drawn.of(lit))
        return change

    change, blended = beside(samples, draw)
    at = np.nonzero(change.any(-1))
    change = change[at]
    return replace(blended, rgb=_changed(blended, at, space, lambda before, rows: before + change[rows]))


def _changed(blended: Any, at: tuple[np.ndarray, ...], space: str, light: Callable[[np.ndarray, slice], np.ndarray]) -> np.ndarray:
    """A picture [h, w, 3], some of whose pixels have another light now: light(before [R, 3], which of them) -> [R, 3]."""
    out = blended.rgb.copy()

    def piece(first: int, last: int) -> None:
        rows = slice(first, last)
        where = at[0][rows], at[1][rows]
        alpha = blended.alpha[where]
        linear = np.maximum(light(scene_linear(blended.rgb[where], alpha, space), rows), 0).astype(out.dtype)
        out[where] = linear_to_srgb(straight(linear, alpha)) * alpha[:, None] if space == "srgb" else linear

    run(piece, ranges(len(at[0]), PIECE))
    return out


@dataclass(frozen=True, eq=False)
class _Shown:
    """What P pixels of a window show.

    eye       the camera with that window
    at        [P] which pixels, one row of the window after the other
    rgb       [P, 3] colours, and their alpha [P]
    channels  [P, C] sums of quantities, whose places have names
    """

    eye: Camera
    at: np.ndarray
    rgb: np.ndarray
    alpha: np.ndarray
    channels: np.ndarray
    places: dict[str, slice]

    def part(self, rows: Any) -> _Shown:
        """Some of the pixels: their numbers, or a slice."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ("at", "rgb", "alpha", "channels")})

    def sums(self, name: str) -> np.ndarray:
        """A quantity's sums [P, K]."""
        return self.channels[:, self.places[name]]

    def plane(self) -> np.ndarray:
        """The planes of depth [3, P] (Seen)."""
        return np.divide(self.sums("plane").T, self.alpha, order="C", dtype=np.float64)

    def seen(self) -> Seen:
        """The surfaces that the pixels show."""
        normal = np.ascontiguousarray(self.sums("normal").T)
        normal /= np.maximum(np.sqrt(np.einsum("kp,kp->p", normal, normal)), 1e-30)
        return Seen(self.eye, np.divmod(self.at, self.eye.window[2]), self.plane(), normal)

    def one(self, bias: float) -> np.ndarray:
        """Whether each pixel shows one surface [P], from 0 to 1."""
        x, y = (axis[rows] for axis, rows in zip(self.eye.from_middle(), np.divmod(self.at, self.eye.window[2])[::-1], strict=True))
        plane, wide = self.plane(), self.sums("wide")
        depth, core = plane[0] + plane[1] * x + plane[2] * y, np.maximum(wide[:, 1], 1e-30).astype(np.float64)
        off = np.abs(depth - self.sums("depth")[:, 0] / core)
        return np.clip(2 - off / (0.5 * (wide[:, 0] / core) + 2 * bias), 0, 1) * (depth > self.eye.near)

    def numbers(self, kinds: int) -> np.ndarray:
        """The first `kinds` numbers of lamps (Taken.numbers): [P, kinds, L]."""
        numbers = self.sums("numbers")
        return numbers.reshape(len(numbers), kinds, numbers.shape[1] // kinds) / self.alpha[:, None, None]


class _Drawn:
    """A sample's picture around the edges of shadows.

    pixels  rows and columns [P] of the window that it has; empty: there are none
    one     [P] whether each shows one surface, from 0 to 1
    light   [P, 3] its colour with sharp edges, in light
    past    [P, L] the share of each lamp's light that comes past the meshes, and
    splats  [P, L] past the splats, if `kinds` of a lamp's numbers, from the first on, have it
    """

    pixels: tuple[np.ndarray, ...] = ()

    def __init__(self, instances: list[ViewedInstance], camera: Camera, holdout: np.ndarray | None, light: Any, lamps: int,
                 kinds: int, backend: Any, by_pixel: bool, space: str):
        self.holdout, self.backend, self.by_pixel, self.space = holdout, backend, by_pixel, space
        eye = _around(instances, _wider(camera))
        found = eye and _near_edges(instances, eye, lamps, backend)
        if not found:
            return
        self._eye, self._near = eye, near = found
        of_lamps = Quantity(kinds * lamps, lambda shown: _numbers(shown, lamps)[:, :kinds].reshape(-1, kinds * lamps))
        normals = Quantity(3, lambda shown: shown.instance.taken.normal[shown.index] if shown.instance.taken else
                           np.zeros((len(shown.index), 3)))
        shown = self._shown(instances, {"wide": Quantity(2, _wide, core=True), "numbers": of_lamps, "normal": normals}, True)
        at = np.flatnonzero(near.ravel() & (shown.alpha > FAINT))
        one, = joined(lambda a, b: (shown.part(at[a:b]).one(light.bias),), len(at))
        one = believed(one, np.divmod(at, eye.window[2]))
        rows = np.flatnonzero(one > SHARP)
        at, one = at[rows], one[rows]

        def facing(first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            seen = shown.part(at[first:last]).seen()
            rows = np.flatnonzero(seen.faces(light.lamps))
            return rows + first, seen.plane[:, rows], seen.normal[:, rows]

        rows, plane, normal = joined(facing, len(at))
        if not len(rows):
            return
        at, one = at[rows], one[rows]
        pixels = np.divmod(at, eye.window[2])
        past, points = past_meshes(light, lamps, Seen(eye, pixels, plane, normal), backend)
        left = np.flatnonzero((points == 0).any(1))
        past[left] = np.where(points[left] > 0, past[left], np.minimum(shown.part(at[left]).numbers(kinds)[:, 3], 1))
        past = smooth(past, points, pixels)
        down, right = pixels[0] + eye.window[1] - camera.window[1], pixels[1] + eye.window[0] - camera.window[0]
        rows = np.flatnonzero((down >= 0) & (down < camera.window[3]) & (right >= 0) & (right < camera.window[2]))
        if not len(rows):
            return
        self.pixels, self.one, self._at, self.past = (down[rows], right[rows]), one[rows], at[rows], past[rows]

        def lit(first: int, last: int) -> tuple[np.ndarray]:
            part, past = shown.part(self._at[first:last]), self.past[first:last]
            takes = (part.numbers(kinds)[:, :3] * (1 - past)[:, None]).sum(2)
            return (scene_linear(part.rgb, part.alpha, space) * np.maximum(1 - takes, 0)).T,

        self.light = joined(lit, len(rows))[0].T
        self.splats = shown.part(self._at).numbers(kinds)[:, kinds - 1]

    def of(self, instances: list[ViewedInstance]) -> np.ndarray:
        """What its pixels look like with these instances, in light [P, 3]."""
        shown = self._shown(instances, {}, False).part(self._at)
        return scene_linear(shown.rgb, shown.alpha, self.space)

    def _shown(self, instances: list[ViewedInstance], quantities: dict[str, Quantity], planes: bool) -> _Shown:
        """A picture of the pixels near edges with quantities; planes: and the depth's, over the core, and that of its plane."""
        layout = Layout(instances, planes, quantities, planes or self.holdout is not None, self.by_pixel)
        if planes:
            layout.core = layout.core[0], layout.places["depth"].stop  # the depth comes right after what is summed over the core
        drawn = self.backend.draw(instances, self._eye, layout, (), lambda share: None, holdout=self.holdout, wanted=self._near)
        rgb, alpha, channels = (self.backend.numpy(array).reshape(self._near.size, -1)
                                for array in (self.backend.colour(drawn, layout, self._eye), drawn.alpha, drawn.channels))
        return _Shown(self._eye, np.arange(len(rgb)), rgb, alpha[:, 0], channels, layout.places)


def _near_edges(instances: list[ViewedInstance], camera: Camera, lamps: int, backend: Any) -> tuple[Camera, np.ndarray] | None:
    """The camera with a window around the edges that it sees, and which pixels [h, w] of that lie near one; None where it sees none.

    They are looked for in a picture with one pixel for each BLOCK x BLOCK.
    """
    x0, y0, width, height = camera.window
    left, top, right, bottom = x0 // BLOCK, y0 // BLOCK, -(-(x0 + width) // BLOCK), -(-(y0 + height) // BLOCK)
    coarse = replace(  # with a pixel beside the window to each side
        camera, width=-(-camera.width // BLOCK) + 2, height=-(-camera.height // BLOCK) + 2, fx=camera.fx / BLOCK, fy=camera.fy / BLOCK,
        cx=camera.cx / BLOCK + 1, cy=camera.cy / BLOCK + 1, window=(left, top, right - left + 2, bottom - top + 2))
    seen = [replace(each, camera=coarse, model=without_colours(each.model)) for each in instances]
    layout = Layout(seen, False, {"past": Quantity(lamps, lambda shown: _numbers(shown, lamps)[:, 3])})
    drawn = backend.draw(seen, coarse, layout, (), lambda share: None)
    alpha, past = backend.numpy(drawn.alpha)[..., None], backend.numpy(drawn.sums["past"])
    near = ((alpha > FAINT) & on_edge(past / np.maximum(alpha, FAINT))).any(-1)
    near = near[:-2] | near[1:-1] | near[2:]
    near = near[:, :-2] | near[:, 1:-1] | near[:, 2:]
    if not near.any():
        return None
    near = near.repeat(BLOCK, 0).repeat(BLOCK, 1)[y0 - top * BLOCK:, x0 - left * BLOCK:][:height, :width]
    (top, bottom), (left, right) = (np.flatnonzero(near.any(axis))[[0, -1]].tolist() for axis in (1, 0))
    window = x0 + left, y0 + top, right + 1 - left, bottom + 1 - top
    return replace(camera, window=window), near[top:bottom + 1, left:right + 1]


def _wider(camera: Camera) -> Camera:
    """The camera with as much of the image around its window as its pixels depend on."""
    first, size, image = np.array(camera.window[:2]), np.array(camera.window[2:]), np.array([camera.width, camera.height])
    more = AROUND_ONE + WIDEST
    before, after = np.clip(first, 0, more), np.clip(image - first - size, 0, more)
    return replace(camera, window=(*(first - before).tolist(), *(size + before + after).tolist()))


def _around(instances: list[ViewedInstance], camera: Camera) -> Camera | None:
    """The camera with a window around those Gaussians that an edge lies on, None where it sees none."""
    found = [np.zeros((0, 4))]
    for each in instances:
        if each.taken is not None and each.taken.edges:
            seen = Shown(each, np.flatnonzero(on_edge(each.taken.numbers[:, 3]).any(1)))
            centre, axes = seen.pixels(each)
            reach = AROUND * np.sqrt((axes * axes).sum(2)) + BLOCK
            found.append(np.concatenate([centre - reach, centre + reach], 1)[seen.view[:, 2] > each.near])
    boxes = np.concatenate(found)
    x0, y0, width, height = camera.window
    boxes = np.clip(boxes, [x0, y0] * 2, [x0 + width, y0 + height] * 2).astype(int)
    boxes = boxes[(boxes[:, :2] < boxes[:, 2:]).all(1)]
    if not len(boxes):
        return None
    (left, top), (right, bottom) = boxes[:, :2].min(0).tolist(), boxes[:, 2:].max(0).tolist()
    return replace(camera, window=(left, top, right - left, bottom - top))


def _wide(shown: Shown) -> np.ndarray:
    """Of each Gaussian its standard deviation along the view, and 1."""
    taken = shown.instance.taken
    wide = np.exp(shown.instance.model.scale[shown.index].max(1)) if taken is None else taken.wide[shown.index]
    return np.stack([wide, np.ones(len(wide))], 1)


def _numbers(shown: Shown, lamps: int) -> np.ndarray:
    """The numbers of each Gaussian's lamps; of those that are not lit all light arrives, and nothing is to be taken."""
    if shown.instance.taken:
        return shown.instance.taken.numbers[shown.index]
    return np.broadcast_to(np.array([0, 0, 0, 1, 1])[:, None], (len(shown.index), NUMBERS, lamps))
