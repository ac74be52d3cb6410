# SPDX-License-Identifier: GPL-3.0-or-later
"""`.4dgs` of avala-ai (version 1): quantised Gaussians that travel straight, fade like a bell and live in a window of time.

Records (opcode, length, content) between two magics.  Read are the header, the grids, the table of windows, chunks and delta chunks of
attributes, bands of spherical harmonics, object tracks and the frame of reference; sound, cameras, sensors and the index are ignored.
Both temporal models are read: gaussian-birth, and keyframe-delta, whose states become Gaussians with windows (fourdgs_states.py).
A Gaussian is seen at win_lo <= T < win_hi while exp(-((T - mu) / sigma)^2 / 2) >= cutoff; T in seconds, colours as displayed.
"""
import math
import warnings
from pathlib import Path

import numpy as np

from ..model.appearance import RGB, SH, SH_C0
from ..model.gaussians import Clip, GaussianModel
from ..util.errors import FastGSError, LossWarning
from ..util.reading import damaged_if, read_bytes
from . import fourdgs_streams as wire
from . import fourdgs_tracks as tracks
from .base import Format
from .fourdgs_states import Births, Scene, States
from .fourdgs_writing import file
from .ftgs import straight_model
from .static import with_largest
from .straight import Timeline, logit, straight

HEADER, FOOTER, GRIDS, WINDOWS, CHUNK, BAND, DELTA_CHUNK, FRAME, TRACK = 1, 2, 3, 4, 5, 7, 16, 0x20, 0x25
MODELS: dict[str, type[Births] | type[States]] = {"gaussian-birth": Births, "keyframe-delta": States}
STEPS = ("pos", "scale_log", "rot", "rgb", "alpha", "motion", "time", "sigma_log")
FPS = 30.0
"""Frames per second of a scene that is a continuum."""
LARGEST = 64 << 30
UP = {1: "RUB", 2: "RFU", 4: "RDF"}
"""Our axes by the number of the axis that points up: +y, +z, -y.  Which way is ahead changes no picture."""


class FourDGS(Format):
    name = "4dgs"
    magic = wire.MAGIC
    says_axes = True
    extensions = reads = (".4dgs",)

    def load(self, path: Path) -> GaussianModel:
        data = read_bytes(path, LARGEST)
        scene, seen = None, set[int]()
        for opcode, place, content in wire.records(memoryview(data)):
            if (scene is None) != (opcode == HEADER) or (opcode in (GRIDS, WINDOWS) and opcode in seen):
                raise FastGSError("it does not begin with one header, or has its grids or windows twice; copy or export it again.")
            seen.add(opcode)
            if scene is None:
                scene = _header(content, 1000 + len(data))
                population = MODELS[scene.temporal_model](scene)
            elif opcode == GRIDS:
                _grids(scene, content)
            elif opcode == WINDOWS:
                windows = np.frombuffer(content.take(16 * content.number("I")), "<f8").reshape(-1, 2)
                scene.windows = windows if len(windows) else scene.windows
            elif opcode == CHUNK:
                begin, end, _, count = content.unpack("ddII")
                wire.check_room(count, scene.room)
                codec, size = content.text(), content.number("Q")
                streams = wire.streams(wire.unpacked(content.block(), codec, size), count, "a chunk")
                population.chunk(place, begin, end, streams, count)
            elif opcode == DELTA_CHUNK:
                population.delta(place, content)
            elif opcode == BAND:
                population.band(content.number("B"), content)
            elif opcode == TRACK:
                _track(scene, content)
            elif opcode == FRAME:
                _frame(scene, content, path)
        damaged_if(GRIDS not in seen, "its header or its grids are missing")
        assert scene is not None
        population.finish()
        return _model(scene)

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        if len(model) and not all(np.isfinite(array).all() for array in model.arrays.values()):
            raise FastGSError("some of the model's numbers are not finite; leave these Gaussians out.")
        model, lost = straight_model(model, degree=3)
        if model.appearance.degree:
            lost.append("its spherical harmonics above degree 0 are kept in steps of 1/32 up to 4")
        if round(model.clip.duration * FPS) != model.clip.frame_count:
            lost.append("its frame rate: the file knows seconds only")
        return model, [*lost, "colours outside of 0 to 1, and where the clip began"]

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        targets[-1].write_bytes(file(model))


def _header(content: wire.Cursor, room: int) -> Scene:
    content.text(), content.text()
    duration, _, cutoff = content.unpack("dQd")
    temporal_model = content.text()
    content.unpack("6d")
    degree, _ = content.unpack("BB")
    if temporal_model not in MODELS:
        raise FastGSError(f"its temporal model is {temporal_model[:40]!r}, and those known are {' and '.join(MODELS)}.")
    if not (0 <= duration <= 1e6 and 0 < cutoff < 1 and degree <= 3):
        raise FastGSError(f"its header says {duration:g} seconds, a cutoff of {cutoff:g} and degree {degree}; the file is damaged.")
    return Scene(duration, cutoff, temporal_model, degree, room)


def _grids(scene: Scene, content: wire.Cursor) -> None:
    scheme = content.text()
    if scheme != "uniform-v1":
        raise FastGSError(f"its numbers are quantised by {scheme[:40]!r}, and the scheme that is known is 'uniform-v1'.")
    scene.origin, steps = np.array(content.unpack("3d")), content.unpack("8d")
    damaged_if(not np.isfinite([*scene.origin, *steps]).all(), "a step of its grids is no finite number")
    scene.steps = dict(zip(STEPS, steps))


