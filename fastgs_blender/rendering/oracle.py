# SPDX-License-Identifier: GPL-3.0-or-later
"""The oracle: projection and compositing in plain float64 array code, slow and written to be read.

Together with slicing.py (motion, temporal opacity, rotation) and appearance.py (spherical harmonics, decoder) it says what
a picture of a model is.  The kernels are tested against it.
"""
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..model.appearance import Features, decode, lifted, momentary
from ..model.slicing import Slice, slice_model
from ..util import rotations
from .crops import crop_share
from .culling import order_in_numpy
from .distance import share
from .exposure import Exposure, Film
from .holdout import sample_depths
from .instances import LIMIT, ViewedInstance
from .layout import CORE, DEPTH_FROM, PROBES, REST, Buffers, ChannelGroup, Exposed, Layout
from .looks import Look, graded, size_factor
from .normals import thinnest
from .painting import painted
from .passing import past_splats, past_triangles, view_box
from .quantities import Shown, posed, shares
from .spots import spread

T_STOP = 1e-4
"""A pixel is finished when the next splat would leave this transmittance or less; that splat is not blended (INRIA, gsplat)."""

REACH = 4.0
"""Standard deviations: a Gaussian whose centre lies beside the picture, and so near to the camera's plane, is linearised elsewhere."""


@dataclass(frozen=True, eq=False)
class Splats:
    """M projected Gaussians, float64.

    mean [M, 2] pixels, covariance [M, 2, 2] square pixels with the blur added, determinant [M] of it, opacity [M],
    depth [M] along the view axis, channels [M, C], alpha_max [M], alpha_cut [M]
    """

    mean: np.ndarray
    covariance: np.ndarray
    determinant: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray
    channels: np.ndarray
    alpha_max: np.ndarray
    alpha_cut: np.ndarray


def colours(s: Slice, instance: ViewedInstance, camera: Camera) -> np.ndarray:
    """The values that each Gaussian adds to the picture: rgb [M, 3], or the features [M, 9] of a model with a decoder."""
    appearance = momentary(instance.model.appearance)
    if camera.orthographic:
        direction = np.broadcast_to(instance.camera_to_model[:3, 2], s.position.shape)
    else:
        direction = s.position - instance.camera_to_model[:3, 3]
    direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-30)
    seen = appearance.seen(s.features, direction)
    return seen if isinstance(appearance, Features) else graded(seen, instance.look)


def nearness(view: np.ndarray, factor: np.ndarray, along: np.ndarray) -> np.ndarray:
    """1 / the depth at which each Gaussian's projection is linearised [M].

    It is the centre's depth z.  But what lies beside the picture and reaches to the camera's plane would be drawn as if all of it were as
    near as its centre: over the whole picture, as an explosion.  It is linearised at the depth where it is densest on the ray at the border
    of the Jacobian's range, or at z / 2 if that is nearer.  Between REACH and REACH - 1 standard deviations of depth before the plane one
    goes over into the other; Gaussians within the range keep their z.

    view [M, 3] centres in the camera's axes, factor [M, 3, 3] the square root of the covariance there, along [M, 2] x/z and y/z, clamped
    """
    z, ray = view[:, 2], np.concatenate([along, np.ones((len(view), 1))], 1)
    sides = np.cross(factor[:, :, [1, 2, 0]], factor[:, :, [2, 0, 1]], axis=1)  # rows of the inverse, times the determinant
    across, centre = np.einsum("mik,mi->mk", sides, ray), np.einsum("mik,mi->mk", sides, view)
    square = (across**2).sum(1)
    densest = np.maximum(np.divide((across * centre).sum(1), square, out=z.copy(), where=square > 0), z / 2)
    share = np.clip(REACH - z / np.linalg.norm(factor[:, 2], axis=1), 0, 1)
    return np.where((along == view[:, :2] / z[:, None]).all(1), 1 / z, (1 - share) / z + share / densest)


