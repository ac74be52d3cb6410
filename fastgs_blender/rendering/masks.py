# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks: Gaussians that were hidden by hand, as a short text."""
import base64
import binascii
import zlib

import numpy as np


def pack_mask(bits: np.ndarray) -> str:
    """The text of a mask [N] bool; "" where nothing is hidden."""
    if not bits.any():
        return ""
    return f"{len(bits)} {base64.b85encode(zlib.compress(np.packbits(bits).tobytes(), 6)).decode()}"


def unpack_mask(text: str, count: int) -> np.ndarray:
    """The mask [count] bool of a text.  A text that is none, or belongs to another number of Gaussians, hides nothing."""
    length, _, packed = text.partition(" ")
    size = -(-count // 8)
    if length == str(count):
        try:
            found = zlib.decompressobj().decompress(base64.b85decode(packed), size + 1)
        except (ValueError, zlib.error, binascii.Error):
            found = b""
        if len(found) == size:
            return np.unpackbits(np.frombuffer(found, np.uint8), count=count).astype(bool)
    return np.zeros(count, bool)
