# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies beside a window is left out before it is projected: it is what the same splats of the whole picture say, and no more."""
from dataclasses import replace

import numpy as np
import pytest
from random_cameras import hostile_scales, random_camera

from fastgs_blender.kernels.cpu import raster
from fastgs_blender.kernels.cpu.splats import project_instances
from fastgs_blender.rendering.instances import Instance, ObjectSettings
from fastgs_blender.rendering.layout import Layout

SETTINGS = {"plain": ObjectSettings(), "resized": ObjectSettings(splat_scale=2.5, min_size=0.02, opacity=1.5),
            "sampled": ObjectSettings(pixel_size=0.05), "straight": ObjectSettings(bends=False)}
WINDOWS = [(0, 0, 40, 30), (150, 110, 17, 60), (280, 200, 40, 40), (310, 3, 3, 200)]


@pytest.mark.parametrize("looks", SETTINGS)
def test_a_window_has_the_splats_that_reach_into_it(make_model, looks):
    seen = beside = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        model = make_model(rng, 400)
        model = replace(model, scale=hostile_scales(rng, len(model)).astype(np.float32))
        camera = random_camera(rng, 320, 240)
        whole = splats(model, camera, SETTINGS[looks])
        for x0, y0, width, height in WINDOWS:
            part = splats(model, replace(camera, window=(x0, y0, width, height)), SETTINGS[looks])
            inside, around = ({source for source, (x, y, rx, ry) in whole.items()
                               if x + rx + slack >= x0 + 0.5 and x - rx - slack <= x0 + width - 0.5
                               and y + ry + slack >= y0 + 0.5 and y - ry - slack <= y0 + height - 0.5} for slack in (-0.002, 0.001))
            assert inside <= part.keys() <= around  # radii are float32, and a thousandth longer
            assert all(part[source] == whole[source] for source in part)
            seen, beside = seen + len(part), beside + len(whole) - len(part)
    assert seen > 1000 and beside > 1000


def splats(model, camera, settings):
    """Of those Gaussians that a camera's window shows: centre and radii, in pixels."""
    viewed = [Instance(model, np.diag([1.5, 1.5, 1.5, 1.0]), 0.3, settings).viewed(camera)]
    found = project_instances(viewed, camera, Layout(viewed, False))
    rows = found.index
    numbers = np.concatenate([found.geometry[rows, :2], found.attributes[rows, raster.RADIUS_X:raster.RADIUS_Y + 1]], 1)
    return dict(zip(found.source[rows].tolist(), map(tuple, numbers), strict=True))
