# SPDX-License-Identifier: GPL-3.0-or-later
"""Stitching with the mouse."""
from __future__ import annotations

import numpy as np
from stitched_scenes import part, place

import fastgs_blender as fg


def test_pairs_are_clicked(user):
    """Clicks on the surfaces of both objects, whose places are known, leave the one on the other, in one step of undo."""
    fg.save(part(fg, 0, -3, 3, axes="RFU"), user.folder / "place.safetensors")
    points = place(0)[0]
    floor = points[(points[:, 2] == 0) & (np.abs(points[:, 0]) < 2.9)]
    corners = [floor[np.argmin(np.linalg.norm(floor[:, :2] - at, axis=1))].tolist() for at in ((-1.9, -1.9), (1.9, -1.9), (-2.7, 1.6))]
    facts = user.story("stitching_window.pairs", window=True, model="place.safetensors", corners=corners)
    np.testing.assert_allclose(facts["moved"], np.eye(4), atol=0.1)
    assert facts["undone"]
