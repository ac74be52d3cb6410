# SPDX-License-Identifier: GPL-3.0-or-later
"""Work of minutes is announced, and measured against what was said."""
from __future__ import annotations

import time

import pytest

from fastgs_blender.util import progress
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


def test_work_without_pieces_says_what_it_is(capsys, monkeypatch):
    """Such as compiling: a line comes though nobody reports anything, and of nested work the inner one's alone."""
    monkeypatch.setattr(progress, "SOON", 0.5)
    with progress.progress(9, "step", "training"), progress.progress(1, "picture", "comparing clocks"):
        time.sleep(1.4)
    assert capsys.readouterr().err.splitlines() == ["comparing clocks: 0:01 so far"]


def test_stages_are_shares_of_the_whole_that_never_fall():
    told = []
    at = progress.staged({"reading": (0.0, 0.4), "comparing": (0.4, 1.0)}, lambda *values: told.append(values))
    for stage, share in (("reading", 0.5), ("comparing", 0.5), ("reading", 1.0), ("comparing", 2.0)):
        at(stage, share)
    assert told == [("reading", 0.2), ("comparing", 0.7), ("reading", 0.7), ("comparing", 1.0)]


def test_what_comes_before_the_first_piece_is_not_counted_in_the_time_left(capsys):
    now = [0.0]
    lines = Lines(100, "step", "refining", clock=lambda: now[0])
    for now[0], done in (10.0, 0), (30.0, 0), (131.0, 1), (151.0, 21):
        lines.to(done)
    assert capsys.readouterr().err.splitlines()[-2:] == ["refining: 1/100 steps (1 %), 2:11 so far",
                                                         "refining: 21/100 steps (21 %), 2:31 so far, 1:19 left"]
    now[0] = 191.0
    lines.to(21)
    assert capsys.readouterr().err.splitlines() == ["refining: 21/100 steps (21 %), 3:11 so far"], "this step is longer than others"
