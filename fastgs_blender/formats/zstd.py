# SPDX-License-Identifier: GPL-3.0-or-later
"""Unpacks zstd frames whose length is known, with the package zstandard, which Blender brings along."""
from __future__ import annotations

from ..util.errors import FastGSError

PIECE = 1 << 20
"""Bytes that are unpacked at a time: no more memory is taken than there is content for."""


def unpacked(data: bytes | memoryview, size: int, what: str = "it") -> bytes:
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
