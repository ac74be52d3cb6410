# SPDX-License-Identifier: GPL-3.0-or-later
"""All that a backend computes of a view in training, to be compared with another backend or with itself."""
from __future__ import annotations

from types import SimpleNamespace

import numpy as np

import fastgs_blender as fg

HEIGHT, WIDTH = 40, 48


def two_passes(backend, model, camera, t, goal, weight, background, by_depth, detach, band=0.0, least=None) -> dict[str, np.ndarray]:
    """Everything that forward(), compare() and backward() give, the gradients added up over two views."""
    parameters = dict(model.arrays)
    if isinstance(model.appearance, fg.Features):
        parameters |= {"w1": model.appearance.w1, "w2": model.appearance.w2}
    parameters = {name: backend.array(array.copy()) for name, array in parameters.items()}
    statistics = SimpleNamespace(**{name: backend.zeros((len(model),)) for name in ("gradient", "absolute", "seen", "radius")})
    seen = backend.zeros((len(model),))
    picture = backend.forward(parameters, model, camera, t, by_depth is not None, band)
    target, *bounds = (None if values is None else backend.array(values) for values in (goal, weight, least))
    loss = backend.compare(picture, target, bounds[0], background, 0.2, 0.01, 0.5, bounds[1])
    sides = [backend.forward(parameters, model, camera, t + apart) for apart in (0.01, -0.01)]
    three = np.array([0.1, 0.0, -0.1])
    agreement = backend.agreement(picture, target, *bounds, background, 1 + three, three, None if detach else sides, 0.02, 0.3, 0.1)
    over, cover = backend.over(picture, background)
    depth = None if by_depth is None else backend.array(by_depth)
    gradients = backend.backward(picture, loss.rgb, loss.alpha, depth, statistics=statistics, emphasis=loss.emphasis, seen=seen,
                                 detach_time=detach)
    gradients = backend.backward(picture, loss.rgb, loss.alpha, into=gradients, detach_time=detach)
    found = {**gradients, **vars(statistics), "drawn": seen, "picture": picture.rgb, "cover": picture.alpha, "by rgb": loss.rgb,
             "by alpha": loss.alpha, "emphasis": loss.emphasis, "values": loss.values, "agreement": agreement, "over": over,
             "over cover": cover}
    return {name: np.array(backend.numpy(array)) for name, array in found.items()}
