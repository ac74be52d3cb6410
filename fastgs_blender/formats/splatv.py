# SPDX-License-Identifier: GPL-3.0-or-later
"""`.splatv` of splaTV: Spacetime Gaussians lite, packed into a texture of 64 bytes a Gaussian.

u32 magic, u32 length of the JSON, the JSON (a list of chunks), the chunks.  The chunk of type "splat" holds texels; by
16-bit halves: 0-5 position (float32), 6-9 rotation, 10-12 scale, 14-15 RGB and opacity as bytes, 16-24 cubic motion,
26-29 omega, 30 temporal centre, 31 temporal width s in exp(-((t - centre) / s)^2).  Records of zeros are padding.
The rasteriser's constants are Raster's defaults unless the JSON, in a key of ours that others pass over, has them.
"""
import json
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras.opening import RIGHT_DOWN_FORWARD
from ..model.gaussians import Clip, GaussianModel
from ..model.slicing import sigmoid
from ..model.temporal import Radial
from ..util.errors import FastGSError
from ..util.reading import damaged_if, exactly, open_file
from .base import Format
from .description import describe, read_json, restored, understand, whole_number
from .fitting import bell_opacity, linear_rotation, plain_colour, polynomial_motion

MAGIC = struct.pack("<I", 0x674B)
ROW = 1024
"""Gaussians in a row of the texture, which is 4096 texels wide."""
RECORD = 64
"""Bytes of a Gaussian."""
HALF_MAX, HALF_MIN = 65504.0, 2.0**-24
KEYS = ("basis", "rotation_basis", "temporal", "raster", "clip", "axes", "colour_space", "provenance", "surroundings")
FRAMES = 50
"""As Spacetime Gaussians are trained."""


