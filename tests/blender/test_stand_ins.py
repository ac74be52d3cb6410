# SPDX-License-Identifier: GPL-3.0-or-later
"""The points that stand for a model in other engines are never seen beside splats, on no redraw."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import psnr, read_png


@pytest.fixture(scope="module")
def watched(user, model):
    return user.story("stand_ins.watched", window=True, model=model[1])


def test_points_are_seen_where_splats_are_switched_off_and_nowhere_else(watched):
    parts = watched["parts"]
    assert all(len(redraws) > 0 for redraws in parts.values()), parts
    assert {name for name, redraws in parts.items() if any(redraws)} == {"without splats"}, parts
    assert parts["without splats"][-1]


def test_wireframe_shows_the_box_alone(watched, user):
    """And the splats come back as they were.  Without them another engine's viewport shows the model's colours."""
    x, y, width, height = watched["region"]
    middle = slice(y + height // 3, y + 2 * height // 3), slice(x + width // 3, x + 2 * width // 3)
    solid, wire, off, cycles, back = (read_png(user.folder / f"stand-ins-{name}.png")[..., :3][middle] for name in (
        "solid-again", "wireframe", "without", "cycles", "with"))
    busy = [float(np.abs(np.diff(picture, axis=1)).max(-1).mean()) for picture in (solid, wire, off)]
    assert busy[1] < 0.3 * busy[2] and psnr(back, solid) > 40 and psnr(off, solid) < 30
    there = np.logical_and(*(np.ptp(picture, axis=-1) > 0.25 for picture in (solid, cycles)))
    assert there.mean() > 0.05 and np.abs((cycles - solid)[there]).mean() < 0.12, "the points have the colours of the splats"