def _track(scene: Scene, content: wire.Cursor) -> None:
    if track := tracks.read(content):
        damaged_if(any(other.name == track.name for other in scene.tracks), f"its object {track.name} has two tracks")
        scene.tracks.append(track)


def _frame(scene: Scene, content: wire.Cursor, path: Path) -> None:
    """The scene's own frame of reference; others, which have names, are ignored."""
    if content.text():
        return
    hand, up, _ = content.unpack("3B")
    if hand == 2:
        warnings.warn(LossWarning(f"{path}: it is of a left-handed space, so it is seen mirrored."), stacklevel=4)
    scene.axes = UP.get(up, "RDF")


def _model(scene: Scene) -> GaussianModel:
    """The model of all Gaussians of a scene."""
    frames = max(1, round(scene.duration * FPS))
    duration = scene.duration or 1 / FPS
    clip, timeline = Clip(frames, frames / duration), Timeline(length=duration)
    wanted = set(range(1, scene.degree + 1))
    if any(set(bands) != wanted for bands, table in zip(scene.bands, scene.tables) if len(table[wire.FLAGS])):
        raise FastGSError("bands of spherical harmonics are missing; the file is damaged, so copy or export it again.")
    joined = {a: np.concatenate([t[a] for t in scene.tables] or [np.zeros((0, wire.CHANNELS[a]), np.int64)]) for a in wire.REQUIRED}
    n, step = len(joined[wire.FLAGS]), scene.steps
    always, index = joined[wire.FLAGS][:, 0] & 1 != 0, joined[wire.WINDOW][:, 0]
    damaged_if(n and (index.min() < 0 or index.max() >= len(scene.windows)), "a Gaussian has windows that the file has not")
    with np.errstate(all="ignore"):  # what is no number is found by usable()
        window = scene.windows[index]
        ln_sigma = joined[wire.SIGMA][:, 0] * step["sigma_log"]
        motion_step, mu_step = _own_steps(scene, ln_sigma, always, window[:, 1] - window[:, 0])
        mu = joined[wire.MU][:, 0] * mu_step
        velocity = joined[wire.MOTION] * motion_step[:, None]
        begin, end = window.T
        reach = np.where(always, np.inf, math.sqrt(-2 * math.log(scene.cutoff)) * np.exp(ln_sigma))
        begin, end = np.maximum(begin, mu - reach), np.minimum(end, mu + reach)
        begin, end = np.maximum(begin, scene.spans[0]), np.minimum(end, scene.spans[1])
        lives = straight(joined[wire.POSITION] * step["pos"] + scene.origin, velocity, mu, np.where(always, np.inf, ln_sigma), timeline,
                         (begin, end))
        green, red, blue = joined[wire.COLOUR].T
        rgb = np.clip(np.stack([red + green, green, blue + green], 1) * step["rgb"], 0, 1)
        features, appearance = (_harmonics(scene, rgb, n), SH(scene.degree)) if scene.degree else (rgb, RGB())
        omitted = joined[wire.OMITTED][:, 0]
        damaged_if(n and (omitted.min() < 0 or omitted.max() > 3), "a rotation in it leaves out a component that does not exist")
        rotation = with_largest(omitted, np.clip(joined[wire.ROTATION] * step["rot"], -1, 1))[:, [3, 0, 1, 2]]
        moved = tracks.follow(lives, rotation, _objects(scene), scene.tracks, timeline)
        opacity = logit(joined[wire.OPACITY][:, 0] * step["alpha"])
        return GaussianModel(**moved, scale=joined[wire.SCALE] * step["scale_log"], opacity=opacity, features=features,
                             appearance=appearance, clip=clip, axes=scene.axes)


def _objects(scene: Scene) -> np.ndarray:
    """The object [N] that each Gaussian belongs to; 0: none."""
    names = [wire.identities(t[wire.OBJECT]) if wire.OBJECT in t else np.zeros(len(t[wire.FLAGS]), np.int64) for t in scene.tables]
    return np.concatenate(names or [np.zeros(0, np.int64)])


def _own_steps(scene: Scene, ln_sigma: np.ndarray, always: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The grids [N] of velocity and of mu, which follow from each Gaussian's own lifetime (specification, 6.3)."""
    sigma = np.exp(ln_sigma)
    half = np.clip(np.where(always, lengths, math.sqrt(-2 * math.log(scene.cutoff)) * sigma), 0.02, 2.0)
    motion = np.clip(np.ceil(np.log2(half / 0.5)), -4, 2)
    time = scene.steps["time"]
    fine = np.clip(np.floor(np.log2(np.where(always, time, np.minimum(time, 0.05 * sigma)) / time)), -10, 0)
    return scene.steps["motion"] * 2.0**-motion, time * 2.0**fine


def _harmonics(scene: Scene, rgb: np.ndarray, n: int) -> np.ndarray:
    """Features [N, 3 B] of colours and bands; a band has all of red, then green, then blue."""
    parts = [((rgb - 0.5) / SH_C0)[:, None]]
    for band in range(1, scene.degree + 1):
        values = np.concatenate([b[band] for b, t in zip(scene.bands, scene.tables) if len(t[wire.FLAGS])] or [np.zeros((0, 6 * band + 3))])
        parts.append((-4 + values * (8 / 255)).reshape(n, 3, 2 * band + 1).transpose(0, 2, 1))
    return np.concatenate(parts, 1).reshape(n, 3 * (scene.degree + 1) ** 2)
