# SPDX-License-Identifier: GPL-3.0-or-later
"""A rewritten file is noticed, whatever its times and its size say."""
import os
import time

import pytest

from fastgs_blender.util import identity
from fastgs_blender.util.errors import FastGSError
from fastgs_blender.util.identity import SETTLED, FileIdentity


@pytest.fixture
def one_tick(monkeypatch):
    """The clocks and the inode numbers stand still; returns the time that all files have."""
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now)
    monkeypatch.setattr(identity, "status_of", lambda path: (int(now * 1e9), int(now * 1e9), os.stat(path).st_size, 1, 1))
    return now


@pytest.mark.parametrize("at", [0, 70_000, 99_999])
def test_a_rewrite_within_one_tick_is_noticed(tmp_path, one_tick, at):
    path, data = tmp_path / "model", bytearray(range(256)) * 400
    path.write_bytes(data[:100_000])
    found = FileIdentity.of(str(path))
    assert found.same() and found.same()
    data[at // 4096 * 4096:] = bytes(reversed(data[at // 4096 * 4096:]))
    path.write_bytes(data[:100_000])
    assert not found.same()


def test_contents_are_looked_at_only_while_the_file_is_young(tmp_path, one_tick, monkeypatch):
    path = tmp_path / "model"
    path.write_bytes(b"one")
    found = FileIdentity.of(str(path))
    monkeypatch.setattr(time, "time", lambda: one_tick + SETTLED + 1)
    assert found.same(), "this look settles it"
    monkeypatch.setattr(identity, "_fingerprint", lambda path: pytest.fail("the contents were read"))
    assert found.same()


def test_a_later_or_longer_or_other_file_is_another(tmp_path):
    path = tmp_path / "model"
    path.write_bytes(b"one")
    found = FileIdentity.of(str(path))
    os.utime(path, ns=(1, 1))
    assert not found.same()
    found = FileIdentity.of(str(path))
    path.write_bytes(b"longer")
    assert not found.same()
    found = FileIdentity.of(str(path))
    (tmp_path / "other").write_bytes(b"longer")
    os.replace(tmp_path / "other", path)
    assert not found.same()


def test_a_file_that_is_gone_or_is_none_is_an_error(tmp_path):
    path = tmp_path / "model"
    path.write_bytes(b"one")
    found = FileIdentity.of(str(path))
    path.unlink()
    with pytest.raises(FastGSError, match="no such file"):
        found.same()
    os.mkfifo(path)
    with pytest.raises(FastGSError, match="pipe"):
        FileIdentity.of(str(path))
    with pytest.raises(FastGSError, match="no such file"):
        FileIdentity.of("a\0b")
