# SPDX-License-Identifier: GPL-3.0-or-later
"""Unpacks LZ4 blocks (https://github.com/lz4/lz4/blob/dev/doc/lz4_Block_format.md): no library for them comes with Blender."""
from __future__ import annotations

from functools import cache

import numpy as np

from ..util.errors import FastGSError


def unpack(block: bytes, size: int) -> np.ndarray:
    """The `size` bytes that a block holds, as u8; raises FastGSError where it holds another number of them.

    A block cannot hold more than 255 times its own length, so that nothing is allocated on the word of a damaged file.
    """
    out = np.empty(size, np.uint8) if 0 <= size <= 255 * len(block) else None
    if out is None or _kernel()(np.frombuffer(block, np.uint8), out) != size:
        raise FastGSError("a packed frame of it is damaged; copy the file again.")
    return out


@cache
def _kernel():
    from ..kernels.cpu.jit import kernel

    return kernel(_unpack)


def _unpack(block, out):
    """Fills out [size] from a block; returns how many bytes it held, or -1 where it is damaged."""
    at, end, put, size = 0, len(block), 0, len(out)
    while at < end:
        token = block[at]
        at += 1
        count = int(token >> 4)
        if count == 15:
            more = 255
            while more == 255:
                if at >= end:
                    return -1
                more = int(block[at])
                count += more
                at += 1
        if count > end - at or count > size - put:
            return -1
        for k in range(count):
            out[put + k] = block[at + k]
        at += count
        put += count
        if at == end:
            return put
        if end - at < 2:
            return -1
        back = int(block[at]) + 256 * int(block[at + 1])
        at += 2
        count = int(token & 15) + 4
        if count == 19:
            more = 255
            while more == 255:
                if at >= end:
                    return -1
                more = int(block[at])
                count += more
                at += 1
        if back == 0 or back > put or count > size - put:
            return -1
        for k in range(count):
            out[put + k] = out[put + k - back]
        put += count
    return -1
