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
from ..util.threads import beside, several
from .colour import linear_to_srgb, scene_linear, straight
from .exposure import Exposure
from .instances import Instance, ViewedInstance
from .lamps import Lamp
from .layout import Layout
from .quantities import Quantity, Shown
from .ways import Sides, Ways, without_colours

PLACES = 4
"""Places in a pixel that a lamp is looked at from, all its points together."""
WITHIN = np.array([[0.125, -0.375], [0.375, 0.125], [-0.125, 0.375], [-0.375, -0.125]])
"""These places, in pixels from its middle: no two in one row or column."""
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
WIDEST = 8
"""Pixels to each side over which steps of a soft shadow are smoothed, at most; a power of two."""
AROUND_ONE = 16
"""Pixels to each side of a pixel that must show one surface as well, for its own to be believed."""
FEW, ENOUGH = 0.7, 0.9
"""The shares of these at which it begins to be believed, and is."""
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
        at, sums, alpha = drawn.pixels, dict(blended.sums), blended.alpha[drawn.pixels][:, None]
        for name, kind, level in wanted:
            now = drawn.past[:, level] * (1 if kind == "mesh_shadow" else drawn.splats[:, level])
            sums[name] = sums[name].copy()
            sums[name][at] += drawn.one[:, None] * (alpha * now[:, None] - sums[name][at])
        if not coloured:
            return replace(blended, sums=sums)
        before = scene_linear(blended.rgb[at], blended.alpha[at], space)
        return replace(blended, sums=sums, rgb=_changed(blended, at, before + drawn.one[:, None] * (drawn.light - before), space))

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
    return replace(blended, rgb=_changed(blended, at, scene_linear(blended.rgb[at], blended.alpha[at], space) + change[at], space))


