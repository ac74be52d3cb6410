# SPDX-License-Identifier: GPL-3.0-or-later
"""Cryptomatte 1.2 for objects: numbers for names, and what a file says of them (Psyop, "Cryptomatte Specification").

A level is a picture of four channels: the number of the object that covers most of a pixel and how much of it, then the same of the
next.  Blender and others call the levels CryptoObject00, CryptoObject01 and so on.
"""
import json
from collections.abc import Iterable

import numpy as np

LAYER = "CryptoObject"
PAIRS = 2
"""Objects in a level."""


def murmur3(data: bytes) -> int:
    """MurmurHash3_x86_32 with the seed 0, as Cryptomatte names objects (Austin Appleby, public domain description)."""
    def mixed(k: int) -> int:
        k = k * 0xcc9e2d51 & 0xffffffff
        k = (k << 15 | k >> 17) & 0xffffffff
        return k * 0x1b873593 & 0xffffffff

    h, whole = 0, len(data) - len(data) % 4
    for i in range(0, whole, 4):
        h ^= mixed(int.from_bytes(data[i:i + 4], "little"))
        h = (h << 13 | h >> 19) & 0xffffffff
        h = (h * 5 + 0xe6546b64) & 0xffffffff
    if len(data) > whole:
        h ^= mixed(int.from_bytes(data[whole:], "little"))
    h ^= len(data)
    for shift, factor in ((16, 0x85ebca6b), (13, 0xc2b2ae35), (16, 1)):
        h = (h ^ h >> shift) * factor & 0xffffffff
    return h


def bits_of(name: str) -> int:
    """The 32 bits that stand for a name: its hash, changed in one bit where these would be an infinity, a NaN or denormalised."""
    return in_pictures(murmur3(name.encode()))


def in_pictures(code: int) -> int:
    """The bits of a hash in pictures.  Manifests of Cycles hold the hash itself, as it was before that one bit was changed."""
    return code ^ 1 << 23 if code >> 23 & 255 in (0, 255) else code


def number(name: str) -> np.float32:
    """The float32 that stands for a name in pictures."""
    return np.uint32(bits_of(name)).view(np.float32)


def level(shares: np.ndarray, names: list[str], index: int) -> np.ndarray:
    """One level [h, w, 4] from the shares [h, w, K] of the pixel that K objects of these names cover; objects of one name are one."""
    unique = list(dict.fromkeys(names))
    out = np.zeros((*shares.shape[:2], 2 * PAIRS), np.float32)
    if PAIRS * index >= len(unique):
        return out
    merged = np.stack([shares[..., [i for i, name in enumerate(names) if name == each]].sum(-1) for each in unique], -1)
    ranks = np.argsort(-merged, axis=-1, kind="stable")[..., PAIRS * index:PAIRS * (index + 1)]
    cover = np.take_along_axis(merged, ranks, -1)
    numbers = np.array([number(name) for name in unique])[ranks]
    out[..., 0:2 * ranks.shape[-1]:2] = np.where(cover > 0, numbers, 0)
    out[..., 1:2 * ranks.shape[-1]:2] = cover
    return out


def metadata(names: Iterable[str], layer: str = LAYER) -> dict[str, str]:
    """The attributes of a file whose channels `layer`00.r and so on hold levels: the names and how they became numbers."""
    manifest = json.dumps({name: f"{bits_of(name):08x}" for name in names}, separators=(",", ":"), ensure_ascii=False)
    values = {"name": layer, "hash": "MurmurHash3_32", "conversion": "uint32_to_float32", "manifest": manifest}
    return {f"cryptomatte/{murmur3(layer.encode()):08x}"[:19] + f"/{key}": value for key, value in values.items()}