def project(instance: ViewedInstance, camera: Camera, layout: Layout) -> Splats:
    """One instance at its time, projected (EWA splatting as 3DGS does it; rasterisers.md 3.1)."""
    model, raster = instance.model, instance.model.raster
    s = slice_model(model, instance.t, cull=instance.settings.opacity <= 1)
    s = replace(s, opacity=s.opacity * instance.look[Look.OPACITY],
                scale=s.scale * size_factor(s.scale.max(1, initial=0), instance.look)[:, None])
    linear, origin = instance.model_to_camera[:3, :3], instance.model_to_camera[:3, 3]
    view = s.position @ linear.T + origin
    z = view[:, 2]
    factor = linear @ rotations.to_matrices(s.rotation) * s.scale[:, None, :]
    s = replace(s, opacity=s.opacity * crop_share(instance.settings.crops, s.position))
    seen = instance.in_ball(model.position[s.index])
    if len(instance.hidden):
        seen &= ~instance.hidden[s.index]
    seen &= (z > instance.near) & (z <= instance.far)
    seen &= 1 + np.exp(-model.opacity[s.index].astype(np.float64)) <= instance.look[Look.FAINTEST]
    seen &= np.isfinite(view).all(1) & np.isfinite(factor).all((1, 2))
    s = Slice(**{name: value[seen] for name, value in vars(s).items()})
    view, z, factor = view[seen], z[seen], factor[seen]

    jacobian = np.zeros((len(z), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = camera.fx, camera.fy
    centre = np.array([camera.cx, camera.cy])
    if camera.orthographic:
        mean = view[:, :2] * (camera.fx, camera.fy) + centre
    else:
        x_low, x_high, y_low, y_high = camera.tangent_limits()
        along = np.clip(view[:, :2] / z[:, None], (x_low, y_low), (x_high, y_high))
        near = nearness(view, factor, along) if instance.settings.bends else 1 / z
        beside = along + (view[:, :2] - along * z[:, None]) * near[:, None]
        mean = np.where(near[:, None] == 1 / z[:, None], view[:, :2] / z[:, None], beside) * (camera.fx, camera.fy) + centre
        jacobian[:, :, 2] = -along * (camera.fx, camera.fy)
        jacobian *= near[:, None, None]
    # Sigma_2D = (J W R S)(J W R S)^T; its determinant as a sum of squares (Cauchy-Binet), which needles do not cancel
    turned, factor = factor, jacobian @ factor
    covariance = factor @ factor.transpose(0, 2, 1)
    sharp = (np.cross(factor[:, 0], factor[:, 1]) ** 2).sum(1)
    trace = covariance[:, 0, 0] + covariance[:, 1, 1]
    depth = np.ones(len(z)) if camera.orthographic else z
    blur, small = instance.sampling.blurs(raster.blur, s.position, s.scale.max(1, initial=0), depth)
    determinant = sharp + blur * trace + blur**2
    covariance = covariance + blur[:, None, None] * np.eye(2)
    opacity = s.opacity
    if raster.antialiased:
        opacity = opacity * np.sqrt(np.divide(sharp, determinant, out=np.zeros_like(sharp), where=determinant > 0))

    channels = np.zeros((len(z), layout.channels))
    colour = colours(s, instance, camera)
    group = layout.group_of(instance)
    channels[:, group.offset:group.offset + colour.shape[1]] = colour
    if group.weight is not None:
        channels[:, group.weight] = 1
    if layout.depth is not None:
        channels[:, layout.depth] = z
    if layout.plane is not None:
        box = np.sqrt(2 * np.log(opacity / raster.alpha_cut)[:, None] * np.diagonal(covariance, axis1=1, axis2=2))
        added, area = (blur, determinant) if layout.by_pixel else (np.zeros(len(z)), sharp)
        channels[:, layout.places["plane"]] = plane(turned[:, 2], factor, added, area, box, mean, z, camera)
    shown = Shown(instance, s.index)
    for name, quantity in layout.quantities.items():
        channels[:, layout.places[name]] = quantity.of(shown)
    same, faint = np.ones(len(z)), share(small, blur, sharp, trace)
    splats = Splats(mean, covariance, determinant, opacity * faint, z, channels, raster.alpha_max * same, raster.alpha_cut * faint)
    drawn = (determinant > 0) & (opacity >= raster.alpha_cut) & np.isfinite(covariance).all((1, 2)) & (np.abs(channels) <= LIMIT).all(1)
    drawn &= faint > 0
    return Splats(**{name: value[drawn] for name, value in vars(splats).items()})


def _nothing(layout: Layout) -> Splats:
    """The splats of no instance."""
    none = np.zeros(0)
    return Splats(np.zeros((0, 2)), np.zeros((0, 2, 2)), none, none, none, np.zeros((0, layout.channels)), none, none)


def plane(deep: np.ndarray, flat: np.ndarray, blur: np.ndarray, determinant: np.ndarray, box: np.ndarray, mean: np.ndarray, z: np.ndarray,
          camera: Camera) -> np.ndarray:
    """Depth of each splat at the pixels it covers, a + b x + c y with x and y from the image's middle: [M, 3].

    It is the depth of the greatest density on a pixel's ray, for a flat Gaussian that of its plane (RaDe-GS, section 4): its slope is
    cov(z, xy) cov(xy)^-1, without the blur.  It never changes by more than the depth itself within the splat's box.  Where pixels sort
    their splats by it, it has the blur: that of a sheet which turns its edge to the camera then does not change from one side to the other
    all at once.

    deep [M, 3], flat [M, 2, 3]: the rows of the covariance's square root along z, in space, and along x and y, in pixels
    blur, determinant [M]: what is added to cov(xy), and the determinant of the sum
    box [M, 2] half the size of the box in which the splat is drawn
    """
    (xx, xy), (_, yy) = np.einsum("mik,mjk->ijm", flat, flat)
    x, y = np.einsum("mik,mk->im", flat, deep)
    slope = np.stack([(yy + blur) * x - xy * y, (xx + blur) * y - xy * x], 1) / determinant[:, None]
    change = (np.abs(slope) * box).sum(1)
    slope = np.where((change > z)[:, None], slope * (z / change)[:, None], slope)
    slope = np.where(np.isfinite(slope).all(1, keepdims=True), slope, 0)
    return np.concatenate([(z - (slope * (mean - np.array([camera.width, camera.height]) / 2)).sum(1))[:, None], slope], 1)


def rasterise(splats: Splats, camera: Camera, band: float = 0.0, holdout: np.ndarray | None = None, planes: slice = slice(0),
              by_pixel: bool = False, core: tuple[int, int] = (0, 0)) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], tuple]:
    """Channels [h, w, C], alpha [h, w], the probes [h, w], and of a holdout the light that it stops and the share that it covers [h, w]:
    front-to-back compositing into the camera's window (rasterisers.md 3.2).

    band     alpha fades in over this width above the cut, with a continuous derivative.  A picture with a band can be differentiated
             by differences, for checks of gradients; pictures have none
    holdout  triangles, see holdout.py: each of a pixel's points loses its share of the light behind them
    planes   with a holdout or by_pixel, the channels of the splats' planes
    by_pixel each pixel's splats come in the order of these planes' depths, which take the place of the centres'
    core     from which channel to which they are summed over the core of each pixel (layout.py)
    """
    x0, y0, width, height = camera.window
    px, py = x0 + np.arange(width) + 0.5, y0 + np.arange(height) + 0.5
    out = np.zeros((height, width, splats.channels.shape[1]))
    depths = np.full((height, width, 1), np.inf) if holdout is None else sample_depths(holdout, camera).astype(np.float32)
    transmittance, live = np.ones(depths.shape), np.ones(depths.shape, bool)  # of each point of a pixel
    probes = {name: np.full((height, width), np.inf if name in DEPTH_FROM else 0.0) for name in PROBES}
    of_core = np.isin(np.arange(out.shape[2]), np.arange(*core))
    farthest = depths.max(-1)  # infinite unless triangles cover the whole pixel
    for box, alpha, cut, depth, surface, values in (_by_pixel if by_pixel else _by_centre)(splats, camera, px, py, planes):
        t = transmittance[box]
        shows = depths[box] >= np.asarray(depth, np.float32)[..., None]
        if holdout is not None:
            shows = shows & (farthest[box] >= surface)[..., None]
        hit = live[box] & (alpha >= cut)[..., None] & shows
        if band:
            rise = np.clip((alpha - cut) / band, 0, 1)
            alpha = alpha * rise**2 * (3 - 2 * rise)
        after = t * (1 - alpha[..., None])
        blended = hit & (after > T_STOP)
        live[box] &= ~(hit & ~blended)
        drawn, light = blended.any(-1), (t * shows).mean(-1)
        weight = np.where(blended, alpha[..., None] * t, 0).mean(-1)
        inner = np.maximum(np.minimum(light, CORE[1]) - np.maximum(light - weight, CORE[0]), 0) + REST * weight
        out[box] += np.where(of_core, inner[..., None], weight[..., None]) * values
        for name, above in DEPTH_FROM.items():
            probes[name][box] = np.where(drawn & (light > above), depth, probes[name][box])
        probes["count"][box] += drawn
        transmittance[box] = np.where(blended, after, t)
    hidden = np.isfinite(depths)
    held = () if holdout is None else ((transmittance * hidden).mean(-1), hidden.mean(-1))
    return out, (1 - transmittance).mean(-1), probes, held


