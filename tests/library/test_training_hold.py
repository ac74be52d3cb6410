# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures hardly show keeps its colours in training, and what they show takes theirs."""
import numpy as np
import pytest
from toy_captures import toy_capture

from fastgs_blender.captures.base import Points

torch = pytest.importorskip("torch")

from fastgs_blender.training import hold, settings  # noqa: E402
from fastgs_blender.training.model import model_from_points  # noqa: E402
from fastgs_blender.training.trainer import Trainer  # noqa: E402

FRINGE = 40


def test_the_pull_is_as_strong_as_so_many_pixels():
    features = np.array([[0.5, 0.5], [0.5, 0.5], [0.5, 0.5]], np.float32)
    arrays = {"features": features + np.float32(hold.OFF), hold.HELD: hold.held_features(features, np.array([1.0, np.nan, 1.0]))}
    gradients = {"features": np.ones((3, 2), np.float32)}
    hold.pull(arrays, gradients, np.array([0, 1]), votes=30, pixels=1000)
    np.testing.assert_allclose(gradients["features"], [[1 + 30 / 3000] * 2, [1, 1], [1, 1]], rtol=1e-6)


def trained(votes):
    """(how far the colours of large Gaussians went that stand beside the pictures, PSNR of the held-out view)."""
    capture, store, points = toy_capture()
    around = np.linspace(0, 2 * np.pi, FRINGE, endpoint=False)
    beside = np.stack([7.5 * np.cos(around), 7.5 * np.sin(around), np.full(FRINGE, 5.0)], 1)
    sizes = np.concatenate([np.full(len(points), np.nan), np.full(FRINGE, 1.0)])
    chosen = settings.settings(iterations=200, densify_from=1.0, warm_up=(), preview_every=0, backdrop_hold=votes)
    points = Points(np.concatenate([points.xyz, beside]).astype(np.float32), np.concatenate([points.rgb, np.full((FRINGE, 3), 0.5)]),
                    None, sizes)
    first = model_from_points(points, chosen, capture.clip, capture.axes, capture.extent)
    trainer = Trainer(capture, store, chosen, first, sizes=sizes)
    for _ in range(200):
        trainer.step()
    return np.abs(trainer.model().features[-FRINGE:, :3] - 0.5).max(), trainer.measure(capture.held_out)[0]


def test_colours_that_hardly_anything_speaks_for_stay():
    free, worse = trained(0)
    kept, better = trained(5)
    assert free > 0.5
    assert kept < 0.15
    assert better > worse - 0.1
