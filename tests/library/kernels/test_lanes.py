# SPDX-License-Identifier: GPL-3.0-or-later
"""Eight Gaussians at once are computed as one is: what functions of lanes give, beside NumPy."""
from __future__ import annotations

import math

import numpy as np
import pytest

from fastgs_blender.kernels.cpu.jit import kernel
from fastgs_blender.kernels.cpu.lanes import LANES, anywhere, bits, exp, following, four, log2, picked, put, room, take, three, where


@kernel
def functions(x, out):
    numbers = x.reshape(1, -1)
    for first in range(0, len(x), LANES):
        one = take(numbers, 0, first)
        put(out, 0, first, exp(one))
        put(out, 1, first, log2(one))
        put(out, 2, first, where(one > 1, min(one, 3.0), max(-one, 2)))
        put(out, 3, first, math.sqrt(abs(one) - 0.5 * one / 2))


def test_functions_are_those_of_numbers():
    x = np.concatenate([np.linspace(-87, 87, 4000), 10.0 ** np.linspace(-37, 37, 4000)])
    out = np.empty((4, len(x)))
    with np.errstate(over="ignore", invalid="ignore"):
        functions(x, out)
        np.testing.assert_allclose(out[0], np.exp(x.clip(None, 1000 * np.log(2))), rtol=1e-8)
        np.testing.assert_allclose(out[1, 4000:], np.log2(x[4000:]), rtol=0, atol=2e-9)
    np.testing.assert_array_equal(out[2], np.where(x > 1, np.minimum(x, 3), np.maximum(-x, 2)))
    np.testing.assert_allclose(out[3], np.sqrt(np.abs(x) - 0.25 * x), rtol=1e-15)


def test_what_is_no_number_stays_so():
    x = np.array([np.nan, np.inf, -np.inf, 0, -np.nan, 1e300, -1e300, 1])
    out = np.empty((4, LANES))
    functions(x, out)
    assert np.isnan(out[0, [0, 4]]).all() and (out[0, [1, 5]] > 1e300).all() and (out[0, [2, 6]] < 1e-300).all()
    np.testing.assert_allclose(out[0, [3, 7]], [1, np.e], rtol=1e-8)


@kernel
def gathered(array, hidden, number, first, last, out):
    n = picked(number, first, last)
    put(out, 0, 0, array[n, 1, 2])
    put(out, 1, 0, array[following(first, last), 0, 0])
    mask = hidden[n]
    return bits(mask), anywhere(mask)


@pytest.mark.parametrize("last", [10, 13, 40])
def test_what_the_gaussians_have(last):
    """The last one again, where they are fewer."""
    numbers = np.random.default_rng(0)
    array, hidden, number = numbers.normal(size=(40, 2, 3)).astype(np.float32), numbers.random(40) < 0.3, numbers.permutation(40)
    out, places = np.empty((2, LANES)), np.minimum(np.arange(9, 9 + LANES), last - 1)
    for part in (array, np.asfortranarray(array)):
        found, any_of = gathered(part, hidden, number, 9, last, out)
        np.testing.assert_array_equal(out, [array[number[places], 1, 2], array[places, 0, 0]])
        assert found == sum(1 << i for i, one in enumerate(hidden[number[places]]) if one) and any_of == bool(found)


@kernel
def read_together(rows, deep, number, first, out):
    n = picked(number, first, len(number))
    for lane, one in enumerate(three(deep, n, 1) + four(rows, n)):
        put(out, lane, 0, one)
    return three(deep, 2, 1), four(rows, 3)


def test_what_lies_side_by_side_is_read_together():
    """The last row's end is the array's; of other arrays each number is read by itself."""
    numbers = np.random.default_rng(0)
    rows, deep = numbers.normal(size=(20, 4)).astype(np.float32), numbers.normal(size=(20, 2, 3)).astype(np.float32)
    number, out = np.arange(20)[::-1].copy(), np.empty((7, LANES))
    for first in (0, 17):
        places = number[np.minimum(np.arange(first, first + LANES), 19)]
        for change in (np.ascontiguousarray, np.asfortranarray, np.float64):
            assert read_together(change(rows), change(deep), number, first, out) == (tuple(deep[2, 1]), tuple(rows[3]))
            np.testing.assert_array_equal(out, np.concatenate([deep[places, 1], rows[places]], 1).T)


@kernel
def place_of_room(rows):
    made = room(rows)
    made[:] = 1.0
    return made.ctypes.data % 64, made.shape, made.sum()


def test_room_begins_at_a_line_of_the_cache():
    assert [place_of_room(rows) for rows in (1, 2, 7)] == [(0, (rows, LANES), rows * LANES) for rows in (1, 2, 7)]
