# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface of a backend: all operations that rendering, viewports, training and its preparation call.

Arrays are the backend's own (`Array` below: NumPy on the CPU, buffers on a GPU).  Callers make them with array() or zeros(), hand
them over whole, and compute nothing with them; numpy() and read() bring values back.  Nothing is brought back within a
training step but what end_step() need not wait for: a few numbers, and the pictures of steps that refine poses
(training/core/camera_turns.py).

Rendering and viewports use PictureBackend, which the oracle (rendering/oracle.py) implements too; training uses TrainingBackend.
Same inputs, same bytes: on one device, for any number of threads, without atomic sums of floats.

N Gaussians, C channels, h x w pixels of a camera's window, K coefficients of the motion.  Where a shape has no type it is float32.
"""
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike

from ..cameras.camera import Camera
from ..model.gaussians import GaussianModel
from ..rendering.exposure import Exposure
from ..rendering.instances import Instance, ViewedInstance
from ..rendering.layout import Buffers, Exposed, Layout

Array = Any
"""An array that a backend owns."""
Rows = Any
"""A set of Gaussians, in a form of the backend's own."""


class DeviceError(Exception):
    """A backend's device cannot go on, and what lies on it is lost; the text is a part of a sentence that says why."""


@dataclass(frozen=True, eq=False)
class MotionNorm:
    """The paper's motion regulariser, for one basis.

    The coefficients motion [N, K, 3] of each Gaussian are turned into R rows, each with a weight: matrix [R, K], or None where they
    stay as they are; weights [3 R].  The penalty is sum_r weights[r] |row_r| / extent, with norms that are rounded off below
    smooth * extent, reading "mean": averaged over the Gaussians; "group": of the root mean square over the Gaussians.
    """

    matrix: np.ndarray | None
    weights: np.ndarray
    extent: float
    smooth: float
    reading: str


