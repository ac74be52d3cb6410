# SPDX-License-Identifier: GPL-3.0-or-later
"""What is kept about an object lives as long as it."""
from __future__ import annotations

import gc
import weakref

from fastgs_blender.util.kept import kept


class Thing:
    pass


def test_a_result_is_computed_once_for_each_object_and_goes_with_it():
    asked = []

    @kept
    def about(thing):
        asked.append(id(thing))
        return Thing()

    one, other = Thing(), Thing()
    assert about(one) is about(one) and about(other) is not about(one) and asked == [id(one), id(other)]
    result = weakref.ref(about(one))
    del one
    gc.collect()
    assert result() is None
