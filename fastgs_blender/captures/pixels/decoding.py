# SPDX-License-Identifier: GPL-3.0-or-later
"""Decodes shots to the pixels that the cache keeps: undistorted, scaled, with the product of alpha and mask in one channel.

Where a shot has both, another channel has the alpha alone.
"""
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ...util.errors import FastGSError
from ...util.reading import reading
from ..capture import Shot
from . import pictures
from .probe import facts
from .undistortion import positions_of, resample
from .video import frames


def shape(shot: Shot, scale: float) -> tuple[int, int, int]:
    """(h, w, channels) of the array that decode() makes; scale is the capture's, for shots without a camera."""
    found = facts(shot.image)
    width, height = (shot.camera.width, shot.camera.height) if shot.camera else (max(1, round(v * scale)) for v in found[:2])
    return height, width, 3 + bool(found.alpha) + (shot.mask is not None)


def decode(shots: Iterable[Shot], scale: float) -> Iterator[tuple[Shot, np.ndarray | FastGSError]]:
    """Every shot with its pixels [h, w, 3 to 5], or its error: straight display colours, then mask, then alpha where there is a mask file
    too; uint8 or, for deep files, uint16.

    Shots of one video are decoded in one pass, so they come ordered by frame.
    """
    shots = list(shots)
    for shot in shots:
        if shot.image.frame is None:
            yield shot, _attempt(shot, lambda shot: _finished(shot, scale, *pictures.read(shot.image)))
    videos: dict = {}
    for shot in shots:
        if shot.image.frame is not None:
            videos.setdefault(shot.image.path, {}).setdefault(shot.image.frame, []).append(shot)
    for path, wanted in videos.items():
        yield from _decode_video(path, wanted, scale)


def _decode_video(path: Path, wanted: dict[int, list[Shot]], scale: float) -> Iterator[tuple[Shot, np.ndarray | FastGSError]]:
    left = dict(wanted)
    try:
        for number, rgb in frames(path, list(wanted)):
            for shot in left.pop(number):
                yield shot, _attempt(shot, partial(lambda rgb, shot: _finished(shot, scale, pictures.graded(rgb, shot.image), None), rgb))
    except FastGSError as error:
        for shots in left.values():
            yield from ((shot, error) for shot in shots)


def _attempt(shot: Shot, work: Callable[[Shot], np.ndarray]) -> np.ndarray | FastGSError:
    try:
        with reading(shot.image):
            return work(shot)
    except FastGSError as error:
        return error


def _finished(shot: Shot, scale: float, rgb: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    height, width = rgb.shape[:2]
    expected = shot.image.intrinsics
    if expected is not None and (width, height) != (expected.width, expected.height):
        raise FastGSError(f"{shot.image}: it has {width} x {height} pixels instead of {expected.width} x {expected.height}.")
    mask = alpha
    if shot.mask is not None:
        grey = pictures.read_grey(shot.mask)
        if grey.shape != (height, width):
            raise FastGSError(f"{shot.mask}: the mask has {grey.shape[1]} x {grey.shape[0]} pixels, its picture {width} x {height}.")
        mask = grey if mask is None else _unit(grey) * _unit(mask)
    both = shot.mask is not None and alpha is not None
    return _reshaped(shot, scale, rgb, alpha, [plane for plane in (mask, alpha if both else None) if plane is not None])


def _reshaped(shot: Shot, scale: float, rgb: np.ndarray, alpha: np.ndarray | None, further: list[np.ndarray]) -> np.ndarray:
    target = shape(shot, scale)[:2]
    deep = rgb.dtype == np.float32
    positions = None if shot.camera is None else positions_of(shot)
    if positions is None and target == rgb.shape[:2]:
        planes = [rgb if not deep else _bytes(rgb, deep), *(_bytes(plane, deep)[..., None] for plane in further)]
        return np.ascontiguousarray(np.concatenate(planes, -1))
    if positions is None:
        move = lambda plane: shrink(plane, target)  # noqa: E731
    else:
        move = lambda plane: resample(plane if plane.ndim == 3 else plane[..., None], positions).reshape(*target, *plane.shape[2:])  # noqa: E731
    if alpha is None:
        colours = move(rgb)
    else:  # what is transparent has no colour to mix in
        a = _unit(alpha)
        share = move(a)
        colours = move(_unit(rgb) * a[..., None]) / np.maximum(share, 1e-6)[..., None]
    colours = _bytes(colours / 255 if rgb.dtype == np.uint8 and colours.dtype != np.uint8 and alpha is None else colours, deep)
    return np.ascontiguousarray(np.concatenate([colours, *(_bytes(move(_unit(plane)), deep)[..., None] for plane in further)], -1))


def _unit(plane: np.ndarray) -> np.ndarray:
    return plane.astype(np.float32) / 255 if plane.dtype == np.uint8 else plane


def _bytes(plane: np.ndarray, deep: bool) -> np.ndarray:
    if plane.dtype == np.uint8 and not deep:
        return plane
    most, kind = (65535, np.uint16) if deep else (255, np.uint8)
    return np.floor(np.clip(_unit(plane), 0, 1) * most + 0.5).astype(kind)


def shrink(plane: np.ndarray, target: tuple[int, int]) -> np.ndarray:
    """A plane [H, W] or [H, W, 3], uint8 or float32, at the size target (h, w): each pixel the mean of the area it covers."""
    from PIL import Image

    height, width = plane.shape[:2]
    factor = round(width / target[1]), round(height / target[0])
    if plane.dtype == np.uint8 and (target[1] * factor[0], target[0] * factor[1]) == (width, height):
        return np.asarray(Image.fromarray(plane).reduce(factor))  # the same, many times faster
    return _narrow(_narrow(plane, target[0], 0), target[1], 1)


def _narrow(plane: np.ndarray, count: int, axis: int) -> np.ndarray:
    """Means over `count` equal parts of an axis, whose ends may lie within pixels; float32."""
    length = plane.shape[axis]
    ends = np.arange(count + 1) * (length / count)
    first = np.floor(ends[:-1] + 1e-9).astype(int)
    out = np.zeros([count if i == axis else n for i, n in enumerate(plane.shape)], np.float32)
    for k in range(int(np.ceil(length / count)) + 1):
        share = np.clip(np.minimum(first + k + 1, ends[1:]) - np.maximum(first + k, ends[:-1]), 0, None) * (count / length)
        weights = share.astype(np.float32).reshape([-1 if i == axis else 1 for i in range(plane.ndim)])
        out += np.take(plane, np.minimum(first + k, length - 1), axis) * weights
    return out