def _by_centre(splats: Splats, camera: Camera, px: np.ndarray, py: np.ndarray, planes: slice) -> Iterator[tuple[Any, ...]]:
    """Yields the splats front to back: of each the box of pixels that it touches, its alpha [h, w] there and the cut, its depth, the
    depths of its plane (or its own), and its channels [C]."""
    order = np.argsort(splats.depth.astype(np.float32), kind="stable")
    reach = 2 * np.log(splats.opacity / splats.alpha_cut)  # Mahalanobis distance squared beyond which alpha is under the cut
    for i in order:
        (a, b), (_, c) = splats.covariance[i]
        mx, my = splats.mean[i]
        radius_x, radius_y = np.sqrt(reach[i] * a) + 1, np.sqrt(reach[i] * c) + 1
        left, right = np.searchsorted(px, (mx - radius_x, mx + radius_x))
        top, bottom = np.searchsorted(py, (my - radius_y, my + radius_y))
        if left == right or top == bottom:
            continue
        dx, dy = (px[left:right] - mx)[None, :], (py[top:bottom] - my)[:, None]
        # d^T Sigma^-1 d with the square completed in x: a sum of squares, so that needles do not cancel
        distance = (dx - b / c * dy) ** 2 * c / splats.determinant[i] + dy**2 / c
        alpha = np.minimum(splats.alpha_max[i], splats.opacity[i] * np.exp(-0.5 * distance))

        surface = splats.depth[i]
        if splats.channels[i, planes].size:
            z, along_x, along_y = splats.channels[i, planes]
            surface = z + along_x * (px[left:right] - camera.width / 2)[None, :] + along_y * (py[top:bottom] - camera.height / 2)[:, None]
        yield np.s_[top:bottom, left:right], alpha, splats.alpha_cut[i], splats.depth[i], surface, splats.channels[i]


