# SPDX-License-Identifier: GPL-3.0-or-later
"""*Render With Meshes* as users have it in a window."""
from __future__ import annotations

import OpenEXR
import pytest
from conftest import read_png


@pytest.mark.parametrize("engine", ["CYCLES", "EEVEE"])
def test_a_mesh_that_is_added_later_is_in_the_picture(user, small_model, engine):
    """Its colour, and the splats' beside it; Off leaves the scene alone."""
    facts = user.story("meshes_window.joined", window=True, model=small_model[1], engine=engine)
    assert facts["followed"] and facts["shutter"] == 0.75 and facts["engine"].startswith(("CYCLES", "BLENDER_EEVEE"))
    picture = read_png(user.folder / facts["picture"])
    green = (picture[..., 1] > 0.95) & (picture[..., 0] < 0.05)
    assert 1000 < green.sum() < 30_000, "the wall"
    assert ((picture[..., 3] > 0.5) & ~green).sum() > 3000, "the splats"
    assert facts["scenes"] == 1 and facts["shaded"] == ["Sun"]
    with OpenEXR.File(str(next(user.folder.glob(f"with-meshes-{engine.lower()}-passes_*.exr"))), separate_channels=True) as file:
        found = {name if name.count(".") > 1 else f"{part.header['name']}.{name}" for part in file.parts for name in part.channels}
    assert {"Composite.Combined.R", "ViewLayer.Depth.V", "ViewLayer.Splat Shadow.V"} <= found
    assert {"ViewLayer Meshes.Normal.X", "ViewLayer Mesh.Normal.X"} & found
