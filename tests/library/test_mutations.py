# SPDX-License-Identifier: GPL-3.0-or-later
"""The campaigns of mutated files see every kind of failure, name it so that it can be replayed, and pass a good reader."""
from __future__ import annotations

import json
import os
import random
import signal
import time
import warnings

import damage
import mutations
import pytest

from fastgs_blender.util.errors import FastGSError
from fastgs_blender.util.reading import read_json

SEEDS = {"a": {"x.json": json.dumps({"n": 3, "names": ["b", "c"], "inner": json.dumps({"deep": [1.5, True]})}).encode()}}


def good(folder):
    read_json(folder / "x.json")


def failing(how):
    """A reader that fails as told where the number is not 3."""
    def read(folder):
        content = read_json(folder / "x.json")
        if not isinstance(content, dict) or content.get("n") != 3:
            how()
    return read


def fail_with(error):
    def how():
        raise error
    return how


def grab():
    try:
        return bytearray(3 << 30)
    except MemoryError as error:
        raise FastGSError("no memory.") from error


def test_a_good_reader_passes(tmp_path):
    told = mutations.campaign("good", good, SEEDS, tmp_path)
    assert min(told.values()) > sum(told.values()) / 15


@pytest.mark.slow
@pytest.mark.parametrize(("how", "said"), [
    (fail_with(KeyError("n")), "KeyError"), (fail_with(FastGSError("")), "printable"),
    (lambda: os.kill(os.getpid(), signal.SIGSEGV), "process.*-11"), (lambda: os._exit(3), "process.* 3"),
    (lambda: warnings.warn("hm", stacklevel=1), "UserWarning"), (grab, "more memory"),
])
def test_failures_are_seen_and_named(tmp_path, how, said):
    with pytest.raises(AssertionError, match=said) as failed:
        mutations.campaign("bad", failing(how), SEEDS, tmp_path)
    assert 'FASTGS_MUTATION="bad/a/' in str(failed.value)


@pytest.mark.parametrize(("how", "limit", "said"), [
    (lambda: time.sleep(1000), ("SILENCE", 1), "waited for 1 s"),
    (lambda: [None for _ in iter(int, 1)], ("CPU", 0.2), r"process.*-\d+")])
def test_waiting_and_endless_work_are_ended(tmp_path, monkeypatch, how, limit, said):
    monkeypatch.setattr(mutations, *limit)
    monkeypatch.setattr(mutations, "MOST", 1)
    with pytest.raises(AssertionError, match=said):
        mutations.campaign("bad", failing(how), SEEDS, tmp_path)


def test_a_child_that_waits_from_the_first_is_made_once_more(tmp_path, monkeypatch):
    """As one does that was forked while a thread of the process held a lock."""
    monkeypatch.setattr(mutations, "SILENCE", 1)
    begun, process = tmp_path / "begun", os.getpid()

    def read(folder):
        if os.getpid() != process and not begun.exists():
            begun.touch()
            time.sleep(1000)

    (tmp_path / "files").mkdir()
    told = mutations.campaign("good", read, SEEDS, tmp_path / "files")
    assert begun.exists() and told["accepted"] > 0


def test_a_failure_is_replayed_in_this_process(tmp_path, monkeypatch):
    reader = failing(fail_with(KeyError("n")))
    with pytest.raises(AssertionError) as failed:
        mutations.campaign("bad", reader, SEEDS, tmp_path)
    monkeypatch.setenv("FASTGS_MUTATION", str(failed.value).split('"')[1])
    with pytest.raises(KeyError):
        mutations.campaign("bad", reader, SEEDS, tmp_path)


def test_the_same_number_gives_the_same_mutation():
    data = SEEDS["a"]["x.json"]
    first = [damage.mutated(data, random.Random(str(i)), [data]) for i in range(200)]
    assert first == [damage.mutated(data, random.Random(str(i)), [data]) for i in range(200)]
    assert len(set(first)) > 150
