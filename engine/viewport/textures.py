# SPDX-License-Identifier: GPL-3.0-or-later
"""Uploads arrays to the GPU as 2D float textures, the one kind of data that every GPU backend of Blender takes from Python."""
import gpu
import numpy as np

from ...fastgs_blender.kernels.gl.model_texels import WIDTH

ROWS = 16384
"""The most rows that every supported GPU takes."""

FORMATS = {1: 'R32F', 2: 'RG32F', 4: 'RGBA32F'}


class Sent:
    """Counts the bytes that are uploaded to the GPU."""

    bytes = 0


def upload(array: np.ndarray, half: bool = False):
    """A texture [h, w] of an array [h, w, c] with c 1, 2 or 4; half stores it in 16 bits."""
    height, width, channels = array.shape
    flat = np.ascontiguousarray(array, np.float32).reshape(-1)
    Sent.bytes += flat.nbytes
    kind = 'RGBA16F' if half and channels == 4 else FORMATS[channels]
    return gpu.types.GPUTexture((width, height), format=kind, data=gpu.types.Buffer('FLOAT', flat.size, flat))


def rows_of(texels: int) -> int:
    """Rows of a data texture that holds so many texels; at least one."""
    return max(-(-texels // WIDTH), 1)


def read(framebuffer, width: int, height: int, slot: int = 0) -> np.ndarray:
    """float32 [h, w, 4] of a framebuffer's colour, the bottom row first."""
    buffer = framebuffer.read_color(0, 0, width, height, 4, slot, 'FLOAT')
    return flat(buffer).reshape(height, width, 4)


def flat(buffer) -> np.ndarray:
    """A Buffer's floats [n], copied.  Blender 4.3 hands out wrong strides unless the Buffer is made flat first."""
    buffer.dimensions = int(np.prod(buffer.dimensions))
    return np.frombuffer(memoryview(buffer), np.float32).copy()
