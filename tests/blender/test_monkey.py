# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything in any order: no Python error, no crash, nothing held that nobody shows.

FASTGS_MONKEY_SECONDS and FASTGS_MONKEY_SEED choose another run.
"""
from __future__ import annotations

import os

SECONDS = float(os.environ.get("FASTGS_MONKEY_SECONDS", "40"))
SEED = int(os.environ.get("FASTGS_MONKEY_SEED", "1"))
MEMORIES = ("objects._entries", "objects._loading", "paths._before", "spaces._views")
"""What must be empty in an empty file."""


def test_monkey(user, model, small_model):
    facts = user.story("monkey.run", window=True, limit=SECONDS * 2 + 120, seconds=SECONDS, seed=SEED,
                       models=[model[1], small_model[1]], files=["monkey-1.blend", "monkey-2.blend"])
    print(facts)
    assert facts["steps"] > SECONDS / 4
    held = {name: count for name, count in facts["held"].items() if name.endswith(MEMORIES)}
    assert len(held) == len(MEMORIES)
    assert not any(held.values())
    assert not any(facts["gpu"])
    # Blender and the software OpenGL keep what they once compiled, so memory levels off after the first laps
    laps = facts["memory"]
    assert max(laps[len(laps) // 2:]) - min(laps[len(laps) // 2 - 1:]) < 150 + SECONDS
