# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes `.4dgs` files of the temporal model gaussian-birth: one chunk, deflate, grids as fine as the model asks for."""
import math
import struct
import zlib

import numpy as np

from ..model.appearance import SH_C0
from ..model.gaussians import GaussianModel
from ..model.slicing import sigmoid
from ..model.temporal import Radial
from . import fourdgs_streams as wire
from .base import STEEP, generator
from .static import largest_and_rest

CUTOFF = 1 / 1024
"""Temporal factors below this are not seen."""
STEPS = {"pos": 2.0**-20, "scale_log": 1 / 256, "rot": 2.0**-14, "rgb": 1 / 4096, "alpha": 1 / 4096, "motion": 2.0**-18,
         "time": 2.0**-14, "sigma_log": 1 / 128}
"""pos and motion in units of the scene's extent."""
LARGEST = 2**29


def file(model: GaussianModel) -> bytes:
    """The file of a model in the kinds that FourDGS.fit() returns."""
    n, duration = len(model), model.clip.duration
    place = model.position.astype(np.float64)
    low, high = (place.min(0), place.max(0)) if n else (np.zeros(3), np.ones(3))
    origin, extent = 0.5 * (low + high), max(float((high - low).max()), 1e-9)
    steps = STEPS | {"pos": STEPS["pos"] * extent, "motion": STEPS["motion"] * extent}
    ln_s = model.temporal[:, 0].astype(np.float64) if isinstance(model.temporal_kind, Radial) else np.full(n, -STEEP)
    ln_sigma = np.rint((math.log(duration) - 0.5 * (math.log(2) + ln_s)) / steps["sigma_log"]) * steps["sigma_log"]
    always = ln_sigma > math.log(duration) + 8  # nothing of such a bell is to be seen within the clip
    ln_sigma = np.where(always, 0, ln_sigma)
    sigma = np.exp(ln_sigma)
    half = np.clip(np.where(always, 3 * duration, math.sqrt(-2 * math.log(CUTOFF)) * sigma), 0.02, 2.0)
    motion_step = steps["motion"] * 2.0 ** -np.clip(np.ceil(np.log2(half / 0.5)), -4, 2)
    finest = np.where(always, steps["time"], np.minimum(steps["time"], 0.05 * sigma))
    mu_step = steps["time"] * 2.0 ** np.clip(np.floor(np.log2(finest / steps["time"])), -10, 0)
    velocity = model.motion[:, 0].astype(np.float64) / duration if model.basis.terms else np.zeros((n, 3))
    rgb = np.clip(0.5 + SH_C0 * model.features[:, :3].astype(np.float64), 0, 1)
    red, green, blue = _whole(rgb / steps["rgb"]).T
    largest, rest = largest_and_rest(model.rotation[:, [1, 2, 3, 0]])
    mu = _whole(model.mu_tau * duration / mu_step)
    moved = velocity * (mu * mu_step - model.mu_tau * duration)[:, None]  # the place at the moment that is written
    table = {
        wire.POSITION: (place + moved - origin) / steps["pos"], wire.SCALE: model.scale / steps["scale_log"], wire.OMITTED: largest,
        wire.ROTATION: rest / steps["rot"], wire.COLOUR: np.stack([green, red - green, blue - green], 1),
        wire.OPACITY: sigmoid(model.opacity) / steps["alpha"], wire.MOTION: velocity / motion_step[:, None], wire.MU: mu,
        wire.SIGMA: ln_sigma / steps["sigma_log"], wire.FLAGS: always.astype(int), wire.WINDOW: np.zeros(n, int)}
    degree = model.appearance.degree
    body = b"".join(_stream(attribute, values) for attribute, values in table.items())
    packed = zlib.compress(body, 6)
    chunk = struct.pack("<ddII", 0.0, duration, 0, n) + _text("deflate") + struct.pack("<QQ", len(body), len(packed)) + packed
    bands = b""
    coefficients = model.features.reshape(n, (degree + 1) ** 2, 3)
    for band in range(1, degree + 1):
        part = coefficients[:, band**2:(band + 1) ** 2].transpose(0, 2, 1).reshape(n, 3 * (2 * band + 1))
        bands += _record(7, struct.pack("<B", band) + _stream(7, np.clip((part + 4) * (255 / 8), 0, 255)))
    head = _text("") + _text(generator()) + struct.pack("<dQd", duration, n, CUTOFF) + _text("gaussian-birth")
    head += struct.pack("<6dBB", *low, *high, degree, 0) + struct.pack("<I", 0)
    grids = _text("uniform-v1") + struct.pack("<3d8dB", *origin, *steps.values(), 1) + struct.pack("<I", 0)
    windows = struct.pack("<I2d", 1, -duration, 2 * duration)
    parts = [_record(1, head), _record(3, grids), _record(4, windows), _record(5, chunk), bands, _record(2, bytes(20))]
    return wire.MAGIC + b"".join(parts) + wire.MAGIC


def _whole(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), -LARGEST, LARGEST).astype(np.int64)


def _text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _stream(attribute: int, values: np.ndarray) -> bytes:
    """An attribute's whole numbers [N, ...], zigzag, byte plane by byte plane, deflated."""
    whole = _whole(np.asarray(values, np.float64))
    whole = whole.reshape(len(whole), math.prod(whole.shape[1:]))
    planes = ((whole << 1) ^ (whole >> 63)).astype("<u4").reshape(-1).view(np.uint8).reshape(-1, 4).T.tobytes()
    payload = zlib.compress(planes, 6)
    return struct.pack("<5BIQ", attribute, 4, wire.RAW, 0, whole.shape[1], len(whole), len(payload)) + payload
