# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples the path of an animated camera, and measures how smooth it is."""
import numpy as np


def track(scene, obj, steps=8):
    """Positions, view directions and focal lengths of a camera, `steps` times a frame."""
    rows = []
    for at in np.arange(scene.frame_start, scene.frame_end + 1e-9, 1 / steps):
        scene.frame_set(int(at), subframe=float(at % 1))
        matrix = np.array(obj.matrix_world)
        rows.append([*matrix[:3, 3], *(-matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])), obj.data.lens])
    return np.array(rows)


def assert_smooth(rows, bound=0.1):
    """Neither position, direction nor their speeds jump: no step's change is more than a share of the largest step."""
    for part in (rows[:, :3], rows[:, 3:6]):
        step = np.diff(part, axis=0)
        assert np.linalg.norm(np.diff(step, axis=0), axis=1).max() <= bound * np.linalg.norm(step, axis=1).max() + 1e-6


def keyed(module, obj):
    """The F-curves of an animated datablock."""
    return module("scene.cameras.keys").curves(obj)
