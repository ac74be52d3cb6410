# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures hardly show keeps its colours in training, and what they show takes theirs."""
import numpy as np
from toy_captures import Pixels, toy_capture

import fastgs_blender as fg
from fastgs_blender.captures.capture import Points
from fastgs_blender.training.core import hold, settings
from fastgs_blender.training.core.trainer import Trainer
from fastgs_blender.training.initial.model import model_from_points
from fastgs_blender.util.backends import load_backend

FRINGE = 40


def test_the_pull_is_as_strong_as_so_many_pixels():
    features = np.array([[0.5, 0.5], [0.5, 0.5], [0.5, 0.5]], np.float32)
    arrays = {"features": features + np.float32(hold.OFF), hold.HELD: hold.held_features(features, np.array([1.0, np.nan, 1.0]))}
    gradients = {"features": np.ones((3, 2), np.float32)}
    hold.hold(load_backend("cpu"), arrays, gradients, np.array([0, 1]), votes=30, pixels=1000)
    np.testing.assert_allclose(gradients["features"], [[1 + 30 / 3000] * 2, [1, 1], [1, 1]], rtol=1e-6)


def trained(capture, store, points, **choices):
    """The trainer after 200 steps without density control."""
    chosen = settings.settings(iterations=200, densify_from=1.0, warm_up=(), preview_every=0, **choices)
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    trainer = Trainer(capture, store, chosen, first, sizes=points.size)
    for _ in range(200):
        trainer.step()
    return trainer


def beside(votes):
    """How far the colours of large Gaussians went that stand beside the pictures, which show a fringe of them."""
    capture, store, points = toy_capture()
    around = np.linspace(0, 2 * np.pi, FRINGE, endpoint=False)
    xyz = np.stack([7.5 * np.cos(around), 7.5 * np.sin(around), np.full(FRINGE, 5.0)], 1)
    sizes = np.concatenate([np.full(len(points), np.nan), np.full(FRINGE, 1.0)])
    rgb = np.concatenate([points.rgb, np.full((FRINGE, 3), 0.5)])
    points = Points(np.concatenate([points.xyz, xyz]).astype(np.float32), rgb, None, sizes)
    after = trained(capture, store, points, backdrop_hold=votes).model()
    return np.abs(after.features[-FRINGE:, :3] - 0.5).max()


def test_colours_that_hardly_anything_speaks_for_stay():
    assert beside(0) > 0.5
    assert beside(5) < 0.15


def test_what_pictures_show_takes_their_colours():
    """A wall that fills all pictures, and was taken for another colour."""
    capture, store, _ = toy_capture()
    for key, pixels in store.pictures.items():
        store.pictures[key] = Pixels(np.full_like(pixels.rgb, 0.6))
    grid = np.stack(np.meshgrid(np.linspace(-6, 6, 9), np.linspace(-5, 5, 7)), -1).reshape(-1, 2)
    xyz = np.concatenate([grid, np.full((len(grid), 1), 3.0)], 1).astype(np.float32)
    points = Points(xyz, np.full((len(xyz), 3), 0.3), None, np.full(len(xyz), 1.2))
    trainer = trained(capture, store, points, backdrop_hold=5.0, appearance="rgb")  # a decoder could take their part
    shot = capture.held_out[0]
    picture = fg.render(trainer.model(), shot.camera, shot.t)["rgb"]
    assert np.abs(picture - 0.6).mean() < 0.03
