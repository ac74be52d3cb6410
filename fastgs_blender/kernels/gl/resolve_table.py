# SPDX-License-Identifier: GPL-3.0-or-later
"""The parameters of the resolve shader, as one row of a texture.  The shader (resolve.py) reads them by the same names."""
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from ...cameras.camera import Camera
from ...model.appearance import ACTIVATIONS, DECODES, Features
from ...rendering.looks import LOOK_NUMBERS
from .frame_table import Depths

HIDDEN = len(Features().w1)
"""Hidden units of a decoder; a unit's 12 weights take three texels."""


class ResolveTexel(IntEnum):
    """Places in the row.

    KIND        whether colours are decoded from sRGB, the activation's code, whether it is a sum of groups, whether it is to be summed
    BACKGROUND  colour, and whether there is one; the colour does not count where there is a panorama
    BORDER      part of the framebuffer to draw: left, bottom, right, top, 0..1
    WHOLE       whether the background and the coverage are drawn, the opacity, what the decoder is given
    SIZE        width, height, orthographic, share of their colour that pixels outside FRAME keep
    LENS        fx, fy, cx, cy
    TO_MODEL    three rows from the camera's space to the model's
    W1, W2      the decoder's matrices
    WORKING     three rows from linear Rec.709 to the target's primaries
    FRAME       where colours are as they are: left, bottom, right, top, 0..1
    DEPTHS      of the window, see Depths
    LOOK        five texels of the decoder's instance, see rendering/looks.py
    SKY         width and height of the panorama that is the background, width and height of the camera's picture
    TO_WORLD    three rows from the camera's directions to the world's
    SELECTED, REFUSED  five texels of the looks of what is marked with 1 and with -1
    """

    KIND = 0
    BACKGROUND = 1
    BORDER = 2
    WHOLE = 3
    SIZE = 4
    LENS = 5
    TO_MODEL = 6
    W1 = 9
    W2 = W1 + 3 * HIDDEN
    WORKING = W2 + HIDDEN
    FRAME = WORKING + 3
    DEPTHS = FRAME + 1
    LOOK = DEPTHS + 1
    SKY = LOOK + LOOK_NUMBERS // 4
    TO_WORLD = SKY + 1
    SELECTED = TO_WORLD + 3
    REFUSED = SELECTED + LOOK_NUMBERS // 4


TEXELS = ResolveTexel.REFUSED + LOOK_NUMBERS // 4
"""Length of the row."""


def resolve_table(camera: Camera, size: tuple[int, int], group: Any, working: np.ndarray, background: Any = None,
                  border: Sequence[float] = (0, 0, 1, 1), opacity: float = 1.0, frame: Sequence[float] = (0, 0, 1, 1), outside: float = 1.0,
                  depths: Depths | None = None, sky: Any = None, first: bool = True, summed: bool = False, raw: bool = False) -> np.ndarray:
    """float32 [1, texels, 4].

    size       width and height of the picture
    group      of instances, see picture.Group
    sky        width and height of the panorama behind the splats, or None
    first      whether this also brings the background and the coverage
    summed     whether the colours are sums of groups, which bring their weight along
    raw        whether the colours are to be summed, and stay as they are
    For the rest see Picture.resolve().
    """
    colour_space, decoder = group.colour_space, group.instance
    values = np.zeros((1, TEXELS, 4), np.float32)
    row, at = values[0], ResolveTexel
    appearance = decoder and decoder.model.appearance
    activation = ACTIVATIONS.index(appearance.activation) if appearance else 0
    row[at.KIND] = colour_space == "srgb" and not raw, activation, summed, raw
    row[at.BACKGROUND] = (0, 0, 0, 0) if background is None else (*background, 1)
    if sky:
        row[at.SKY] = *sky, camera.width, camera.height
        row[at.TO_WORLD:at.TO_WORLD + 3, :3] = np.linalg.inv(camera.world_to_camera)[:3, :3]
    row[at.BORDER] = border
    row[at.WHOLE] = first, opacity, DECODES.index(appearance.decode) if appearance else 0, 0
    row[at.SIZE] = *size, camera.orthographic, outside
    row[at.LENS] = camera.fx, camera.fy, camera.cx, camera.cy
    if appearance:
        row[at.TO_MODEL:at.TO_MODEL + 3] = decoder.camera_to_model[:3]
        row[at.W1:at.W2] = appearance.w1.reshape(-1, 4)
        row[at.W2:at.WORKING, :3] = appearance.w2.T
        row[at.LOOK:at.SKY] = decoder.look.reshape(-1, 4)
        for mark, place in ((1, at.SELECTED), (-1, at.REFUSED)):
            row[place:place + LOOK_NUMBERS // 4] = group.marks.get(mark, decoder.look).reshape(-1, 4)
    row[at.WORKING:at.WORKING + 3, :3] = working
    row[at.FRAME] = frame
    if depths:
        row[at.DEPTHS, :2] = depths.a, depths.b
    return values
