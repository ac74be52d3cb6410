# SPDX-License-Identifier: GPL-3.0-or-later
"""Work of minutes is announced, and measured against what was said."""
from __future__ import annotations

import pytest

from fastgs_blender.util.progress import Lines, estimated


def test_long_work_is_announced_and_measured():
    said, times = [], iter([10.0, 160.0])
    with estimated("training", 90.0, said.append, lambda: next(times)):
        assert len(said) == 1 and "about 1:30" in said[0]
    assert said[1] == "training took 2:30, and 1:30 were estimated."


def test_short_and_interrupted_work_says_nothing_afterwards():
    said = []
    with estimated("training", 20.0, said.append):
        pass
    with pytest.raises(KeyboardInterrupt), estimated("training", 90.0, said.append):
        raise KeyboardInterrupt
    assert len(said) == 1


def test_what_comes_before_the_first_piece_is_not_counted_in_the_time_left(capsys):
    now = [0.0]
    lines = Lines(100, "step", "refining", clock=lambda: now[0])
    for now[0], done in (10.0, 0), (30.0, 0), (131.0, 1), (151.0, 21):
        lines.to(done)
    assert capsys.readouterr().err.splitlines()[-2:] == ["refining: 1/100 steps (1 %), 2:11 so far",
                                                         "refining: 21/100 steps (21 %), 2:31 so far, 1:19 left"]
