# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame ranges: both ends included, exact fractions, names that sort by time."""
from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

import fastgs_blender as fg
from fastgs_blender.util.frames import parse_frames


@pytest.mark.parametrize(("text", "labels"), [
    ("7", ["0007"]),
    ("0:3", ["0000", "0001", "0002", "0003"]),
    ("0:10:4", ["0000", "0004", "0008"]),
    ("0:1:0.25", ["0000.00", "0000.25", "0000.50", "0000.75", "0001.00"]),
    ("0.5:2.5", ["0000.5", "0001.5", "0002.5"]),
    ("-2:0", ["-0002", "-0001", "0000"]),
    ("12345", ["12345"]),
    ("2:2", ["0002"]),
])
def test_ranges_and_names(text, labels):
    frames = parse_frames(text)
    assert [frames.label(f) for f in frames] == labels


def test_tenths_do_not_drift():
    frames = parse_frames("0:100:0.1")
    assert len(frames) == 1001
    assert [float(f) for f in frames] == [i / 10 for i in range(1001)]


@pytest.mark.parametrize("text", ["", "a", "1:", ":3", "1:2:3:4", "5:1", "0:5:0", "0:5:-1", "nan", "inf", "0:inf", "1e99", "0:9999999",
                                  "0:1:0.0000001", "0:1:1e-999999999999", "1e-99999999999", "1:2:", "0x10", "1,2"])
def test_nonsense_is_one_sentence(text):
    with pytest.raises(fg.FastGSError) as error:
        parse_frames(text)
    assert str(error.value).count("\n") == 0
    assert str(error.value).endswith(".")


@given(st.text(max_size=20))
def test_any_text_is_a_range_or_a_sentence(text):
    try:
        frames = parse_frames(text)
    except fg.FastGSError:
        return
    assert len(frames) >= 1


@given(st.integers(-1000, 1000), st.integers(0, 200), st.decimals("0.01", 10, places=2))
def test_ranges_hold_what_they_say(start, length, step):
    frames = parse_frames(f"{start}:{start + length}:{step}")
    assert frames.numbers[0] == start
    assert start + length - step < frames.numbers[-1] <= start + length
    assert all(b - a == step for a, b in zip(frames.numbers, frames.numbers[1:], strict=False))
    names = [frames.label(f) for f in frames]
    assert len(set(names)) == len(names)
    assert [Decimal(name) for name in names] == list(frames)
