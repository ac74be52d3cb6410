# SPDX-License-Identifier: GPL-3.0-or-later
"""Unpacks bytes whose length is known, and the whole numbers in them.

zstd by the package zstandard, which Blender brings along; zlib; LZ4's blocks here, because no library for them comes with Blender.
"""
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np

from ..util.errors import FastGSError
from ..util.reading import damaged_if

PIECE = 1 << 20
"""Bytes that are unpacked at a time: no more memory is taken than there is content for."""


def unzstd(data: bytes | memoryview, size: int, what: str = "it") -> bytes:
    """Exactly the `size` bytes that a frame holds; raises FastGSError where it holds another number of them.

    what  is packed, for error messages
    Windows up to 8 MB are unpacked, as RFC 8878 wants it of every reader, and larger ones where so much is promised.
    """
    try:
        import zstandard
    except ImportError as error:
        raise FastGSError(f"{what} is packed with zstd, for which the Python package zstandard is missing here; install it "
                          "(pip install zstandard), or export the file again with another compression.") from error
    window = 1 << max(23, min(27, size.bit_length()))
    reader = zstandard.ZstdDecompressor(max_window_size=window).stream_reader(data)
    pieces, left = [], size + 1
    try:
        while left > 0 and (piece := reader.read(min(PIECE, left))):
            pieces.append(piece)
            left -= len(piece)
    except zstandard.ZstdError as error:
        raise FastGSError(f"{what} cannot be unpacked ({error}); the file is damaged, so copy it again.") from error
    damaged_if(left != 1, f"{what} does not unpack to the {size} bytes that the file says")
    return b"".join(pieces)


def inflated(data: bytes | memoryview, size: int, what: str = "a stream in it") -> bytes:
    """Exactly the `size` bytes of a zlib stream: memory is taken as they come, not as the file says.  Raises FastGSError."""
    try:
        machine = zlib.decompressobj()
        out = machine.decompress(data, size + 1)
    except (zlib.error, OverflowError) as error:
        raise FastGSError(f"{what} is damaged ({error}); copy or export the file again.") from error
    damaged_if(len(out) != size or not machine.eof, f"{what} does not have the {size} bytes that the file says")
    return out


def joined(planes: bytes, width: int) -> np.ndarray:
    """Unsigned numbers [N] of `width` bytes whose lowest bytes come first, then all second ones, and so on."""
    return np.ascontiguousarray(np.frombuffer(planes, np.uint8).reshape(width, -1).T).view(f"<u{width}").reshape(-1)


def signed(code: np.ndarray) -> np.ndarray:
    """Whole numbers int64 of zigzag codes (0, -1, 1, -2, ...)."""
    code = code.astype(np.int64)
    return (code >> 1) ^ -(code & 1)


def unlz4(block: bytes, size: int) -> np.ndarray:
    """The `size` bytes of an LZ4 block (lz4_Block_format.md), as u8; raises FastGSError where it holds another number of them.

    A block cannot hold more than 255 times its own length, so that nothing is allocated on the word of a damaged file.
    """
    out = np.empty(size, np.uint8) if 0 <= size <= 255 * len(block) else None
    if out is None or _lz4()(np.frombuffer(block, np.uint8), out) != size:
        raise FastGSError("a packed frame of it is damaged; copy the file again.")
    return out


@cache
def _lz4() -> Callable[..., int]:
    from ..kernels.cpu.jit import kernel

    return kernel(_unpack)


def _unpack(block: np.ndarray, out: np.ndarray) -> int:
    """Fills out [size] from a block; returns how many bytes it held, or -1 where it is damaged."""
    at, end, put, size = 0, len(block), 0, len(out)
    while at < end:
        token = block[at]
        at += 1
        back = 0  # first bytes of the block, then bytes that are there already, `back` before
        for nibble in (np.int64(token >> 4), np.int64(token & 15)):
            count, more = int(nibble), 255 if nibble == 15 else 0
            while more == 255:
                if at >= end:
                    return -1
                more = int(block[at])
                count += more
                at += 1
            count += 4 if back else 0
            if count > size - put or (count > end - at if back == 0 else back > put):
                return -1
            for k in range(count):
                out[put + k] = block[at + k] if back == 0 else out[put + k - back]
            put += count
            if back == 0:
                at += count
                if at == end:
                    return put
                if end - at < 2:
                    return -1
                back = int(block[at]) + 256 * int(block[at + 1])
                at += 2
                if back == 0:
                    return -1
    return -1
