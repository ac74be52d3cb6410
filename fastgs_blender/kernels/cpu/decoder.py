# SPDX-License-Identifier: GPL-3.0-or-later
"""Decodes pictures of blended features with a model's decoder, on all threads; forward and backward pass."""
from __future__ import annotations

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import ACTIVATIONS, Features, lifted
from ...rendering.instances import LIMIT, ViewedInstance
from ...rendering.looks import graded_picture
from ...util.threads import ranges, run
from .decode import decode
from .decode_backward import decode_backward as decode_rows_backward
from .splats import plain


def decode_features(features, weight, instance: ViewedInstance, camera: Camera, way: str) -> np.ndarray:
    """Premultiplied colour [h, w, 3] of blended features [h, w, C >= 9]; see rendering.oracle.decode_features.

    Where the decoder is given the sum, it is given the mean of a weight of 1.
    """
    if way == "normalised":
        return graded_picture(_decoded(features, weight, instance, camera), weight, instance.look)
    full = np.ones(weight.shape, np.float32)
    colour, appearance = _decoded(features, full, instance, camera), instance.model.appearance
    if way == "premultiplied":
        return graded_picture(colour, full, instance.look)
    assert isinstance(appearance, Features)
    colour = lifted(colour, _decoded(np.zeros(features.shape, np.float32), full, instance, camera), weight, appearance)
    return graded_picture(np.where(np.abs(colour) <= LIMIT, colour, 0), weight, instance.look)


def _decoded(features, weight, instance: ViewedInstance, camera: Camera) -> np.ndarray:
    """The decoder's colour, times the weight [h, w], of the features divided by it."""
    _, _, width, height = camera.window
    out, inputs = np.empty((height, width, 3), np.float32), _decoder_inputs(features, weight, instance, camera)
    run(lambda first, last: decode(first, last, *inputs, out), ranges(height, 64))
    return out


def decode_backward(features, weight, instance: ViewedInstance, camera: Camera, grad, way: str):
    """From d loss / d colour [h, w, 3] to that of features [h, w, C], weight [h, w] (None: zeros), w1 [6, 12] and w2 [3, 6].

    way: "normalised" or "premultiplied", see decode_features.  Every piece of rows has its own sums for the matrices, added in order: the
    same bytes for any number of threads.
    """
    summed = way == "premultiplied"
    weight = np.ones(weight.shape, np.float32) if summed else weight
    pieces = ranges(camera.window[3], 32)
    grad_features, grad_weight = np.empty(features.shape, np.float32), np.empty(weight.shape, np.float32)
    grad_w1, grad_w2 = np.empty((len(pieces), 6, 12)), np.empty((len(pieces), 3, 6))
    rest = (*_decoder_inputs(features, weight, instance, camera), np.ascontiguousarray(grad, np.float32), grad_features, grad_weight)
    run(lambda i, piece: decode_rows_backward(*piece, *rest, grad_w1[i], grad_w2[i]), enumerate(pieces))
    return grad_features, None if summed else grad_weight, grad_w1.sum(0).astype(np.float32), grad_w2.sum(0).astype(np.float32)


def _decoder_inputs(features, weight, instance, camera):
    """What decode.decode and its backward pass take between the rows and the picture."""
    appearance: Features = instance.model.appearance
    x0, y0, _, _ = camera.window
    to_model = np.ascontiguousarray(np.concatenate([instance.camera_to_model[:3, :3], instance.camera_to_model[None, :3, 3]]))
    lens = (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy))
    return (np.ascontiguousarray(features), np.ascontiguousarray(weight), plain(appearance.w1), plain(appearance.w2),
            ACTIVATIONS.index(appearance.activation), to_model, lens, x0, y0, bool(camera.orthographic))