class Splatv(Format):
    """`.splatv` of splaTV."""

    name = "splaTV"
    magic = MAGIC
    extensions = reads = (".splatv",)
    keeps_cameras = True

    def load(self, path: Path) -> GaussianModel:
        with open_file(path) as stream:
            length = os.fstat(stream.fileno()).st_size
            size = int.from_bytes(stream.read(8)[4:], "little")
            chunk, begin, last = _splat_chunk(read_json(exactly(stream, size)))
            begin, count = begin + 8 + size, whole_number(chunk.get("size"), "the size of its Gaussians")
            if last and "fastgs" not in chunk and 0 < begin + count - length < ROW * RECORD:
                count = length - begin  # splaTV's own converter states the size of the whole texture and leaves its last row unfilled
            damaged_if(count % RECORD or begin + count > length, f"the file is cut short: {count} bytes of Gaussians are promised")
            stream.seek(begin)
            texels = np.frombuffer(stream.read(count), "<u4").reshape(-1, 16)
            more = length - begin - count if last else 0  # zeros that fill the texture's last row hold nothing
            damaged_if(more >= ROW * RECORD or any(stream.read(more)), "there is more in the file than its header says")
        recorded = understand(chunk.get("fastgs", {}))
        recorded.pop("appearance", None)
        return GaussianModel(**restored(_decode(texels[texels.any(1)]), {"clip": Clip(FRAMES)} | recorded))

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        lost = []
        for step in (bell_opacity, polynomial_motion, linear_rotation, lambda m: plain_colour(m, keep_features=False)):
            model, clauses = step(model)
            lost += clauses
        texels, clipped = _encode(model)
        if clipped:
            lost.append(f"numbers beyond {HALF_MAX:.0f} or below {HALF_MIN:.0e} do not fit and are cut")
        if not _same(model, _decode(texels)):
            lost.append("colour and opacity are rounded to 8 bits, and all but positions to half precision")
        return model, lost

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        texels = _encode(model)[0]
        with np.errstate(over="ignore"):
            importance = np.exp(model.scale.sum(1, dtype=np.float64)) / (1 + np.exp(-model.opacity.astype(np.float64)))
        texels = texels[np.argsort(-importance, kind="stable")]
        rows = max(1, -(-len(texels) // ROW))
        chunk = {"type": "splat", "size": rows * ROW * RECORD, "texwidth": 4 * ROW, "texheight": rows, "cameras": [_camera(model)],
                 "fastgs": {k: v for k, v in describe(model).items() if k in KEYS}}
        text = json.dumps([chunk], allow_nan=False).encode("ascii")
        with open(targets[-1], "wb") as stream:
            stream.write(MAGIC + struct.pack("<I", len(text)) + text)
            stream.write(texels.tobytes())
            stream.write(bytes((rows * ROW - len(texels)) * RECORD))


def _splat_chunk(chunks: Any) -> tuple[dict, int, bool]:
    """The chunk of Gaussians, the bytes before it, and whether it is the last."""
    begin = 0
    for chunk in chunks:
        if chunk.get("type") == "splat":
            return chunk, begin, chunk is chunks[-1]
        begin += whole_number(chunk.get("size"), "the size of a chunk")
    raise FastGSError("it has no chunk of Gaussians.")


def _decode(texels: np.ndarray) -> dict[str, np.ndarray]:
    """Arrays of GaussianModel from records [N, 16] u32."""
    with np.errstate(invalid="ignore", divide="ignore"):
        half, byte = texels.view("<f2").astype(np.float32), texels[:, 7:8].view(np.uint8)
        opacity = np.clip(byte[:, 3] / 255.0, 1e-6, 1 - 1e-6)
        return {
            "position": texels[:, :3].copy().view("<f4"), "rotation": half[:, 6:10], "scale": np.log(half[:, 10:13]),
            "opacity": np.log(opacity / (1 - opacity)), "features": byte[:, :3] / np.float32(255),
            "motion": half[:, 16:25].reshape(-1, 3, 3), "rotation_motion": half[:, None, 26:30], "mu_tau": half[:, 30],
            "temporal": -2 * np.log(np.abs(half[:, 31:32])),
        }


def _encode(model: GaussianModel) -> tuple[np.ndarray, bool]:
    """Records [N, 16] u32 of a model in this format's kinds, and whether numbers had to be cut to fit half precision."""
    n = len(model)
    texels = np.zeros((n, 16), "<u4")
    texels[:, :3] = model.position.astype("<f4").view("<u4")
    half = np.zeros((n, 32), np.float64)
    width = np.exp(-0.5 * model.temporal[:, 0].astype(np.float64)) if isinstance(model.temporal_kind, Radial) else HALF_MAX
    with np.errstate(over="ignore"):
        half[:, 10:13] = np.exp(model.scale.astype(np.float64))
        half[:, 31] = width
        positive = half[:, [10, 11, 12, 31]]
        half[:, 6:10] = model.rotation
        motion, omega = 3 * model.basis.terms, 4 * model.rotation_basis.terms
        half[:, 16:16 + motion] = model.motion.reshape(n, motion)
        half[:, 26:26 + omega] = model.rotation_motion.reshape(n, omega)
        half[:, 30] = model.mu_tau
        clipped = bool((np.abs(half) > HALF_MAX).any() or (positive < 0.5 * HALF_MIN).any())
        half[:, [10, 11, 12, 31]] = np.maximum(positive, HALF_MIN)
        packed = np.clip(half, -HALF_MAX, HALF_MAX).astype("<f2").view("<u4")
        colour = np.concatenate([model.features, sigmoid(model.opacity)[:, None]], 1)
        byte = np.rint(np.clip(colour, 0, 1) * 255).astype(np.uint8)
    texels[:, 3:] = packed[:, 3:]
    texels[:, 7:8] = byte.view("<u4")
    return texels, clipped


def _same(model: GaussianModel, arrays: dict[str, np.ndarray]) -> bool:
    """Whether arrays of _decode() say what the model does."""
    def close(ours: np.ndarray, theirs: np.ndarray) -> bool:
        return np.allclose(ours, theirs.reshape(len(model), -1)[:, :ours[0].size].reshape(ours.shape) if len(model) else theirs, 1e-6, 1e-6)

    pairs = [(getattr(model, k), v) for k, v in arrays.items() if k not in ("position", "opacity") and getattr(model, k).size]
    return close(sigmoid(model.opacity), sigmoid(arrays["opacity"])) and all(close(a, b) for a, b in pairs)


def _camera(model: GaussianModel) -> dict:
    """Where a viewer begins: in front of the model, all of it in view."""
    low, high = np.percentile(model.position, (2, 98), axis=0).astype(np.float64) if len(model) else np.zeros((2, 3))
    turn = RIGHT_DOWN_FORWARD[model.axes].astype(int)
    distance = max(float(np.linalg.norm(high - low)), 1e-3)
    return {"id": 0, "img_name": "0", "width": 1280, "height": 720, "fx": 1000.0, "fy": 1000.0,
            "position": list((low + high) / 2 - 1.5 * distance * turn[2]),
            "rotation": turn.T.tolist()}
