# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking in Blender's window: its stages are told, and the splats that take the mesh's place have a crisp edge of colour."""
from __future__ import annotations

import itertools

import numpy as np
from conftest import black_behind, psnr, read_png, region_camera

import fastgs_blender as fg

CLEAR = slice(130, -60), slice(80, -110)


def test_from_a_mesh_to_splats(user):
    facts = user.story("baking_window.from_mesh_to_splats", window=True)
    stages = [stage for stage, _ in itertools.groupby(stage for stage, _ in facts["told"])]
    assert stages == ["recording the surface", "spreading the Gaussians", "reading the colours", "fitting the motion"]
    shares = [share for _, share in facts["told"]]
    assert shares == sorted(shares) and facts["hidden"] == [True, True]
    model = fg.load(user.folder / "flag.safetensors")
    t = model.clip.t_of_frame(facts["frame"] - model.clip.start_frame)
    out = fg.render([(model, np.eye(4), t)], region_camera(facts))
    wanted = black_behind(np.concatenate([out["rgb"], out["alpha"][..., None]], -1))[CLEAR]
    x, y, width, height = facts["region"]
    shown = read_png(user.folder / "baked.png")[y:y + height, x:x + width, :3][CLEAR]
    quality = psnr(shown, wanted)
    print(f"The baked flag against the library: {quality:.1f} dB")
    assert quality >= 35
    red, white = ((np.abs(shown - colour).max(-1) < 0.08) for colour in ((0.906, 0.247, 0.247), (0.955, 0.955, 0.955)))
    assert red.mean() > 0.02 and white.mean() > 0.02
    between = (out["alpha"][CLEAR] > 0.99) & ~red & ~white
    assert between.sum() < 0.05 * (red.sum() + white.sum()), "colours do not mix but along the edge"
