# SPDX-License-Identifier: GPL-3.0-or-later
"""Viewports in Blender's window against renders: overlays, worlds, and work that a viewport avoids."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import black_behind, psnr, read_png, region_camera

import fastgs_blender as fg

CLEAR = slice(140, -60), slice(80, -110)
"""A region without Blender's text and gizmos."""


@pytest.fixture(scope="module")
def rendered(user, model):
    return user.story("seeing.rendered", window=True, model=model[1])


@pytest.fixture
def seen(user):
    """seen(name, facts): the clear part of a region in a screenshot."""
    def cut(name, facts):
        x, y, width, height = facts["region"]
        return read_png(user.folder / f"{name}.png")[y:y + height, x:x + width, :3][CLEAR]

    return cut


def test_overlays_lie_behind_splats(rendered, model, seen):
    """Grid, axes and the bone behind: opaque splats are as if there were no overlays; the bone before them is seen."""
    placement = np.eye(4)
    placement[2, 3] = 0.05
    t = model[0].clip.t_of_frame(rendered["frame"] - rendered["start"])
    out = fg.render([(model[0], placement, t)], region_camera(rendered), passes=("rgb", "alpha"))
    wanted = black_behind(np.concatenate([out["rgb"], out["alpha"][..., None]], -1))[CLEAR]
    opaque, clear = out["alpha"][CLEAR] > 0.995, out["alpha"][CLEAR] < 0.005
    overlays, without = seen("overlays", rendered), seen("without-overlays", rendered)
    assert opaque.mean() > 0.1 and psnr(without[opaque], wanted[opaque]) > 35
    changed = np.abs(overlays - without).max(-1) > 0.06
    assert changed[clear].mean() > 0.01, "the grid is there"
    rows, columns = np.nonzero(changed & opaque)
    print(f"Overlays: {changed[opaque].mean():.4f} of the opaque pixels differ, {changed[clear].mean():.4f} of the empty ones")
    assert len(rows) > 0, "the bone before the splats is seen"
    # all that is seen over splats is that bone, in one place
    left, right = np.quantile(columns, [0.02, 0.98])
    assert right - left < 0.2 * overlays.shape[1]
    elsewhere = opaque.copy()
    elsewhere[:, int(left) - 12:int(right) + 12] = False
    assert elsewhere.sum() > 0.3 * opaque.sum() and changed[elsewhere].mean() < 0.008  # the edges of the object's box


def test_a_world_behind_splats(rendered, seen):
    """Where no splat is, the world's colours change with the height, and nothing else of the picture changes."""
    assert rendered["sky"]
    before, after = seen("without-overlays", rendered), seen("world", rendered)
    assert before[5, 5].max() < 0.01 and after[5, 5].max() > 0.1


def test_f12_has_the_viewports_world(user, model):
    facts = user.story("seeing.world", window=True, model=model[1])
    assert facts["wheels"], "the Blender that made the world took the extension's wheels away"
    x, y, width, height = (round(v) for v in facts["box"])
    shown = read_png(user.folder / "world-rendered.png")[y:y + height, x:x + width, :3]
    saved = read_png(user.folder / "world-f12.png")[..., :3]
    assert saved[:3].std(axis=(0, 1)).max() < 0.2 and saved[0].max() > 0.1
    quality = psnr(shown[4:-4, 4:-4], saved[4:-4, 4:-4])
    print(f"A world in Rendered shading against F12: {quality:.1f} dB")
    assert quality >= 38


def test_what_a_viewport_spares_itself(user, model, seen):
    facts = user.story("seeing.sparing", window=True, model=model[1])
    assert facts["still"] == [0, 0]
    for moving in ("turning", "scrubbing"):
        assert all(read == 0 for _, read in facts[moving]) and any(blended for blended, _ in facts[moving]), moving
    whole, rested, *redrawn = facts["rested"]
    assert facts["fewer"] and rested == whole and redrawn == [0, 0], "fewer while the time changes, and then all of them, once"
    with_splats, again, deleted, nothing = (seen(name, facts) for name in ("turned", "scrubbed", "deleted", "nothing-left"))
    assert psnr(with_splats, again) > 45
    assert psnr(with_splats, nothing) < 25
    assert psnr(deleted, nothing) > 35, "the picture is cleared by the very next redraw"