def _by_pixel(splats: Splats, camera: Camera, px: np.ndarray, py: np.ndarray, planes: slice) -> Iterator[tuple[Any, ...]]:
    """Yields layers of the whole window front to back, as _by_centre() does: of each pixel the nearest splat, then the next.  Depths are
    those of the planes."""
    layers = list(_by_centre(splats, camera, px, py, planes))
    alphas, depths = np.zeros((len(layers), len(py), len(px))), np.full((len(layers), len(py), len(px)), np.inf)
    for i, (box, alpha, cut, _, surface, _) in enumerate(layers):
        alphas[i][box] = np.where(alpha >= cut, alpha, 0)
        depths[i][box] = np.where(alpha >= cut, surface, np.inf)
    channels = np.array([values for *_, values in layers])
    for which in depths.argsort(0, kind="stable"):
        alpha, depth = (np.take_along_axis(array, which[None], 0)[0] for array in (alphas, depths))
        yield np.s_[:, :], alpha, np.finfo(float).tiny, depth, depth, channels[which]


def decode_features(features: np.ndarray, weight: np.ndarray, instance: ViewedInstance, camera: Camera, way: str) -> np.ndarray:
    """Premultiplied colour [h, w, 3] of blended features [h, w, 9] with their blending weight [h, w].

    way  "normalised": the decoder sees the features of the surface, so that colour does not depend on coverage
         "premultiplied": it sees the sum, and its picture is opaque
         "lifted": as before, without what it shows behind the splats
    Colours beyond LIMIT are 0.
    """
    appearance = instance.model.appearance
    assert isinstance(appearance, Features)
    centre, rays = camera.rays(instance.model_to_camera)
    share = weight[..., None]
    with np.errstate(over="ignore", invalid="ignore"):
        if way == "normalised":
            surface = np.divide(features, share, out=np.zeros_like(features), where=share > 0)
            colour = graded(decode(surface, centre, rays, appearance), instance.look) * share
        elif way == "premultiplied":
            colour = graded(decode(features, centre, rays, appearance), instance.look)
        else:
            whole, empty = (decode(f, centre, rays, appearance) for f in (features, np.zeros_like(features)))
            colour = lifted(whole, empty, weight, appearance)
            straight = np.divide(colour, share, out=np.zeros_like(colour), where=share > 0)
            colour = graded(straight, instance.look) * share
    return np.where(np.abs(colour) <= LIMIT, colour, 0)