def _changed(blended: Any, at: tuple[np.ndarray, ...], light: np.ndarray, space: str) -> np.ndarray:
    """A picture [h, w, 3] with the light [P, 3] that some of its pixels have now."""
    out, alpha, linear = blended.rgb.copy(), blended.alpha[at], np.maximum(light, 0).astype(blended.rgb.dtype)
    out[at] = linear_to_srgb(straight(linear, alpha)) * alpha[:, None] if space == "srgb" else linear
    return out


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
        self._eye, self._near = eye, _ = found
        of_lamps = Quantity(kinds * lamps, lambda shown: _numbers(shown, lamps)[:, :kinds].reshape(-1, kinds * lamps))
        normals = Quantity(3, lambda shown: shown.instance.taken.normal[shown.index] if shown.instance.taken else
                           np.zeros((len(shown.index), 3)))
        at, rgb, alpha, sums = self._shown(instances, {"wide": Quantity(2, _wide, core=True), "numbers": of_lamps, "normal": normals}, True)
        pixels = np.divmod(at, eye.window[2])
        x, y = (axis[rows] for axis, rows in zip(eye.from_middle(), pixels[::-1], strict=True))
        plane = np.divide(sums["plane"].T, alpha, order="C", dtype=np.float64)
        one = _believed(_one(eye, sums, plane[0] + plane[1] * x + plane[2] * y, light.bias), pixels)
        rows = np.flatnonzero(one > SHARP)
        if not len(rows):
            return
        self.one, self._at, rgb, alpha, normal, numbers = (array[rows] for array in (one, at, rgb, alpha, sums["normal"], sums["numbers"]))
        pixels = pixels[0][rows], pixels[1][rows]
        normal /= np.maximum(np.sqrt(np.einsum("pi,pi->p", normal, normal)), 1e-30)[:, None]
        places = _points(eye, np.take(plane, rows, 1), x[rows], y[rows])
        past, points = _past(light, lamps, places, np.ascontiguousarray(normal.T), backend)
        numbers = numbers.reshape(-1, kinds, lamps) / alpha[:, None, None]
        past = _smooth(np.where(points > 0, past, np.minimum(numbers[:, 3], 1)), points, pixels)
        down, right = pixels[0] + eye.window[1] - camera.window[1], pixels[1] + eye.window[0] - camera.window[0]
        rows = np.flatnonzero((down >= 0) & (down < camera.window[3]) & (right >= 0) & (right < camera.window[2]))
        self.one, self._at, self.past, self.splats = self.one[rows], self._at[rows], past[rows], numbers[rows, kinds - 1]
        self.pixels = (down[rows], right[rows]) if len(rows) else ()
        takes = (numbers[rows, :3] * (1 - self.past)[:, None]).sum(2)
        self.light = scene_linear(rgb[rows], alpha[rows], space) * np.maximum(1 - takes, 0)

    def of(self, instances: list[ViewedInstance]) -> np.ndarray:
        """What its pixels look like with these instances, in light [P, 3]."""
        _, rgb, alpha, _ = self._shown(instances, {}, False, self._at)
        return scene_linear(rgb, alpha, self.space)

    def _shown(self, instances: list[ViewedInstance], quantities: dict[str, Quantity], planes: bool, at: np.ndarray | None = None
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Pixels [P] of the window, which are `at` or those near edges that show something; their colours [P, 3], alpha [P], and sums of
        quantities [P, K] by name; planes: and the depth's, over the core, and that of its plane."""
        layout = Layout(instances, planes, quantities, planes or self.holdout is not None, self.by_pixel)
        if planes:
            layout.core = layout.core[0], layout.places["depth"].stop  # the depth comes right after what is summed over the core
        drawn = self.backend.draw(instances, self._eye, layout, (), lambda share: None, holdout=self.holdout, wanted=self._near)
        rgb, alpha, channels = (self.backend.numpy(array).reshape(self._near.size, -1)
                                for array in (self.backend.colour(drawn, layout, self._eye), drawn.alpha, drawn.channels))
        at = np.flatnonzero(self._near.ravel() & (alpha[:, 0] > FAINT)) if at is None else at
        channels = channels[at]
        return at, rgb[at], alpha[at, 0], {name: channels[:, where] for name, where in layout.places.items()}


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


def _one(eye: Camera, sums: dict[str, np.ndarray], depth: np.ndarray, bias: float) -> np.ndarray:
    """Whether each of P pixels, of sums [P, K], shows one surface, which lies at this depth [P]: from 0 to 1."""
    core = np.maximum(sums["wide"][:, 1], 1e-30).astype(np.float64)
    mean, wide = sums["depth"][:, 0] / core, sums["wide"][:, 0] / core
    return np.clip(2 - np.abs(depth - mean) / (0.5 * wide + 2 * bias), 0, 1) * (depth > eye.near)


def _believed(one: np.ndarray, pixels: tuple[np.ndarray, ...]) -> np.ndarray:
    """How far pixels [P] show one surface, where those around them do as well."""
    at, size = _framed(pixels, AROUND_ONE)
    share, there = (_box(_totals(size, at, values), at, AROUND_ONE) for values in (one, 1.0))
    return one * np.clip((share / there - FEW) / (ENOUGH - FEW), 0, 1)


def _framed(pixels: tuple[np.ndarray, ...], edge: int) -> tuple[np.ndarray, tuple[int, int]]:
    """Where pixels lie in a sheet that just holds them and an edge around, for _box(), and its size."""
    rows, columns = (axis - (axis.min() - edge - 1) for axis in pixels)
    size = int(rows.max()) + 1 + edge, int(columns.max()) + 1 + edge
    return rows * size[1] + columns, size


def _sheet(size: tuple[int, int], at: np.ndarray, values: np.ndarray | float, others: float = 0.0) -> np.ndarray:
    """A sheet of a size with values at the places `at`, and others."""
    sheet = np.full(size, others)
    sheet.reshape(-1)[at] = values
    return sheet


def _totals(size: tuple[int, int], at: np.ndarray, values: np.ndarray | float) -> np.ndarray:
    """The running sums of such a sheet, along both axes."""
    sheet = _sheet(size, at, values)
    return np.cumsum(np.cumsum(sheet, 0, out=sheet), 1, out=sheet)


def _box(total: np.ndarray, at: np.ndarray, radius: int) -> np.ndarray:
    """Sums over squares of pixels around those places, from a sheet's running sums."""
    width, sums = total.shape[1], total.reshape(-1)
    below, above = at + radius * width, at - (radius + 1) * width
    return sums[below + radius] - sums[above + radius] - sums[below - radius - 1] + sums[above - radius - 1]


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


def _smooth(past: np.ndarray, points: np.ndarray, seen: tuple[np.ndarray, ...]) -> np.ndarray:
    """Shares [P, L] at pixels `seen` of a window, without the steps that lamps of so many points [P, L] make."""
    (at, size), out = _framed(seen, WIDEST), past.copy()
    total = _totals(size, at, 1.0)
    for lamp in np.flatnonzero((points > 1.5).any(0)):
        low, high = (_sheet(size, at, past[:, lamp], edge).astype(np.float32) for edge in (np.inf, -np.inf))
        summed, step, radius = _totals(size, at, past[:, lamp]), 2.001 / np.maximum(points[:, lamp], 1), 0
        while radius < WIDEST:
            radius, off = max(2 * radius, 1), max(radius, 1)
            for axis in (0, 1):
                low = np.minimum(low, np.minimum(np.roll(low, off, axis), np.roll(low, -off, axis)))
                high = np.maximum(high, np.maximum(np.roll(high, off, axis), np.roll(high, -off, axis)))
            differ = high.reshape(-1)[at] - low.reshape(-1)[at]
            narrow = np.flatnonzero((differ > 0) & (differ <= step))
            out[narrow, lamp] = _box(summed, at[narrow], radius) / _box(total, at[narrow], radius)
    return out


def _points(eye: Camera, plane: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The places WITHIN pixels in the world [3, PLACES, P], of pixels at x and y [P] from the image's middle, on planes [3, P] of depth."""
    out, to_world = np.empty((3, PLACES, len(x))), np.linalg.pinv(eye.world_to_camera)[:3]
    for place, (right, down) in enumerate(WITHIN):
        across, along = x + right, y + down
        depth = plane[0] + plane[1] * across + plane[2] * along
        spread = 1.0 if eye.orthographic else depth
        across, along = (across + (eye.width / 2 - eye.cx)) / eye.fx * spread, (along + (eye.height / 2 - eye.cy)) / eye.fy * spread
        for axis, row in enumerate(to_world):
            out[axis, place] = row[0] * across + row[1] * along + row[2] * depth + row[3]
    return out


def _past(light: Any, count: int, places: np.ndarray, normal: np.ndarray, backend: Any) -> tuple[np.ndarray, np.ndarray]:
    """By lamp, which share of its light comes past the meshes to pixels, as places [3, S, P] with normals [3, P], and of how many points of
    the lamp, as if each were as bright: [P, L] each."""
    scene, middle, total = Ways(backend, [], light.meshes, moments=light.moments), places.mean(1), np.zeros((3, count, len(normal.T)))
    for lamp, level in zip(light.lamps, light.levels, strict=True):
        bright, ways = np.abs(lamp.colour).sum(1), scene.of_lamp(lamp.name, light.clear.get(lamp.name))
        sides = ways.sides(lamp.light, middle, 0.0 if lamp.light.parallel else 3**0.5 * float(np.abs(places - middle[:, None]).max()))
        told = partial(_told, lamp, sides, middle, normal, places, light)
        for share, open_ in several(told, [(k, bright[k], bright[k] / bright.sum()) for k in np.flatnonzero(bright)]):
            for row, value in zip(total[:, level], (share, share * open_, share**2), strict=True):
                row += value
    free, left, squares = total
    return (left / np.maximum(free, 1e-30)).T, np.where(free > 0, free * free / np.maximum(squares, 1e-60), 0).T


def _told(lamp: Lamp, sides: Sides, middle: np.ndarray, normal: np.ndarray, places: np.ndarray, light: Any, number: int,
          bright: float, part: float) -> tuple[np.ndarray, np.ndarray]:
    """How much light the lamp's point of that number, of that brightness and part of all, sends to pixels [R], and which share of that
    comes past the meshes."""
    share, each = bright * lamp.share(number, middle, normal), min(max(round(PLACES * part), 1), PLACES)
    own, open_ = places[:, (number * each + np.arange(each)) % PLACES], np.ones(len(share), np.float32)
    some = share != 0
    lit = np.flatnonzero(some) if 2 * np.count_nonzero(some) < len(share) else slice(None)  # copies cost as much as asking for a few
    open_[lit] = sides.past(number, own[:, :, lit], light.size, light.bias)[0]
    return share, open_
