# SPDX-License-Identifier: GPL-3.0-or-later
"""What pages draw, beside what fg.render() draws of the same scene."""
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

import fastgs_blender as fg
from fastgs_blender.formats.web.page import Page
from fastgs_blender.formats.web.poster import shown as expected_at

BACKGROUND = (0.2, 0.05, 0.4)
FIELDS = ("width", "height", "fx", "fy", "cx", "cy", "near")


def camera_text(camera: fg.Camera) -> str:
    """A camera as the page's renderer takes it, in JavaScript."""
    return json.dumps({key: getattr(camera, key) for key in FIELDS} | {
        "orthographic": bool(camera.orthographic), "pose": np.linalg.inv(camera.world_to_camera).ravel().tolist()})


def pixels(tab, camera: fg.Camera, drawing: str) -> np.ndarray:
    """The picture [h, w, 3] of 0..1 after a drawing in JavaScript, which knows `renderer`."""
    found = tab.array(f"(async () => {{ const {{ renderer }} = fastgs; {drawing}; return renderer.pixels(); }})()")
    return found.reshape(camera.height, camera.width, 4)[..., :3] / 255


def shown(tab, camera: fg.Camera, frame: float) -> np.ndarray:
    """The picture that the page draws before a camera."""
    return pixels(tab, camera, f"renderer.draw({camera_text(camera)}, {frame}); await renderer.settled()")


def expected(page: Page, camera: fg.Camera, frame: float) -> np.ndarray:
    """What fg.render() and fg.save_image() make of it, at any frame of a page on which nothing changes but the models' time."""
    still = replace(page, objects=[replace(each, times=(frame / page.frames,)) for each in page.objects])
    return expected_at(still, 0, camera)


def decibels(got: np.ndarray, want: np.ndarray) -> float:
    """Of the peak signal over the error of a picture in which there is something to be seen."""
    assert want.std() > 0.03
    return float(-10 * np.log10(max(np.mean((got - want) ** 2), 1e-12)))


def around(model, count=5, size=(160, 120), distance=4.0, extent=1.0) -> list[fg.Camera]:
    """Cameras around a model, the last one orthographic."""
    cameras = []
    for k in range(count):
        pose = fg.look_at((distance * np.sin(1.3 * k), -distance * np.cos(1.3 * k), extent * (0.5 - 0.3 * k)), (0, 0, 0))
        orthographic = k == count - 1
        focal = size[0] / (2.6 * extent) if orthographic else size[0]
        cameras.append(fg.Camera(*size, focal, focal, size[0] / 2, size[1] / 2, pose, orthographic=orthographic))
    return cameras


def saved(model, path, **options) -> tuple[fg.GaussianModel, bytes]:
    """A model as its file gives it back, and the file."""
    fg.save(model, path, **options)
    return fg.load(path), path.read_bytes()
