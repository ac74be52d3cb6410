# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur and depth of field on the GPU: the CPU's pictures, sample by sample added up on the device."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
from fastgs_blender.kernels.gpu import expose
from fastgs_blender.kernels.gpu.device import Device
from fastgs_blender.rendering.crops import Crop
from fastgs_blender.rendering.exposure import Aperture, Exposure
from fastgs_blender.rendering.instances import Instance, Moment, ObjectSettings
from fastgs_blender.rendering.passes import PassSettings

CLOSE, MEAN = 2e-3, 1e-5
LENS = Aperture(0.15, 2.5, samples=8)
TRIANGLES = np.array([[[-1, -1, 0.3], [1, -1, 0], [0, 1, -0.3]], [[0, 0, 1], [0.5, 0, 1], [0, 0.7, 0.8]]], np.float32)


@pytest.fixture(scope="module")
def scene():
    """Two instances with colours of every kind, one with a decoder, before a camera whose window is a part of the image."""
    rng = np.random.default_rng(3)
    instances = [Instance(random_model(rng, 120, "fourier", "line", "radial", look, size=0.1), np.eye(4), 0.3, name=look, index=i, place=i)
                 for i, look in enumerate(("sh1", "sigmoid"))]
    return instances, fg.Camera(76, 60, 50, 50, 38, 30, random_pose(rng, 3.0), window=(5, 3, 66, 50))


def moving(scene) -> Exposure:
    """An exposure while which one object, the camera and a crop move, and a look changes."""
    instances, camera = scene
    place = np.eye(4)
    place[:3, 3] = 0.4, 0.1, 0.2
    cut = [replace(instances[1], settings=ObjectSettings(crops=[Crop(move)], saturation=grey))
           for move, grey in ((np.eye(4), 1.0), (place, 0.0))]
    first, later = {0: instances[0], 1: cut[0]}, {0: replace(instances[0], placement=place), 1: cut[1]}
    turned = replace(camera, fx=54.0, fy=54.0)
    return Exposure(moments=(Moment(first, camera, TRIANGLES), Moment(later, turned, TRIANGLES + np.float32(0.1))),
                    curve=(0.0, 1.0, 1.0), steps=8)


CASES = {
    "the model moves": (lambda scene: Exposure(-0.3, 0.3, steps=8), {}),
    "too few steps, so splats are drawn out": (lambda scene: Exposure(-3, 3, steps=2), {}),
    "a lens": (lambda scene: Exposure(aperture=LENS), {}),
    "a lens with too few points": (lambda scene: Exposure(aperture=Aperture(0.2, 2.0, blades=5, samples=4)), {}),
    "objects, camera and meshes move": (moving, {"holdout": TRIANGLES}),
    "all at once, sorted by pixel": (lambda scene: Exposure(-1, 1, steps=4, aperture=LENS),
                                     {"holdout": TRIANGLES, "settings": PassSettings(sorting="pixel")}),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_exposures_agree_with_the_cpu(gpu, adapter, scene, case):
    exposure, options = CASES[case]
    passes = ("rgb", "alpha", "cryptomatte_00") + ("holdout",) * ("holdout" in options)
    given = {"passes": passes, "exposure": exposure(scene), **options}
    wanted, found = (fg.render(*scene, backend=name, **given) for name in ("cpu", f"gpu:{adapter.name}"))
    sharp = fg.render(*scene, backend=f"gpu:{adapter.name}", passes=("alpha",), **options)["alpha"]
    assert np.abs(sharp - found["alpha"]).max() > 0.02, "something is blurred"
    for name in passes:
        difference = np.abs(found[name] - wanted[name])
        assert difference.max() <= CLOSE and difference.mean() <= MEAN and wanted[name].any(), name
    again = fg.render(*scene, backend=f"gpu:{adapter.name}", **given)
    assert all(np.array_equal(found[name], again[name]) for name in passes)


def test_no_picture_is_read_back_between_samples(gpu, adapter, scene, monkeypatch):
    """Only snapshots before them, the film after them, and of each sample the number of entries of its tile lists."""
    sizes, read = [], Device.read
    monkeypatch.setattr(Device, "read", lambda self, buffer, dtype, count, begin=0: sizes.append(count) or read(
        self, buffer, dtype, count, begin))
    drawn, draw = [], expose.Taken._add
    monkeypatch.setattr(expose.Taken, "_add", lambda self, *given: drawn.append(len(sizes)) or draw(self, *given))
    fg.render(*scene, backend=f"gpu:{adapter.name}", exposure=Exposure(-0.3, 0.3, steps=4), passes=("rgb", "cryptomatte_00"))
    assert len(drawn) == 5 and [size for size in sizes[drawn[0]:] if size] == [1] * 5 + [50 * 66 * 4, 50 * 66 * 2]


def test_small_buffers_change_no_byte(fresh, adapter, scene, monkeypatch):
    """Films in strips, splats gathered from several buffers, and models in several buffers."""
    given = {"passes": ("rgb", "alpha", "cryptomatte_00"), "exposure": Exposure(-3, 3, steps=2)}
    rng = np.random.default_rng(5)
    many = [Instance(random_model(rng, 1100, "fourier", "line", "radial", look, size=0.03), np.eye(4), 0.3, name=look)
            for look in ("sh1", "sigmoid")]
    scene = many, scene[1]
    whole = fg.render(*scene, backend=f"gpu:{adapter.name}", **given)
    strips, stages, run = [], [], Device.run
    monkeypatch.setattr(expose.Taken, "picture", lambda *a, one=expose.Taken.picture: strips.append(1) or one(*a))
    monkeypatch.setattr(Device, "run", lambda self, stage, *rest, **more: stages.append(stage) or run(self, stage, *rest, **more))
    fresh.backend.device.binding = 1 << 17
    monkeypatch.setattr(expose, "rows_at_once", lambda *given, all_=expose.rows_at_once: all_(*given) and 1)
    parts = fg.render(*scene, backend=fresh.name, **given)
    assert fresh.backend.failed is None and len(strips) == 4 and {"gather", "draw_out"} <= set(stages)
    assert all(np.array_equal(whole[name], parts[name]) for name in whole)
