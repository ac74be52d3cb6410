# SPDX-License-Identifier: GPL-3.0-or-later
"""Files from outside: only ordinary ones are opened, and whatever fails is one printable sentence."""
from __future__ import annotations

import os
import sys

import pytest

from fastgs_blender.util.errors import FastGSError, printable, printable_lines
from fastgs_blender.util.reading import open_file, read_bytes, read_json, reading


@pytest.mark.parametrize("error", [KeyError("a"), ZeroDivisionError(), RecursionError(), TypeError("x"), OverflowError("y"), EOFError()])
def test_whatever_fails_is_one_sentence(error):
    with pytest.raises(FastGSError, match=r"^a\.ply: .+\(.+\); export it again\.$"), reading("a.ply", "export it again"):
        raise error


def test_developers_see_where_a_reader_failed(caplog):
    """A mistake in a reader cannot be told from a damaged file: users get the sentence, the log has the rest."""
    with caplog.at_level("DEBUG"), pytest.raises(FastGSError) as told, reading("a.ply"):
        {}.shape  # noqa: B018
    assert isinstance(told.value.__cause__, AttributeError)
    assert caplog.records[-1].exc_info[1] is told.value.__cause__ and "test_reading.py" in caplog.text


def test_what_says_more_and_interruptions_pass_through():
    with pytest.raises(FastGSError, match=r"^better$"), reading("a.ply"):
        raise FastGSError("better")
    with pytest.raises(KeyboardInterrupt), reading("a.ply"):
        raise KeyboardInterrupt


def test_only_ordinary_files_are_opened(tmp_path):
    for make, said in ((lambda p: os.mkfifo(p) if hasattr(os, "mkfifo") else p.mkdir(), "pipe|folder"), (lambda p: p.mkdir(), "folder"),
                       (lambda p: None, "no such file")):
        path = tmp_path / said.replace("|", "-")
        make(path)
        with pytest.raises(FastGSError, match=said):
            open_file(path)
    if sys.platform.startswith("linux"):
        with pytest.raises(FastGSError, match="device"):
            open_file("/dev/zero")


def test_no_more_is_read_than_allowed(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('\ufeff{"a": [1, 2]}', "utf-8")
    assert read_json(path) == {"a": [1, 2]}
    with pytest.raises(FastGSError, match="more than"):
        read_bytes(path, 10)
    path.write_text("[" * 100_000)
    with pytest.raises(FastGSError, match="JSON"):
        read_json(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FastGSError, match="JSON"):
        read_json(path)


def test_messages_hold_nothing_that_a_terminal_obeys_or_utf8_lacks():
    assert printable("a\x1b[31mb\udcff é 漢\n\t") == "a\\x1b[31mb\\udcff é 漢\\n\\t"
    assert printable_lines("a\tb\n\rc\u202e") == "a   b\n\\rc\\u202e"
    assert str(FastGSError("x\x07\ud800")).encode() == b"x\\x07\\ud800"