class PictureBackend(Protocol):
    """The operations that render() and viewports need."""

    def array(self, values: np.ndarray) -> Array:
        """The values, of any shape [...], as an array [...] of the backend; the caller no longer changes them."""

    def numpy(self, array: Array) -> np.ndarray:
        """The values [...] of an array [...]; the caller does not change them, but may keep them as long as nothing writes to the array."""

    def draw(self, instances: list[ViewedInstance], camera: Camera, layout: Layout, probes: Collection[str],
             progress: Callable[[float], None], holdout: np.ndarray | None = None, wanted: np.ndarray | None = None) -> Buffers:
        """Slice, crop, cull and project all instances, sort the splats, list them by tile and blend them (layout.Buffers).

        probes, wanted  which of layout.PROBES, and which pixels [h, w] (None: all), are asked for; other pixels may be anything
        progress  called with 0..1 between pieces of work; what it raises ends the work and passes through
        holdout   triangles [F, 3, 3] in the world that hide splats (rendering/holdout.py), or None.  The layout has planes with it
        """

    def colour(self, buffers: Buffers, layout: Layout, camera: Camera) -> Array:
        """Premultiplied colour [h, w, 3] of what draw() gave: the sum over the layout's groups, features through their decoders."""

    def expose(self, exposure: Exposure, instances: list[ViewedInstance], camera: Camera, colours: bool,
               progress: Callable[[float], None], holdout: np.ndarray | None = None,
               objects: Sequence[tuple[str, int]] = (), by_pixel: bool = False) -> Exposed:
        """The average picture of an exposure: its colour [h, w, 3] and the rest of layout.Exposed.

        holdout   triangles at the picture's own time; while the shutter is open they are those of the exposure's moments
        objects   K of them, by Instance.identity
        by_pixel  see layout.Layout
        """

    def surface(self, triangles: np.ndarray, camera: Camera) -> Array:
        """Depth of the nearest of the triangles [F, 3, 3] float32 in each pixel [h, w]; inf where there is none."""

    def view_box(self, points: np.ndarray, view: np.ndarray, parallel: bool) -> np.ndarray:
        """The least and the largest x / z, y / z and z [2, 3] of those of the points [3, P] float64 of the world that lie before a camera
        with the view [3, 4]; parallel: x, y and z of all.  Not finite where there are none."""

    def past_splats(self, instances: list[ViewedInstance], camera: Camera, points: np.ndarray, over: np.ndarray) -> Array:
        """Which share of the light from the camera's centre comes past the splats to points [3, P] float64 of the world: [P] float32; see
        rendering/passing.py.  The window holds all of them that lie before the camera, but for a few pixels.  Called in several threads.

        over  [P] float64: how much nearer than the point along the view axis a splat must lie to count
        """

    def past_triangles(self, triangles: np.ndarray, camera: Camera, points: np.ndarray, over: np.ndarray) -> Array:
        """The same of opaque triangles [F, 3, 3] float32, for points [3, P] and over [P] as past_splats() has them: 0 or 1, [P] float32."""

    def posed(self, instance: Instance, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the Gaussians index [M] int64 of an instance are at its time, [M, 3]; the unit quaternions [M, 4] by which they are turned;
        and their axes [3, 3, M] as columns, each as long as its standard deviation.  In its model's space and in float64."""

    def spread(self, position: np.ndarray, axes: np.ndarray, place: np.ndarray, parallel: bool,
               within: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of Gaussians at places [3, P] with axes [3, 3, P]: their standard deviations [P] along the lines to a place [3] (parallel: along
        a direction), and places [3, S, P] on them, by shares `within` [S, 2] of their two longest axes, of the shorter one first."""

    def painted(self, instance: ViewedInstance, index: np.ndarray, places: np.ndarray, light: np.ndarray, unlit: np.ndarray | None,
                drops: bool) -> tuple[list[np.ndarray], np.ndarray]:
        """Features [M, F] with which the Gaussians index [M], at places [M, 3] in the model's space, look in a light [L, 4, 3, M] as
        relight.py says, times unlit [M, 3] or 1; if meshes drop shadows, also those without these, and Taken.numbers [M, 5, L]."""

    def contributing(self, instances: list[ViewedInstance], camera: Camera) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each instance, the Gaussians that the camera sees if nothing hides them, [V] int64, and the largest share that each of these
        has of a pixel, [V] float32.  It is an estimate."""

    def thinnest(self, places: np.ndarray, axes: np.ndarray, opacity: np.ndarray, reach: float, towards: np.ndarray, turn: np.ndarray,
                 rows: np.ndarray | None = None) -> np.ndarray:
        """Normals [N, 3]: along them the Gaussians around each Gaussian spread least; see rendering/normals.py.

        places, axes  [N, 3] and [3, 3, N] float64, as posed() has them; no Gaussian farther away than `reach` counts
        opacity  [N] float64.  A Gaussian weighs it times longest (middle - shortest) of its axes' lengths, at a distance d multiplied by
                 (1 - d^2 / reach^2)^2
        towards  [4] a place (x, y, z, 1) to which normals n look, or a direction (x, y, z, 0)
        turn     [3, 3]: what is returned is turn @ n, of length 1
        rows     [M] those that are asked for, for [M, 3]; None: all
        """

    def front_to_back(self, instances: list[ViewedInstance], camera: Camera, share: float = 1.0,
                      standing: dict | None = None) -> np.ndarray:
        """Indices [V] int32 of the Gaussians that can be seen, or of a share of them, the nearest first; see rendering.visibility.order().

        standing  may keep what it found of the instances for the next call
        """


@dataclass(eq=False)
class ForwardPass:
    """A picture of a model in training, and what its backward pass needs, in `state`.

    rgb [h, w, 3] premultiplied, alpha [h, w]; depth [h, w] sum of the splats' depths times their weights, or None
    features [h, w, 9], what the decoder made rgb of, or None
    """

    rgb: Array
    alpha: Array
    depth: Array | None
    state: Any
    features: Array | None = None


@dataclass(frozen=True, eq=False)
class Comparison:
    """The loss of a picture against its target, and its gradients.

    values    [4] float64: loss, mean absolute difference, SSIM, mean squared difference
    rgb       d (share * loss) / d rgb [h, w, 3]
    alpha     the same of alpha [h, w], beside what comes through rgb; None: zeros
    emphasis  [h, w]: the root of each pixel's weighted absolute difference over the picture's mean of it
    """

    values: Array
    rgb: Array
    alpha: Array | None
    emphasis: Array


class ScreenStatistics(Protocol):
    """Statistics of each Gaussian for density control (training/core/statistics.py): four arrays [N], summed over views."""

    gradient: Array
    absolute: Array
    seen: Array
    radius: Array


class TrainingBackend(PictureBackend, Protocol):
    """The operations that a training step and its preparation need beyond those for pictures.

    parameters: the arrays of GaussianModel.arrays by name, and parameters.DECODER's of a model with a decoder.  Steps write to
    them in place.
    template: a model of the same kinds (bases, appearance, rasteriser constants), whose own arrays are ignored.
    """

    def zeros(self, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Array:
        """An array [...] of zeros, of this shape."""

    def read(self, *arrays: Array) -> list[np.ndarray]:
        """The values [...] of several small arrays [...] at once."""

    def picture(self, rgb: np.ndarray, stored: np.ndarray | None) -> Array:
        """A target [h, w, 3] float32 for compare(); stored [h, w, 3]: the same as uint8, in 255ths, where there is
        such a one: less to upload.  Returns [h, w, 3], in a form of the backend's."""

    # one view, forward and backward

    def forward(self, parameters: dict[str, Array], template: GaussianModel, camera: Camera, t: float, depth: bool = False,
              band: float = 0.0) -> ForwardPass:
        """The model's picture at time t, for backward(); the parameters must not change in between.

        parameters  by name, each [N, ...], as the head of this class says
        band  alpha fades in over this width above the cut: 0 but for checks of the gradients by differences
        """

    def compare(self, picture: ForwardPass, target: Array, weight: Array | None, background: np.ndarray | None, dssim: float,
                opaque_weight: float, share: float, least: Array | None = None) -> Comparison:
        """The loss of a picture over its background against a target, and its gradient.

            loss = (1 - dssim) mean(weight |x - target|) + dssim mean(weight (1 - SSIM)) + opaque_weight mean(1 - alpha)

        target      [h, w, 3]
        weight      [h, w] >= 0, how much each pixel counts, or None; where it is below 1, the picture is first moved that far
                    towards the target, so that a pixel without weight does not disturb its neighbours' SSIM
        background  [3] on the host, or None for black
        share       factor on the gradient: 1 / the number of views of the step
        least       [h, w, 3] bool, where the target is only a lower bound, so that what is brighter is right, or None: nowhere
        """

    def agreement(self, picture: ForwardPass, target: Array, weight: Array | None, least: Array | None, background: np.ndarray | None,
                  gain: np.ndarray, bias: np.ndarray, sides: tuple[ForwardPass, ForwardPass] | None, apart: float, solid: float,
                  outlier: float) -> Array:
        """Sums over pixels by which a camera's exposure and clock are estimated (training/core/camera_response.py), float64 [19].

        With p the picture over its background, r = target - p, q = gain target + bias, J = (sides[0] - sides[1]) / apart, and
        w = min(weight, 1) / (1 + (r / outlier)^2), 0 where alpha is at most `solid` or the target only a lower bound: the sums of w, w p,
        w q, w p^2 and w p q for red, then green and blue; then, over all three, of w J^2, w J r, w r^2 and w, zeros without sides.

        target      [h, w, 3]
        weight      [h, w], or None: 1
        least       [h, w, 3] bool, or None: nowhere
        background  [3] on the host, or None for black;  gain [3], bias [3]
        """

    def over(self, picture: ForwardPass, background: np.ndarray | None) -> tuple[Array, Array]:
        """A picture [h, w, 3] over its background, [3] on the host or None for black, and its alpha [h, w], as end_step() brings them back
        (training/core/camera_turns.py)."""

    def backward(self, picture: ForwardPass, rgb: Array | None, alpha: Array | None = None, depth: Array | None = None, *,
                 into: dict[str, Array] | None = None, statistics: ScreenStatistics | None = None, emphasis: Array | None = None,
                 seen: Array | None = None, detach_time: bool = False) -> dict[str, Array]:
        """d loss / d parameters by name, [N, ...], from d loss / d rgb [h, w, 3], alpha [h, w] and depth [h, w] (None: zeros).

        into         the gradients [N, ...] of the step's earlier views, by name, to which these are added; returned again
        statistics   to which this view is added
        emphasis     [h, w], by which each pixel's absolute gradients are multiplied in the statistics; None: 1
        seen         [N] in which the Gaussians that were drawn become 1
        detach_time  mu_tau's gradient comes through the temporal opacity alone, as STG trains
        """

    # one step

    def begin_step(self) -> int:
        """From here to end_step() the backend may guess how large the things are that forward() makes, so that it need not wait for them.
        Returns how many further steps had better begin before this one's end is asked for."""

    def end_step(self, *arrays: Array) -> Callable[[], list[np.ndarray] | None]:
        """A function that gives read() of the arrays [...], as [...] each, and waits for the device as far as it has to; further steps may
        begin before it is called.  It gives None where a guess was wrong: this step and those after it have then left the statistics,
        the parameters and Adam's moments as they were, and have to be taken again.  The functions are called in the order of their
        steps; after None those that were made before are not called any more.  All forward() of a step come before its first
        backward()."""

    def rows(self, seen: Array, frozen: int = 0) -> Rows:
        """The Gaussians, but for the first `frozen`, whose value in seen [N] is not 0.  seen may be written to."""

    def count(self, rows: Rows) -> Array:
        """The number of these rows, [1] float64."""

    def steps_since(self, rows: Rows, moved: Array, step: int) -> Array:
        """[N]: for the rows, step - moved (the steps that their next move stands for); 0 for all others.  moved [N] int64: the step in
        which each Gaussian moved last."""

    def motion_penalty(self, norm: MotionNorm, motion: Array, gradient: Array, scale: float, since: Array) -> Array:
        """The penalty of motion [N, K, 3], [1] float64; scale * since[n] * its gradient is added to gradient [N, K, 3]."""

    def anchor(self, features: Array, target: Array, gradient: Array, rows: Rows, strength: float) -> None:
        """Add strength * (features [N, F] - target) to the gradient [N, F] of those rows whose target [N, F] is not NaN."""

    def mcmc_penalty(self, parameters: dict[str, Array], gradients: dict[str, Array], opacity_weight: float, scale_weight: float,
               extent: float) -> None:
        """Add to the gradients those of opacity_weight mean(sigmoid(opacity)) + scale_weight mean(exp(scale)) / extent (MCMC).  Of the
        parameters, opacity [N] and scale [N, 3] are looked at."""

    def mcmc_noise(self, parameters: dict[str, Array], reach: float, key: tuple[int, ...], frozen: int = 0) -> None:
        """Move nearly transparent Gaussians, but for the first `frozen`, at random, each in its own shape, by about reach (MCMC); key:
        whole numbers that decide the random numbers.  Of the parameters, position [N, 3] is written to."""

    def adam(self, rows: Rows, tensors: list[tuple], betas: tuple[float, float], moved: Array, step: int,
             since: Array | None = None) -> None:
        """A step of Adam in place, against the gradients, for these rows alone, each as far as cpu.adam.reach() says; moved [N] int64
        becomes `step` there.

        tensors  (value, gradient, mean, square, count [len(value)] int32, rate, floor, shared) each: mean and square are Adam's moments
                 of the value's shape; count is how many steps each row has taken; rate is a number, or one for each column of a row;
                 floor is Adam's epsilon, 1e-15 at least; of a shared array all rows move.  A gradient that is not finite counts as zero
        since    steps_since(rows, moved, step), where it is known
        """

    # before training; NumPy arrays in and out

    def nearest(self, points: np.ndarray, turns: list[np.ndarray], count: int, leaf: int) -> tuple[np.ndarray, np.ndarray]:
        """The numbers [P, count] int32 of the nearest of each point [P, D] within the leaves, of at most `leaf` points, of k-d trees of
        the points turned by each matrix [D, D], and their squared distances float32, the nearest first; -1 and inf where there is none."""

    def project_points(self, xyz: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Pixels [P, 2] and depths [P] float64 of world points [P, 3]."""

    def sweep(self, image: np.ndarray, others: list[tuple[np.ndarray, np.ndarray, np.ndarray]], planes: np.ndarray, outside: float,
              reach: int) -> np.ndarray:
        """Plane sweep: mean absolute differences of colour [D, h, w] between image [h, w, 3] and the better half of the other pictures
        that show it, were its surface on each of the planes [D, 3]; averaged over (2 reach + 1)^2 pixels; outside: where a picture ends.

        planes   the pixel (u, v) has the inverse depth plane @ (u, v, 1): (0, 0, 1 / z) faces the camera at the depth z
        others   (picture [h', w', 3], turn [3, 3], shift [3]): the pixel (u, v) at depth z is seen by the other camera at
                 turn @ (u, v, 1) z + shift (homogeneous)
        """

    def vote(self, xyz: np.ndarray, rgb: np.ndarray, camera: Camera, image: np.ndarray, depth: np.ndarray, cost: np.ndarray, near: float,
             alike: float, sure: float, agree: np.ndarray, against: np.ndarray) -> None:
        """Add 1 to agree [P] where an image [h, w, 3] of depth [h, w] and cost [h, w] agrees with points xyz [P, 3] of colours rgb [P, 3],
        to against [P] where it is against: where depth / z - 1 is within `near`, by whether the mean difference of colour is below `alike`;
        above twice `near`, at a cost below `sure`, it sees through the point and is against."""

    def resample(self, image: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """image [H, W, C] uint8 or float32 at positions [h, w, 2] float32 (x, y, pixels' centres at +0.5): [h, w, C]; 0 outside."""

    # for measurements

    def measure_stages(self, instance: ViewedInstance, camera: Camera, repeat: int) -> tuple[dict[str, float], int]:
        """Milliseconds of each stage of draw() by name, the median of `repeat` runs, and the number of splats that are drawn."""


class SurfaceBackend(Protocol):
    """The operations that make_mesh() needs; "cpu" has them.  NumPy arrays in and out."""

    def carve(self, depths: np.ndarray, slopes: np.ndarray, poses: np.ndarray, low: np.ndarray, voxel: float, shape: tuple[int, int, int],
              reach: float, agree: int, progress: Callable[[float], Any] | None = None) -> np.ndarray:
        """Distances [X, Y, Z] float32 of a volume's points from what V orthographic views see, within -reach..reach; positive before it.

        depths, slopes  [V, h, w]: the depth of each pixel (inf: nothing there; NaN: unknown), and what distances along z are multiplied by
                        to be distances from the surface
        poses           [V, 3, 4] float64: a point of the world to pixels and depth (x, y, z)
        low, voxel      the first point [3], and the distance of neighbours
        agree           so many views must see a point before the surface: its distance is the least of the `agree` largest
        """

    def around(self, points: np.ndarray, normals: np.ndarray, places: np.ndarray, axes: np.ndarray, weights: np.ndarray, reach: float,
               count: int) -> tuple[np.ndarray, np.ndarray]:
        """The Gaussians that weigh most at points of a surface: (numbers [P, count], -1 where there are fewer; their weights there).

        points, normals  [P, 3] float64
        places, axes     [N, 3] float64: centres, and shortest axes
        weights          [N] float64, at a point multiplied by exp(-4 d^2 / reach^2) of the distance d and by 0.05 + cos^2 of the angle
                         between normal and axis
        reach            no Gaussian farther away counts
        """

    def affine_weights(self, points: np.ndarray, places: np.ndarray, number: np.ndarray, weight: np.ndarray, reaches: np.ndarray,
                       ridge: float) -> np.ndarray:
        """Weights [V, k] of Gaussians at points whose sums are 1 and follow every affine motion of the Gaussians (moving least squares).

        points [V, 3], places [N, 3]  float64
        number, weight                [V, k] of Gaussians around each point, and how much each counts; rows of 0 stay 0
        reaches                       [V] the unit of length at each point
        ridge                         added to the mean squares of the Gaussians' ways from the point, in that unit
        """

    def places(self, position: np.ndarray, motion: np.ndarray, weights: np.ndarray, wanted: np.ndarray, out: np.ndarray) -> None:
        """Write the places of the wanted [N] Gaussians into out [N, 3] float64: position [N, 3] + sum_k weights_k motion [N, K, 3], with
        weights [1, K], or [N, K] if each Gaussian has its own."""

    def weighted_sums(self, values: np.ndarray, number: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Sums [V, D] of values [N, D] of numbers [V, k] with weights [V, k], float64."""

    def support(self, opacity: np.ndarray, number: np.ndarray, weight: np.ndarray, before: np.ndarray) -> np.ndarray:
        """The shares [V] of opacities that are left: those of Gaussians [N], as far as not above those before [V, k], by these."""

    def smoothed(self, values: np.ndarray, first: np.ndarray, other: np.ndarray, rounds: int, share: float) -> np.ndarray:
        """Values [V, D] float64 of which, so many times, a share is replaced by the mean of the neighbours': those of v are
        other[first[v]:first[v + 1]], of first [V + 1]; where there are none, their mean counts as 0."""


class Light(Protocol):
    """The light of a picture of some instances, by the Gaussians that it comes from."""

    def over(self, masks: np.ndarray) -> list[np.ndarray]:
        """Of each instance, the sums of its Gaussians' blending weights over pixels, each times the masks [h, w, M <= 3]: [N, M]."""

    def alone(self) -> list[np.ndarray]:
        """Of each instance, the sum of the weights of each of its Gaussians if nothing lay before it and the picture had no edge: [N]."""


class SelectingBackend(Protocol):
    """The operation that selecting what is seen needs; "cpu" has it."""

    def light(self, instances: list[ViewedInstance], camera: Camera) -> Light:
        """Draw the instances, for Light."""
