# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered frames as files: PNG in display colours, multi-layer EXR in scene-linear floats."""
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from ..util import picture_files
from ..util.arguments import shown
from ..util.errors import FastGSError
from ..util.outputs import writing
from . import colour
from .passes import PASSES

ELSEWHERE = "free space on its disk or choose another folder"


def save_image(image: Mapping[str, np.ndarray], path: str | os.PathLike, colour_space: str = "srgb") -> None:
    """Write what render() returns: .png (8-bit sRGB with straight alpha), or .exr (all passes, 32-bit floats, scene-linear).

    image         {pass: [h, w] or [h, w, channels]}, with "rgb" and "alpha"
    colour_space  of the model: GaussianModel.colour_space
    Raises FastGSError.

    Example:
        fg.save_image(fg.render(model, camera, 0.25), "frame.png", model.colour_space)
    """
    if not isinstance(image, Mapping) or not {"rgb", "alpha"} <= set(image):
        raise FastGSError("save_image() takes what render() returns for at least the passes rgb and alpha, "
                          + (f"not {', '.join(image) or 'none'} alone." if isinstance(image, Mapping) else f"not {shown(image)}."))
    path = Path(path)
    if path.suffix.lower() not in (".png", ".exr"):
        raise FastGSError(f"{path}: a picture is written as .png or .exr; choose one of them.")
    (write_png if path.suffix.lower() == ".png" else write_exr)(path, image, colour_space)


def write_png(path: str | os.PathLike, image: Mapping[str, np.ndarray], colour_space: str) -> None:
    """image["rgb"] and ["alpha"], as render() returns them, as 8-bit sRGB with straight alpha."""
    with writing([path], ELSEWHERE) as (part,):
        part.write_bytes(png(image, colour_space))


def png(image: Mapping[str, np.ndarray], colour_space: str) -> bytes:
    """The bytes of that file."""
    rgb = colour.display(image["rgb"], image["alpha"], colour_space)
    rgba = np.concatenate([rgb, image["alpha"][..., None]], -1)
    return picture_files.png(np.floor(np.clip(rgba, 0, 1) * 255 + 0.5).astype(np.uint8))


def write_exr(path: str | os.PathLike, image: Mapping[str, np.ndarray], colour_space: str, passes: Iterable[str] | None = None,
              texts: dict[str, str] | None = None) -> None:
    """The passes (default: all in image) as 32-bit float channels, named so that Blender finds its passes again.

    rgb and alpha are R, G, B, A: premultiplied, scene-linear, Rec. 709 primaries.  Every other pass is a layer, such as Depth.Z and
    MedianDepth.Z (1e10 where there is nothing); passes.py has the names.  image["alpha"] must be there if "rgb" is.  texts become
    attributes of the file.
    """
    planes = _channels(image, colour_space, image if passes is None else passes)
    with writing([path], ELSEWHERE) as (part,):
        picture_files.write_exr(part, planes, texts)


def _channels(image: Mapping[str, np.ndarray], colour_space: str, passes: Iterable[str]) -> dict[str, np.ndarray]:
    planes: dict[str, np.ndarray] = {}
    for entry in (PASSES[name] for name in passes):
        values = entry.shown(image[entry.name])
        if entry.colour:
            values = colour.scene_linear(values, image["alpha"], colour_space)
        planes.update(zip(entry.exr, values[None] if entry.channels == 1 else np.moveaxis(values, -1, 0), strict=True))
    return {name: np.ascontiguousarray(plane, np.float32) for name, plane in planes.items()}


