# SPDX-License-Identifier: GPL-3.0-or-later
"""Decodes pictures of blended features with a model's decoder, on all threads; forward and backward pass."""
from __future__ import annotations

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import ACTIVATIONS, Features, lifted
from ...rendering.instances import LIMIT, ViewedInstance
from ...rendering.layout import Layout
from ...rendering.looks import Look, graded_picture
from ...util.threads import portions, ranges, run
from .decode import decode
from .decode_backward import decode_backward as decode_rows_backward
from .splats import plain

FEATURES = 9
"""Channels of a picture of one decoder's features alone."""


class Decoder:
    """Premultiplied colour [h, w, 3] of blended features [h, w, C >= 9] with their weight, in whole rows of a camera's window; see
    rendering.oracle.decode_features.

    Where the decoder is given the sum, it is given the mean of a weight of 1.
    """

    def __init__(self, instance: ViewedInstance, camera: Camera, way: str):
        self.instance, self.way, self.inputs = instance, way, _decoder_inputs(instance, camera)

    def __call__(self, features, weight, top: int, out: np.ndarray) -> None:
        """Write the colour of the rows from y = top on."""
        full = weight if self.way == "normalised" else np.ones(weight.shape, np.float32)
        self._decode(features, full, top, out)
        if self.way == "lifted":
            appearance, empty = self.instance.model.appearance, np.empty_like(out)
            assert isinstance(appearance, Features)
            self._decode(np.zeros(features.shape, np.float32), full, top, empty)
            colour = lifted(out, empty, weight, appearance)
            out[:], full = np.where(np.abs(colour) <= LIMIT, colour, 0), weight
        if self.instance.look[Look.GRADED]:
            out[:] = graded_picture(out, full, self.instance.look)

    def _decode(self, features, weight, top: int, out: np.ndarray) -> None:
        """Write the decoder's colour, times the weight [h, w], of the features divided by it."""
        rest = (np.ascontiguousarray(features), np.ascontiguousarray(weight), *self.inputs, top, out)
        run(lambda first, last: decode(first, last, *rest), portions(len(out), 64, 8))


def decoder_of(layout: Layout, camera: Camera) -> Decoder | None:
    """What decodes a picture of one decoder's features alone, by rows of tiles, so that they are never kept; None where it has more."""
    group = layout.groups[0]
    return Decoder(group.instance, camera, group.decode) if layout.channels == FEATURES and group.instance else None


def decode_features(features, weight, instance: ViewedInstance, camera: Camera, way: str) -> np.ndarray:
    """What a Decoder makes of a whole picture."""
    out = np.empty((*weight.shape, 3), np.float32)
    Decoder(instance, camera, way)(features, weight, camera.window[1], out)
    return out


def decode_backward(features, weight, instance: ViewedInstance, camera: Camera, grad, way: str):
    """From d loss / d colour [h, w, 3] to that of features [h, w, C], weight [h, w] (None: zeros), w1 [6, 12] and w2 [3, 6].

    way: "normalised" or "premultiplied", see Decoder.  Every piece of rows has its own sums for the matrices, added in order: the
    same bytes for any number of threads.
    """
    summed = way == "premultiplied"
    weight = np.ones(weight.shape, np.float32) if summed else weight
    pieces = ranges(camera.window[3], 32)
    grad_features, grad_weight = np.empty(features.shape, np.float32), np.empty(weight.shape, np.float32)
    grad_w1, grad_w2 = np.empty((len(pieces), 6, 12)), np.empty((len(pieces), 3, 6))
    rest = (np.ascontiguousarray(features), np.ascontiguousarray(weight), *_decoder_inputs(instance, camera), camera.window[1],
            np.ascontiguousarray(grad, np.float32), grad_features, grad_weight)
    run(lambda i, piece: decode_rows_backward(*piece, *rest, grad_w1[i], grad_w2[i]), enumerate(pieces))
    return grad_features, None if summed else grad_weight, grad_w1.sum(0).astype(np.float32), grad_w2.sum(0).astype(np.float32)


def _decoder_inputs(instance, camera):
    """What decode.decode and its backward pass take between the pictures and the first row's place."""
    appearance: Features = instance.model.appearance
    to_model = np.ascontiguousarray(np.concatenate([instance.camera_to_model[:3, :3], instance.camera_to_model[None, :3, 3]]))
    lens = (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy))
    return (plain(appearance.w1), plain(appearance.w2), ACTIVATIONS.index(appearance.activation), to_model, lens, bool(camera.orthographic),
            camera.window[0])
