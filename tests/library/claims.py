# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that claim more than they hold, and the memory that reading them takes."""
from __future__ import annotations

import io
import itertools
import pickletools
import re
import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable, Iterator

import numpy as np

from fastgs_blender.util.errors import FastGSError, LossWarning

COUNT = 3989
"""Gaussians; a number that nothing else in a file is likely to be."""
BIG = 1999 * COUNT
"""What files claim to hold instead."""
TIMES, SLACK = 4, 1 << 20
"""How many times its size a file may take, and bytes that any reading takes: buffers, tables, JSON."""
Lies = Iterator[tuple[str, bytes]]


def refused(read: Callable[[], object], size: int, what: str) -> bool:
    """Whether read() raises FastGSError; it may take TIMES the size until then, and not more.

    The memory that is traced is that of all threads, so a reading that seems to take too much is made twice more: what an import or a
    thread that an earlier test left behind takes does not come again.
    """
    peaks = []
    while len(peaks) < 3:
        tracemalloc.start()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LossWarning)
                read()
        except FastGSError:
            peaks.append(tracemalloc.get_traced_memory()[1])
        else:
            return False
        finally:
            tracemalloc.stop()
        if peaks[-1] <= TIMES * size + SLACK:
            return True
    raise AssertionError(f"{what}: {peaks} bytes for {size}")


def liars(data: bytes, count: int, head: int = 8192) -> Lies:
    """The file cut short, and with every number of its Gaussians, in text or in binary, made large; head: how much of it is searched."""
    yield "cut short", data[:int(0.6 * len(data))]
    for code in ("<I", "<Q", ">I"):
        raw = struct.pack(code, count)
        for found in list(re.finditer(re.escape(raw), data[:head]))[:6]:
            yield f"{code} at {found.start()}", data[:found.start()] + struct.pack(code, BIG) + data[found.end():]
    text = str(count).encode()
    for found in list(re.finditer(rb"(?<!\d)" + text + rb"(?!\d)", data[:head]))[:8]:
        yield f"text at {found.start()}", data[:found.start()] + str(BIG).encode()[:len(text)].ljust(len(text), b"9") + data[found.end():]
        yield f"long text at {found.start()}", data[:found.start()] + str(BIG).encode() + data[found.end():]


def lying_zips(data: bytes) -> Lies:
    """A zip file of arrays or of PyTorch, cut short, with members that claim to be large, and with every dimension and number large."""
    yield "cut short", data[:int(0.6 * len(data))]
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(member, archive.read(member)) for member in archive.infolist()]
    for member, content in members:
        yield f"size of {member.filename}", data.replace(struct.pack("<I", member.file_size), struct.pack("<I", BIG))
        lies = _arrays(content) if member.filename.endswith(".npy") else _pickles(content) if member.filename.endswith(".pkl") else ()
        for what, lie in lies:
            out = io.BytesIO()
            with zipfile.ZipFile(out, "w") as archive:
                for other, whole in members:
                    archive.writestr(other, lie if other is member else whole)
            yield f"{member.filename}: {what}", out.getvalue()


def _arrays(content: bytes) -> Lies:
    """An .npy file, each of its dimensions large."""
    stream = io.BytesIO(content)
    np.lib.format.read_magic(stream)
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    for axis in range(len(shape)):
        out, longer = io.BytesIO(), (*shape[:axis], BIG, *shape[axis + 1:])
        np.lib.format.write_array_header_1_0(out, {"shape": longer, "fortran_order": fortran, "descr": np.lib.format.dtype_to_descr(dtype)})
        yield f"axis {axis}", out.getvalue() + stream.getvalue()[stream.tell():]


def _pickles(content: bytes) -> Lies:
    """A pickle, each of its whole numbers large."""
    starts = [(at, opcode.name) for opcode, _, at in pickletools.genops(content)]
    for (at, name), (after, _) in itertools.pairwise(starts):
        if name in ("BININT", "BININT1", "BININT2"):
            yield f"{name} at {at}", content[:at] + b"J" + struct.pack("<i", BIG) + content[after:]
