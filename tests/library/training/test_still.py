# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands still has starting points on its surfaces, also on a faintly painted wall that cameras show in different shades."""
from __future__ import annotations

from dataclasses import replace

import filmed_room
import numpy as np
import pytest

import fastgs_blender as fg
from fastgs_blender.captures.capture import Capture
from fastgs_blender.captures.pixels.store import FrameStore
from fastgs_blender.training.core.settings import settings
from fastgs_blender.training.initial import still, sweep
from fastgs_blender.training.initial.dense import chosen_moments, picture, stand_still

NEAR, FAR, VIEWS = 1.2, 8.0, 6


def faint(view: int):
    """A camera's picture with an eighth of the contrast, and a shade that grows from one side to the other."""
    def changed(image: np.ndarray, frame: int) -> np.ndarray:
        return 0.55 + 0.12 * (image - 0.5) + (view - 2.5) * 0.03 * np.linspace(-1, 1, image.shape[1])[:, None]
    return changed


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> tuple[Capture, FrameStore]:
    folder = tmp_path_factory.mktemp("still") / "room"
    capture = fg.open_capture(filmed_room.write_room(folder, VIEWS, 4, spread=0.6, detail=1, change={k: faint(k) for k in range(VIEWS)}))
    return capture, FrameStore(capture)


def off(xyz: np.ndarray) -> np.ndarray:
    """Distances [P] of points from the nearest surface of the room that stands still."""
    distances = [np.abs(xyz[:, 2] - filmed_room.FAR), np.abs(xyz[:, 1] - 1)]
    low, high = np.array(filmed_room.BOXES[0])
    return np.minimum.reduce([*distances, np.linalg.norm(np.maximum(np.maximum(low - xyz, xyz - high), 0), axis=1)])


def test_a_faint_wall_in_different_shades_has_points(room):
    capture, store = room
    moments = chosen_moments(capture)
    assert stand_still(moments)
    pictures = [[picture(capture, store, settings(), shot, 160) for shot in shots] for shots in moments]
    found, large = still.standing(list(zip(*pictures)), NEAR, FAR, 0)
    pixels = sum(image.shape[0] * image.shape[1] for image, _, _ in pictures[0])
    assert np.isnan(found.t).all() and len(found) > 0.5 * pixels
    assert np.median(off(found.xyz)) < 0.02 and (off(found.xyz) < 0.1).mean() > 0.9
    assert any(abs(plane[2]) > 0.99 and abs(abs(plane[3]) - filmed_room.FAR) < 0.1 for plane in large), "the wall is among the planes"
    by_colour = np.concatenate([xyz for xyz, _ in sweep.surfaces(pictures[0], sweep.swept(pictures[0], NEAR, FAR))])
    assert len(by_colour) < 0.01 * pixels, "shades hide the wall where colours are compared"


def test_cameras_that_move_are_left_out(room):
    moments = chosen_moments(room[0])
    turned = [[replace(shot, camera=replace(shot.camera, world_to_camera=filmed_room.pose(0.01 * shot.frame))) for shot in shots]
              for shots in moments]
    assert not stand_still(turned) and not stand_still(moments[:3]) and not stand_still([*moments[:3], moments[3][1:]])


def test_contrasts_do_not_depend_on_shade_and_exposure():
    image = np.random.default_rng(1).random((40, 50, 3))
    shade = np.linspace(0, 0.2, 50)[:, None]
    inner = np.s_[12:-12, 12:-12]
    np.testing.assert_allclose(still.contrasts(0.5 * image + shade)[inner], still.contrasts(image)[inner], atol=0.02)
    assert np.array_equal(still.contrasts(np.full((8, 9, 3), 0.3)), np.full((8, 9, 3), 0.5, np.float32))