class Oracle:
    """The backend "reference": protocol.PictureBackend in float64; its arrays are NumPy's."""

    def array(self, values: np.ndarray) -> np.ndarray:
        return np.asarray(values)

    def numpy(self, array: np.ndarray) -> np.ndarray:
        return array

    def draw(self, instances: list[ViewedInstance], camera: Camera, layout: Layout, probes: Collection[str],
             progress: Callable[[float], None], holdout: np.ndarray | None = None, wanted: np.ndarray | None = None,
             band: float = 0.0) -> Buffers:
        """All instances together, composited into the layout's channels; all pixels are drawn; band: see rasterise()."""
        with np.errstate(all="ignore"):  # what overflows is not drawn
            drawn = [project(instance, camera, layout) for instance in instances] or [_nothing(layout)]
        progress(0.1)
        splats = Splats(**{name: np.concatenate([vars(s)[name] for s in drawn]) for name in vars(drawn[0])})
        channels, alpha, found, held = rasterise(splats, camera, band, holdout, layout.places.get("plane", slice(0)), layout.by_pixel,
                                                 layout.core)
        sums = {name: channels[..., where] for name, where in layout.places.items()}
        return Buffers(channels, alpha, sums, {name: found[name] for name in probes}, *held)

    def colour(self, buffers: Buffers, layout: Layout, camera: Camera) -> np.ndarray:
        """Premultiplied colour [h, w, 3]: the sum over the layout's groups."""
        return reduce(np.add, (self._group_colour(buffers, group, camera) for group in layout.groups))

    def _group_colour(self, buffers: Buffers, group: ChannelGroup, camera: Camera) -> np.ndarray:
        if group.instance is None:
            return buffers.channels[..., group.offset:group.offset + 3]
        weight = buffers.alpha if group.weight is None else buffers.channels[..., group.weight]
        return decode_features(buffers.channels[..., group.offset:group.offset + 9], weight, group.instance, camera, group.decode)

    def expose(self, exposure: Exposure, instances: list[ViewedInstance], camera: Camera, colours: bool,
               progress: Callable[[float], None], holdout: np.ndarray | None = None, objects: Sequence[tuple[str, int]] = (),
               by_pixel: bool = False) -> Exposed:
        """The average of as many samples as the exposure allows."""
        _, _, width, height = camera.window
        film = Film(height, width, {instance.model.colour_space for instance in instances}, len(objects))
        samples = exposure.samples(exposure.levels)
        for i, sample in enumerate(samples):
            moved, eye = exposure.scene(instances, camera, sample.time, sample.point)
            layout = Layout(moved, False, {"shares": shares(moved, objects)} if objects else None, holdout is not None, by_pixel)
            buffers = self.draw(moved, eye, layout, (), partial(lambda i, fraction: progress((i + fraction) / len(samples)), i),
                                holdout=exposure.holdout(holdout, sample.time))
            film.add(self.colour(buffers, layout, eye) if colours else None, buffers.alpha, sample.weights[-1], buffers.held,
                     buffers.sums.get("shares"))
        rgb, alpha = film.picture()
        return Exposed(rgb if colours else None, alpha, None if holdout is None else film.held, film.shares if objects else None)

    def surface(self, triangles: np.ndarray, camera: Camera) -> np.ndarray:
        return sample_depths(triangles, camera).min(-1)

    def past_splats(self, instances: list[ViewedInstance], camera: Camera, points: np.ndarray, over: np.ndarray) -> np.ndarray:
        layout = Layout(instances, False, plane=True)
        with np.errstate(all="ignore"):
            return past_splats([project(instance, camera, layout) for instance in instances], layout.places["plane"], camera, points, over)

    def contributing(self, instances: list[ViewedInstance], camera: Camera) -> list[tuple[np.ndarray, np.ndarray]]:
        seen = [np.sort(order_in_numpy([each], camera)).astype(np.int64) for each in instances]
        return [(index, np.ones(len(index), np.float32)) for index in seen]

    past_triangles, view_box = staticmethod(past_triangles), staticmethod(view_box)
    posed, thinnest, spread, painted = staticmethod(posed), staticmethod(thinnest), staticmethod(spread), staticmethod(painted)
    front_to_back = staticmethod(order_in_numpy)


BACKEND = Oracle()
