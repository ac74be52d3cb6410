# SPDX-License-Identifier: GPL-3.0-or-later
"""Tools and panels as users have them in a window."""
from __future__ import annotations

import numpy as np
from conftest import read_png, region_camera
from panel_widths import REGIONS

import fastgs_blender as fg
from fastgs_blender.rendering.masks import unpack_mask


def test_the_eraser_and_the_lasso(user, model):
    """What lies under them by the library's projection is hidden, in one step of undo each; Shift brings it back."""
    facts = user.story("tools_window.strokes", window=True, model=model[1])
    assert facts["nothing"] == "" and abs(facts["radius"] - 30 * 1.15) < 0.01
    bits = {name: unpack_mask(facts[name], len(model[0])) for name in ("erased", "restored", "undone", "lassoed")}
    camera, s = region_camera(facts), fg.slice_model(model[0], model[0].clip.t_of_frame(facts["frame"]))
    pixel = camera.pixels(np.c_[s.position, np.ones(len(s.position))] @ camera.world_to_camera.T[:, :3]) * (1, -1) + (0, camera.height)
    path = np.concatenate([np.linspace(a, b, 50) for a, b in zip(facts["path"], facts["path"][1:])])
    away = np.concatenate([np.linalg.norm(part[:, None] - path, axis=-1).min(1) for part in np.array_split(pixel, 40)])
    erased = np.zeros(len(model[0]), bool)
    erased[s.index[away < facts["radius"]]] = True
    assert erased.sum() > 500 and (bits["erased"] != erased).sum() <= 0.01 * erased.sum()  # a pixel's fraction at the rim
    assert 100 < bits["restored"].sum() < 0.8 * erased.sum() and not (bits["restored"] & ~bits["erased"]).any()
    np.testing.assert_array_equal(bits["undone"], bits["erased"])
    corners = np.array(facts["lasso"], float)
    to = np.append(corners, corners[:1], 0) - pixel[:, None]
    turned = np.arctan2(np.cross(to[:, :-1], to[:, 1:]), (to[:, :-1] * to[:, 1:]).sum(-1)).sum(1)
    inside = np.zeros(len(model[0]), bool)
    inside[s.index[np.abs(turned) > np.pi]] = True
    assert inside.sum() > 500 and (bits["lassoed"] != inside).sum() <= 0.01 * inside.sum()


def test_the_tools_that_select(user, model):
    """What lies in the box by the library's projection; what is seen is a part of it; colours in every shading, none without overlays."""
    facts = user.story("tools_window.selecting", window=True, model=model[1])
    bits = {name: unpack_mask(text, len(model[0])) for name, text in facts["selections"].items()}
    camera, s = region_camera(facts), fg.slice_model(model[0], model[0].clip.t_of_frame(facts["frame"]))
    pixel = camera.pixels(np.c_[s.position, np.ones(len(s.position))] @ camera.world_to_camera.T[:, :3]) * (1, -1) + (0, camera.height)
    low, high = np.sort(np.array(facts["box"]), 0)
    inside = np.zeros(len(model[0]), bool)
    inside[s.index[((pixel >= low) & (pixel <= high)).all(1)]] = True
    assert inside.sum() > 500 and (bits["box"] != inside).sum() <= 0.01 * inside.sum()
    assert 0.05 < bits["seen"].sum() / inside.sum() < 0.95 and not (bits["seen"] & ~bits["box"]).any()
    refused = unpack_mask(facts["refused"], len(model[0]))
    assert (bits["added"] & ~bits["box"]).sum() > 50 and not (bits["box"] & ~bits["added"]).any()
    assert (refused & bits["added"]).sum() > 50 and np.array_equal(bits["taken"], bits["added"] & ~refused)
    np.testing.assert_array_equal(bits["undone"], bits["added"])
    assert 10 < bits["ball"].sum() < inside.sum()
    name, part, parent = facts["part"]
    assert name == "Part" and parent and np.array_equal(unpack_mask(part, len(model[0])), bits["ball"])

    def coloured(name):
        """How many pixels of a screenshot of the view are orange, and blue."""
        red, green, blue = np.moveaxis(read_png(user.folder / f"{name}.png")[60:-60, 60:1100, :3], -1, 0)
        return int(((red > 2.5 * blue) & (red > 1.2 * green) & (red > 0.25)).sum()), int(((blue > 2 * red) & (blue > 0.3)).sum())

    before, plain = coloured("select-before"), coloured("select-without-overlays")
    for shading in ("wireframe", "material", "workbench", "rendered"):
        orange, blue = coloured(f"select-{shading}")
        assert orange > before[0] + 2000 and blue > before[1] + 300, (shading, orange, blue, before)
    assert coloured("select-solid")[0] > before[0] + 2000 and plain[0] < before[0] + 500


def test_a_camera_made_here_sees_the_view(user, model):
    """The corners of the view, by the matrices that Blender draws it with, lie in the picture and reach two of its sides."""
    facts = user.story("tools_window.camera_here", window=True, model=model[1])
    window, view = np.array(facts["window"]), np.array(facts["view"])
    corners = np.array([(x, y, 0.5, 1.0) for x in (-1, 1) for y in (-1, 1)]) @ np.linalg.inv(window @ view).T
    seen = corners @ (np.array(facts["picture"]) @ np.linalg.inv(facts["camera"])).T
    reach = np.abs(seen[:, :2] / seen[:, 3:]).max(0)
    assert abs(reach.max() - 1) < 1e-3 and reach.min() <= 1 + 1e-3 and facts["through"] == 'CAMERA'


def test_all_panels_open_fit_into_the_widths_that_their_texts_are_measured_for(user):
    """tests/addon/ui asks whether all texts fit into panels of these widths.  The screenshots show all panels, open."""
    facts = user.story("tools_window.panels", window=True, screen="1920x2900")
    for kind, width in facts["widths"].items():
        assert REGIONS[kind] <= width <= REGIONS[kind] + 8, (kind, width)
    elsewhere = {"FASTGS_PT_instances", "FASTGS_PT_viewport_pass", "FASTGS_PT_ray_visibility", "FASTGS_PT_mesh_passes",
                 "FASTGS_PT_light_probe"}  # or closed
    assert set(facts["panels"]) - set(facts["drawn"]) == elsewhere
