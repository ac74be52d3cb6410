# SPDX-License-Identifier: GPL-3.0-or-later
"""The render passes: one table of what each is called, how it is computed, and how files and Blender name it.

A new pass is one entry of PASSES.  render(), `fastgs render`, the EXR writer and Blender's passes all read this table.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

FAR = np.float32(1e10)
"""Depth where there is nothing, in files and in Blender, as Blender's own engines write it: filters turn an infinity into NaN."""


@dataclass(frozen=True, eq=False)
class Blended:
    """What a picture's passes are computed from, NumPy arrays of the window.

    rgb     [h, w, 3]  premultiplied colour; None where no pass needs it
    alpha   [h, w]
    depth   [h, w]     sum of the splats' depths times their weights; None where no pass needs it
    median  [h, w]     median depth; None where no pass needs it
    """

    rgb: np.ndarray | None
    alpha: np.ndarray
    depth: np.ndarray | None
    median: np.ndarray | None


@dataclass(frozen=True)
class Pass:
    """One render pass.

    name      what render() calls it
    image     (Blended) -> [h, w] or [h, w, channels]
    needs     the members of Blended that `image` reads, alpha apart
    channels  1, or how many the last axis has
    empty     its value where nothing is drawn
    colour    whether it is a colour, which files and Blender get in scene-linear light
    exr       the names of its channels in an EXR file; "Layer.X" is the layer `Layer` in Blender's compositor
    blender   the pass of Blender that it fills.  Combined is filled by rgb and alpha together; of two that fill one pass,
              the scene's settings choose
    letters, kind   channels and type of that pass as Blender's API wants them
    switch    the property of Blender's view layer that switches it on: one of Blender's own, or with the prefix "fastgs." one of
              the extension's, which is made from this table
    description   what that switch of the extension's says to users
    """

    name: str
    image: Callable[[Blended], np.ndarray]
    needs: tuple[str, ...] = ()
    channels: int = 1
    empty: float = 0.0
    colour: bool = False
    exr: tuple[str, ...] = ()
    blender: str = ""
    letters: str = ""
    kind: str = "VALUE"
    switch: str = ""
    description: str = ""

    @property
    def builtin(self) -> bool:
        """Whether the pass, and the switch for it, are Blender's own."""
        return not self.switch.startswith("fastgs.")

    def shown(self, image: np.ndarray) -> np.ndarray:
        """The image [h, w] or [h, w, channels] as files and Blender hold it: FAR in place of infinity."""
        return np.minimum(image, FAR) if self.empty == np.inf else image


def _expected_depth(blended: Blended) -> np.ndarray:
    total, alpha = blended.depth, blended.alpha
    return np.divide(total, alpha, out=np.full(alpha.shape, np.inf, total.dtype), where=alpha > 0)


PASSES = {entry.name: entry for entry in (
    Pass("rgb", lambda b: b.rgb, ("rgb",), 3, colour=True, exr=("R", "G", "B"),
         blender="Combined", letters="RGBA", kind="COLOR", switch="use_pass_combined"),
    # not "Alpha": that is what the compositor calls Combined's fourth channel, and a pass of this name takes its socket away
    Pass("alpha", lambda b: b.alpha, exr=("A",), blender="Splat Alpha", letters="A", switch="fastgs.use_pass_alpha",
         description="Deliver the opacity of the splats, which the world does not fill up"),
    Pass("depth", _expected_depth, ("depth",), empty=np.inf, exr=("Depth.Z",), blender="Depth", letters="Z", switch="use_pass_z"),
    Pass("median_depth", lambda b: b.median, ("median",), empty=np.inf, exr=("MedianDepth.Z",), blender="Depth", letters="Z",
         switch="use_pass_z"),
)}
"""The passes by name."""
