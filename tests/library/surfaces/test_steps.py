# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked motion from one frame to the next, which the Vector pass shows."""
import numpy as np
import pytest
from moving_meshes import grid

import fastgs_blender as fg

FRAMES = 24


def eased(x):
    """The angle at a share of the clip, as between two keyframes of Blender."""
    return 1.5 * x**2 * (3 - 2 * x)


def steady(x):
    """The same at a constant rate, less than a whole turn: no series of time follows that closely."""
    return 1.5 * x


@pytest.mark.parametrize("angle_at", [eased, steady])
def test_steps_from_frame_to_frame_are_followed(angle_at):
    """The mean step is right to 0.009 % of the size, for which there are more terms than the places need, or keyframes."""
    points, triangles = grid(4)
    points = points - points.mean(0)

    def turning(frame):
        angle = angle_at(frame / (FRAMES - 1))
        return points @ [[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]] + [2 * angle, 0, 0]

    times = np.arange(0, FRAMES - 0.5, 0.5)
    model, report = fg.bake(np.stack([turning(time) for time in times]), triangles, frames=times, frame_count=FRAMES, count=500)
    places = [fg.slice_model(model, f / FRAMES).position for f in range(FRAMES)]
    truth = [turning(f) for f in range(FRAMES)]
    rows = np.array([np.linalg.lstsq(np.c_[truth[0][:, :2], np.ones(len(points))].T, np.array([*place, 1]), rcond=None)[0]
                     for place in places[0][:, :2]])  # each Gaussian as a mean of vertices: the motion is rigid
    off = np.array([np.linalg.norm((there - here) - rows @ (after - before), axis=1).mean()
                    for here, there, before, after in zip(places, places[1:], truth, truth[1:])])
    assert off.mean() < 9e-5 * report.size
    assert report.order <= 20
