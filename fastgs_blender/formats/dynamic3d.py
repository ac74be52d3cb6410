# SPDX-License-Identifier: GPL-3.0-or-later
"""`params.npz` of Dynamic 3D Gaussians: the same Gaussians at every frame, their places, rotations and colours in tables.

Arrays: means3D [T, N, 3], rgb_colors [T, N, 3] (or [N, 3]), unnorm_rotations [T, N, 4] w x y z, logit_opacities [N, 1], log_scales [N, 3]
or [N, 1]; seg_colors, cam_m and cam_c are ignored.  Between frames their code has no rule: here all is linear, rotations on the nearer
side and normalised.  Frame f of T lies at t = f / T.
"""
from pathlib import Path

import numpy as np

from ..model.appearance import RGB, Changing
from ..model.gaussians import Clip, GaussianModel
from ..model.motion import Keyframes
from ..util import rotations
from ..util.errors import FastGSError
from ..util.numpy_files import PackedArray, packed_arrays
from ..util.zip_files import members
from .base import Format
from .trained import numbers_of

NEEDED = {"means3D": (3,), "rgb_colors": (3,), "unnorm_rotations": (4,), "logit_opacities": (1,), "log_scales": (3,)}
FPS = 30.0
"""Frames per second of the Panoptic captures that it is trained on."""


class Dynamic3DGaussians(Format):
    name = "Dynamic 3D Gaussians"
    reads = (".npz",)

    def sniff(self, head: bytes, path: Path) -> bool:
        return {"means3D.npy", "unnorm_rotations.npy", "log_scales.npy"} <= members(head, path)

    def load(self, path: Path) -> GaussianModel:
        arrays = packed_arrays(path)
        missing = [name for name in NEEDED if name not in arrays]
        if missing:
            raise FastGSError(f"its arrays {', '.join(missing)} are missing; save it again.")
        shape = arrays["means3D"].shape
        if len(shape) != 3 or not shape[0]:
            raise FastGSError(f"its array means3D has the shape {shape}, not frames x Gaussians x 3; save it again.")
        frames, n = shape[:2]
        for name, last in NEEDED.items():
            found = arrays[name].shape
            if found[-1:] not in (last, (1,) if name == "log_scales" else last) or found[:-1] not in ((frames, n), (n,)):
                raise FastGSError(f"its array {name} has the shape {found}, which does not fit {frames} frames of {n} Gaussians; "
                                  "save it again.")
        if arrays["logit_opacities"].shape != (n, 1) or len(arrays["log_scales"].shape) != 2:
            raise FastGSError("its opacities or scales change in time, which this format does not know; save it again.")
        basis = Keyframes(tuple(f / frames for f in range(frames)))
        place, turn, colour = (_table(arrays[name], frames) for name in ("means3D", "unnorm_rotations", "rgb_colors"))
        changes = bool((colour != colour[:1]).any())
        middle = colour.mean(0, dtype=np.float64).astype(np.float32) if changes else colour[0]
        features = np.concatenate([middle, *(colour - middle)], 1) if changes else middle
        with np.errstate(all="ignore"):  # what is no number is found by usable()
            turn = rotations.one_sign(rotations.unit(turn.astype(np.float64))).astype(np.float32)
            return GaussianModel(
                position=place[0], motion=(place - place[0]).transpose(1, 0, 2), basis=basis,
                rotation=turn[0], rotation_motion=(turn - turn[0]).transpose(1, 0, 2), rotation_basis=basis,
                scale=np.broadcast_to(numbers_of(arrays["log_scales"]), (n, 3)), opacity=numbers_of(arrays["logit_opacities"])[:, 0],
                features=features, appearance=Changing(RGB(), basis) if changes else RGB(), clip=Clip(frames, FPS))


def _table(array: PackedArray, frames: int) -> np.ndarray:
    """Values [T, N, D] of an array that may have one for all frames."""
    values = numbers_of(array)
    return values if values.ndim == 3 else np.broadcast_to(values, (frames, *values.shape))
