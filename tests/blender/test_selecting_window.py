# SPDX-License-Identifier: GPL-3.0-or-later
"""Selecting things in a window: each tool by what is seen and through, a click, keys, Clean Up, and a new file without what was erased."""
from __future__ import annotations

import models
import numpy as np
from conftest import read_png

import fastgs_blender as fg
from fastgs_blender.rendering.masks import unpack_mask


def test_things_are_selected_and_deleted(user):
    whole = models.ball()
    fg.save(whole, user.folder / "ball.safetensors")
    facts = user.story("selecting_window.things", window=True, model="ball.safetensors")
    count = len(whole)
    disc = np.arange(count) >= 2 * count // 3
    bits = {name: unpack_mask(text, count) for name, text in facts["selections"].items()}
    for tool in ("box", "lasso", "brush", "ball"):
        seen, through = bits[f"{tool} seen"], bits[f"{tool} through"]
        assert 20 < seen.sum() <= (1 if tool == "ball" else 0.95) * through.sum() and not (seen & ~through).any(), tool
    np.testing.assert_array_equal(unpack_mask(facts["erased"], count), bits["ball through"])

    assert facts["click grown"] and facts["one step"], "a click and its growing are one step of undo"
    assert bits["clicked"].any() and not (bits["clicked"] & disc).any(), "the ball was clicked"
    refused = unpack_mask(facts["refused"], count)
    assert refused.any() and not (bits["strokes"] & refused).any()
    assert facts["grown by key"] and (bits["disc"] & ~disc).sum() <= 5, "the disc was drawn over, and the ball with Ctrl"
    erased = unpack_mask(facts["disc erased"], count)
    np.testing.assert_array_equal(erased, bits["disc"])
    assert facts["shown erased"]

    def share(name, mask):
        red, green, blue = np.moveaxis(read_png(user.folder / f"{name}.png")[60:-60, 60:1000, :3], -1, 0)
        return mask(red, green, blue).mean()

    orange = lambda r, g, b: (r > 2.5 * b) & (g > 0.4 * r) & (r > 0.25)  # noqa: E731
    red = lambda r, g, b: (r > 2 * g) & (b > 1.1 * g) & (r > 0.25)  # noqa: E731
    assert share("things-grown", orange) > share("things-before", orange) + 0.02
    assert share("things-shown-erased", red) > share("things-grown", red) + 0.02

    cleaned = unpack_mask(facts["cleaned"], count)
    assert not (erased & ~cleaned).any()
    assert facts["asks"] and facts["proposed"].endswith(".safetensors")
    assert facts["written"] and facts["kept"] and facts["left"] == count - cleaned.sum()
    np.testing.assert_allclose(fg.load(user.folder / "things-left.safetensors").position, whole.position[~cleaned], atol=1e-6)
