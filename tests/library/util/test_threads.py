# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that is spread over threads."""
from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastgs_blender.util import threads


@pytest.fixture(params=[1, 3])
def count(request):
    threads.set_threads(request.param)
    yield request.param
    threads.set_threads(0)


def test_results_come_in_the_order_of_the_pieces(count):
    heard = []
    assert threads.run(lambda a, b: a * b, [(k, 2) for k in range(50)], heard.append) == [2 * k for k in range(50)]
    assert heard == sorted(heard) and heard[-1] == 1.0 and threads.run(len, []) == []


def test_a_piece_may_spread_work_itself(count):
    inner = [threads.run(lambda k: [threads.run(lambda n: n, [(n,) for n in range(5)]) for _ in range(5)], [(k,) for k in range(9)])]
    assert inner == [[[list(range(5))] * 5] * 9]


@pytest.mark.parametrize("pieces", [2, 9])
def test_pieces_of_a_piece_stay_in_its_thread_where_all_threads_have_pieces(pieces):
    threads.set_threads(3)
    meet = threading.Barrier(2)

    def work(k):
        return {thread for thread, in threads.run(lambda n: (threading.get_ident(),), [(n,) for n in range(5)])}, threading.get_ident()

    def apart(n):
        meet.wait(10)  # two threads have to come
        return threading.get_ident()

    try:
        for inner, own in threads.run(work, [(k,) for k in range(pieces)]):
            assert pieces < 3 or inner == {own}
        assert len(set(threads.run(apart, [(0,), (1,)]))) == 2  # and they are free again
        assert threads.run(lambda k: threads.run(apart, [(0,), (1,)])[0] > 0, [(0,)]) == [True]
    finally:
        threads.set_threads(0)


def test_results_of_several_come_in_order_and_not_all_at_once(count):
    begun = []

    def work(k):
        begun.append(k)
        return k * k

    found = threads.several(work, [(k,) for k in range(100)])
    assert [next(found), next(found)] == [0, 1] and len(begun) == threads.AHEAD * count
    assert list(found) == [k * k for k in range(2, 100)] and sorted(begun) == list(range(100))
    assert list(threads.several(work, [])) == []


def test_what_a_piece_raises_stops_the_rest(count):
    done = []

    def work(k):
        if k == 3:
            raise KeyError(k)
        done.append(k)

    with pytest.raises(KeyError):
        threads.run(work, [(k,) for k in range(10_000)])
    assert len(done) < 9_999


@pytest.mark.parametrize("length", [0, 1, threads.PIECE, 3 * threads.PIECE + 5])
def test_a_product_in_pieces_is_the_product(length):
    rng = np.random.default_rng(0)
    matrix, columns = rng.normal(size=(4, 3)), rng.normal(size=(3, length))
    for left in (matrix, matrix[0]):
        for right in (columns, np.ascontiguousarray(columns.T).T, columns.astype(np.float32)):
            found = threads.product(left, right)
            assert found.dtype == np.float64 and np.abs(found - left @ right).max(initial=0) < 1e-12


def test_two_calls_side_by_side_give_both_results_and_either_failure(count):
    def work():
        return threads.run(lambda k: k * k, [(k,) for k in range(9)])

    assert threads.beside(work, lambda: "other") == ([k * k for k in range(9)], "other")
    for pair in ((lambda: 1 // 0, work), (work, lambda: 1 // 0)):
        with pytest.raises(ZeroDivisionError):
            threads.beside(*pair)


def test_rows_are_taken_as_numpy_takes_them(count):
    rng = np.random.default_rng(2)
    index = rng.permutation(20_000)
    arrays = [rng.normal(size=(20_000, 3)), rng.normal(size=(20_000, 0, 4)), rng.normal(size=20_000)]
    for chosen in (index, index[:0]):
        for got, array in zip(threads.taken(arrays, chosen), arrays, strict=True):
            assert np.array_equal(got, array[chosen]) and got.shape == array[chosen].shape
        columns = [arrays[2], arrays[0].T, np.ascontiguousarray(arrays[0].T)]
        assert all(np.array_equal(got, array[..., chosen]) for got, array in zip(threads.taken(columns, chosen, -1), columns, strict=True))
    assert np.array_equal(threads.taken(arrays[2:], np.array([-1, 3]))[0], arrays[2][[-1, 3]])
    with pytest.raises(IndexError):
        threads.taken(arrays, np.array([0, 20_000]))


@given(total=st.integers(0, 5000), most=st.integers(1, 400), least=st.integers(1, 400), processors=st.integers(1, 40))
def test_portions_cover_all_in_order_and_are_as_large_as_told(total, most, least, processors):
    threads.set_threads(processors)
    try:
        found = threads.portions(total, most, least)
    finally:
        threads.set_threads(0)
    assert [k for first, last in found for k in range(first, last)] == list(range(total))
    sizes = [last - first for first, last in found]
    assert all(size <= most for size in sizes) and all(size >= min(most, least) for size in sizes[:-1])
    assert len(found) <= 4 * processors or max(sizes) == most
    assert len(found) >= min(processors, total // max(least, 1))  # no thread is idle while pieces may be smaller
