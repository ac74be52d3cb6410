# SPDX-License-Identifier: GPL-3.0-or-later
"""No layout of captures takes memory on the word of its description: at most four times the folder's size before it is verified."""
from __future__ import annotations

import re
import struct
import tracemalloc
import warnings
from pathlib import Path

import pytest
import tiny_captures
from claims import BIG, TIMES

from fastgs_blender.captures import open_capture
from fastgs_blender.captures.sources import PICTURES, VIDEOS
from fastgs_blender.util.errors import FastGSError, LossWarning

SLACK = 6 << 20
"""Bytes that any reading takes: a buffer of 4 MiB, tables that modules make once.  What is claimed takes more, at a byte each."""


def lies(data: bytes):
    """A description cut short, and with each of its first numbers, in text or in binary, made large."""
    yield "cut short", data[:int(0.6 * len(data))]
    if b"\0" not in data:
        for found in list(re.finditer(rb"(?<![\w.])\d+(?![\w.])", data))[:25]:
            yield f"text at {found.start()}", data[:found.start()] + str(BIG).encode() + data[found.end():]
    else:  # COLMAP's binary files
        for at in range(0, min(len(data) - 8, 100), 4):
            yield f"binary at {at}", data[:at] + struct.pack("<Q", BIG) + data[at + 8:]


@pytest.mark.slow
@pytest.mark.parametrize("layout", tiny_captures.LAYOUTS)
def test_no_memory_on_the_word_of_a_description(layout, tmp_path):
    told = 0
    for make in tiny_captures.LAYOUTS[layout]:
        folder = tmp_path / make.__name__
        folder.mkdir()
        make(folder)
        open_capture(folder, layout=layout)
        size = sum(len(content) for content in tiny_captures.contents(folder).values())
        for file in sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix not in (*PICTURES, *VIDEOS)):
            whole = file.read_bytes()
            for what, data in lies(whole):
                file.write_bytes(data)
                told += within(folder, layout, size, f"{file.relative_to(folder)}, {what}")
            file.write_bytes(whole)
    assert told, "none of its claims is refused"


def within(folder: Path, layout: str, size: int, what: str) -> bool:
    """Whether a capture is refused; refused or not, opening it takes no more than it may."""
    tracemalloc.start()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LossWarning)
            open_capture(folder, layout=layout)
    except FastGSError:
        return True
    else:
        return False
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak <= TIMES * size + SLACK, f"{what}: {peak} bytes for {size}"
