# SPDX-License-Identifier: GPL-3.0-or-later
"""Unpacks bytes whose length is known (zstd by the package zstandard, which Blender brings along; zlib), and the whole numbers in them."""
from __future__ import annotations

import zlib

import numpy as np

from ..util.errors import FastGSError

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
    if left != 1:
        raise FastGSError(f"{what} does not unpack to the {size} bytes that the file says; it is damaged, so copy it again.")
    return b"".join(pieces)


def inflated(data: bytes | memoryview, size: int, what: str = "a stream in it") -> bytes:
    """Exactly the `size` bytes of a zlib stream: memory is taken as they come, not as the file says.  Raises FastGSError."""
    try:
        machine = zlib.decompressobj()
        out = machine.decompress(data, size + 1)
    except (zlib.error, OverflowError) as error:
        raise FastGSError(f"{what} is damaged ({error}); copy or export the file again.") from error
    if len(out) != size or not machine.eof:
        raise FastGSError(f"{what} does not have the {size} bytes that the file says; copy or export it again.")
    return out


def joined(planes: bytes, width: int) -> np.ndarray:
    """Unsigned numbers [N] of `width` bytes whose lowest bytes come first, then all second ones, and so on."""
    return np.ascontiguousarray(np.frombuffer(planes, np.uint8).reshape(width, -1).T).view(f"<u{width}").reshape(-1)


def signed(code: np.ndarray) -> np.ndarray:
    """Whole numbers int64 of zigzag codes (0, -1, 1, -2, ...)."""
    code = code.astype(np.int64)
    return (code >> 1) ^ -(code & 1)
