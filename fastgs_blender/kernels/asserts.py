# SPDX-License-Identifier: GPL-3.0-or-later
"""What every backend asserts of its arguments, at the entry of the operations of protocol.py: shapes that belong together.

A function here has the name of the operation that calls it first.  A failed assertion is a fault of this program and not of a file:
what comes from outside has been checked before (util/errors.py).
"""
from collections.abc import Callable
from typing import Any

from ..model.gaussians import GaussianModel
from .parameters import DECODER


def shapes(*checked: tuple[Any, str]) -> None:
    """Assert that arrays have the shapes beside them, as in shapes((rgb, "h w 3"), (alpha, "h w")).

    A letter stands for the same size in all of them; "..." for any further dimensions; an array may be None.
    """
    sizes: dict[str, int] = {}
    for array, wanted in checked:
        if array is None:
            continue
        names, found = wanted.split(), tuple(array.shape)
        if names[-1] == "...":
            names, found = names[:-1], found[:len(names) - 1]
        fits = len(names) == len(found) and all(size == (int(name) if name.isdigit() else sizes.setdefault(name, size))
                                                for name, size in zip(names, found, strict=True))
        assert fits, f"an array {list(array.shape)} instead of [{', '.join(wanted.split())}], where {sizes}"


def _decoder(arrays: Any) -> list[tuple[Any, str]]:
    """The decoder's matrices among arrays by name, each with its shape."""
    return [(arrays.get(name), shape) for name, shape in zip(DECODER, ("6 12", "3 6"), strict=True)]


def _of(**wanted: str) -> Callable[..., None]:
    """A function that asserts the shapes of its arguments, in this order."""
    return lambda *arrays: shapes(*zip(arrays, wanted.values(), strict=True))


surface = _of(triangles="f 3 3")  # and the holdout of draw() and expose()
view_box = _of(points="3 p", view="3 4")
past_splats = _of(points="3 p", over="p")  # and past_triangles()
posed = _of(index="m")
spread = _of(position="3 p", axes="3 3 p", place="3", within="s 2")
painted = _of(index="m", places="m 3", light="l 4 3 m", unlit="m 3")
thinnest = _of(places="n 3", axes="3 3 n", opacity="n", towards="4", turn="3 3")
carve = _of(depths="v h w", slopes="v h w", poses="v 3 4", low="3")
around = _of(points="p 3", normals="p 3", places="n 3", axes="n 3", weights="n")
affine_weights = _of(points="v 3", places="n 3", number="v k", weight="v k", reaches="v")
weighted_sums = _of(values="n d", number="v k", weight="v k")
support = _of(opacity="n", number="v k", weight="v k", before="v k")
smoothed = _of(values="v d", first="e")
project_points = _of(xyz="p 3")
vote = _of(xyz="p 3", rgb="p 3", image="h w 3", depth="h w", cost="h w", agree="p", against="p")
resample = _of(image="a b c", positions="h w 2")
steps_since = _of(moved="n")
anchor = _of(features="n f", target="n f", gradient="n f")


def forward(parameters: Any, template: GaussianModel) -> None:
    """TrainingBackend.forward()."""
    assert template.arrays.keys() <= parameters.keys(), "parameters of another kind of model"
    for name, array in template.arrays.items():
        shapes((parameters["position"], "n 3"), (parameters[name], " ".join(["n", *map(str, array.shape[1:])])))
    shapes(*_decoder(parameters))


def compare(picture: Any, target: Any, weight: Any, background: Any, least: Any) -> None:
    """TrainingBackend.compare()."""
    shapes((picture.rgb, "h w 3"), (picture.alpha, "h w"), (target, "h w 3"), (weight, "h w"), (background, "3"), (least, "h w 3"))


def agreement(picture: Any, target: Any, weight: Any, least: Any, background: Any, gain: Any, bias: Any, sides: Any) -> None:
    """TrainingBackend.agreement()."""
    compare(picture, target, weight, background, least)
    shapes((gain, "3"), (bias, "3"), (target, "h w 3"), *((side.rgb, "h w 3") for side in sides or ()))


def over(picture: Any, background: Any) -> None:
    """TrainingBackend.over()."""
    shapes((picture.rgb, "h w 3"), (picture.alpha, "h w"), (background, "3"))


def backward(picture: Any, rgb: Any, alpha: Any, depth: Any, into: Any, statistics: Any, emphasis: Any, seen: Any) -> None:
    """TrainingBackend.backward()."""
    sums = () if statistics is None else (statistics.gradient, statistics.absolute, statistics.seen, statistics.radius)
    shapes((picture.alpha, "h w"), (rgb, "h w 3"), (alpha, "h w"), (depth, "h w"), (emphasis, "h w"), (seen, "n"),
           *((array, "n") for array in sums),
           *((array, "n ...") for name, array in (into or {}).items() if name not in DECODER), *_decoder(into or {}))


def motion_penalty(norm: Any, motion: Any, gradient: Any, since: Any) -> None:
    """TrainingBackend.motion_penalty()."""
    shapes((motion, "n k 3"), (gradient, "n k 3"), (since, "n"), (norm.matrix, "r k"))
    rows = motion.shape[1] if norm.matrix is None else len(norm.matrix)
    shapes((norm.weights, str(3 * rows)))


def mcmc_penalty(parameters: Any, gradients: Any) -> None:
    """TrainingBackend.mcmc_penalty()."""
    shapes(*((arrays[name], wanted) for arrays in (parameters, gradients) for name, wanted in (("opacity", "n"), ("scale", "n 3"))))


def mcmc_noise(parameters: Any) -> None:
    """TrainingBackend.mcmc_noise()."""
    shapes(*((parameters[name], wanted) for name, wanted in (("opacity", "n"), ("position", "n 3"), ("scale", "n 3"), ("rotation", "n 4"))))


def adam(tensors: Any, moved: Any) -> None:
    """TrainingBackend.adam()."""
    for value, gradient, mean, square, count, _, _, shared in tensors:
        same = " ".join(["n", *map(str, value.shape[1:])])
        shapes((value, same), (gradient, same), (mean, same), (square, same), (count, "n"), (None if shared else moved, "n"))


def nearest(points: Any, turns: Any) -> None:
    """TrainingBackend.nearest()."""
    shapes((points, "p d"), *((turn, "d d") for turn in turns))


def places(position: Any, motion: Any, weights: Any, wanted: Any, out: Any) -> None:
    """SurfaceBackend.places()."""
    shapes((position, "n 3"), (motion, "n k 3"), (weights, "n k" if len(weights) > 1 else "1 k"), (wanted, "n"), (out, "n 3"))


def sweep(image: Any, others: Any, planes: Any) -> None:
    """TrainingBackend.sweep()."""
    shapes((image, "h w 3"), (planes, "d 3"))
    for other, turn, shift in others:
        shapes((other, "a b 3"), (turn, "3 3"), (shift, "3"))
