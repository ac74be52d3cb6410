# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything in any order: no Python error, no crash, nothing held that nobody shows, no memory that grows for ever.

Pytest's options --monkey-actions and --monkey-seed choose another run.
"""
from __future__ import annotations

MEMORIES = ("objects._entries", "objects._loading", "spaces.views", "frusta._textures")
"""What must be empty in an empty file."""


def test_monkey(user, model, small_model, pytestconfig):
    actions = pytestconfig.getoption("--monkey-actions")
    facts = user.story("monkey.run", window=True, limit=900 + 15 * actions, actions=actions, seed=pytestconfig.getoption("--monkey-seed"),
                       laps=12, models=[model[1], small_model[1]], files=["monkey-1.blend", "monkey-2.blend"])
    print(facts)
    assert all(facts["done"].values())
    held = {name: count for name, count in facts["held"].items() if name.endswith(MEMORIES)}
    assert len(held) == len(MEMORIES)
    assert not any(held.values())
    assert not any(facts["gpu"])
    assert facts["level"], f"MiB held after the same lap again and again: {facts['memory']}"
