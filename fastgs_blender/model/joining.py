# SPDX-License-Identifier: GPL-3.0-or-later
"""Several models as one: concatenate() puts their Gaussians side by side, join() makes one clip of the segments of a long capture.

Every segment was trained in its own time u in [0, 1], and lies at t = begin + length * u of the whole.  Nothing is fitted: each
basis of time (motion.py) writes the same motion in t, where it can.  What the segments share, the decoder above all, must be the
same in all of them.
"""
import mmap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..util.arguments import shown
from ..util.errors import FastGSError
from .appearance import RGB, SH, SH_C0, Appearance, Changing, Features
from .gaussians import Clip, GaussianModel
from .motion import Basis, Static
from .parts import parts_together
from .surroundings import together
from .temporal import Always, Radial, Window, WindowedRadial

FLAT = -40.0
"""ln s_tau of a Gaussian that does not fade."""
FOREVER = 1e6
ALWAYS: dict[type, tuple[float, ...]] = {
    Radial: (FLAT,), Window: (-FOREVER, FOREVER, 0.0, 0.0), WindowedRadial: (FLAT, -FOREVER, FOREVER, 0.0)}
"""The parameters with which Gaussians of a kind are always there."""
PAGES = range(1 << 17, 1 << 22)
"""Bytes of an array that gets pages of its own: smaller ones would waste them, and NumPy asks for large pages for larger ones."""


def concatenate(models: Sequence[GaussianModel]) -> GaussianModel:
    """One model with the Gaussians of several, in their order; its clip and provenance are the first one's.

    A model has one basis of motion and of rotation, one temporal opacity and one appearance.  So these must be the same in all models, but
    for what stands still, what is always there, RGB, and SH of a lower degree, which fit beside any other (SH).  Axes, colour space and the
    rasteriser's constants must be the same, too.  Raises FastGSError for other models; render() shows any models in one picture.

    Example:
        both = fg.concatenate([model, fg.freeze(model, 0.5)])
    """
    wrong = models if not isinstance(models, Sequence) else next((m for m in models if not isinstance(m, GaussianModel)), None)
    if wrong is not None:
        raise FastGSError(f"models that are put together stand in a list, as fg.load(path) reads them; this is {shown(wrong)}.")
    if not models:
        raise FastGSError("there are no models to put together; give one at least.")
    first = models[0]
    appearances = [m.appearance for m in models]
    if any(isinstance(each, SH) for each in appearances) and all(isinstance(each, (RGB, SH)) for each in appearances):
        degree = max(each.degree for each in appearances if isinstance(each, SH))
        models = [_with_harmonics(m, degree) for m in models]
    kinds: dict[str, Any] = {"appearance": models[0].appearance}
    for name, poor in (("basis", Static), ("rotation_basis", Static), ("temporal_kind", Always)):
        kinds[name] = next((kind for m in models if not isinstance(kind := getattr(m, name), poor)), getattr(first, name))
    for m in models:
        differing = [name for name in ("axes", "colour_space", "raster") if getattr(m, name) != getattr(first, name)]
        differing += [name for name in ("basis", "rotation_basis", "temporal_kind")
                      if not isinstance(getattr(m, name), (Static, Always)) and getattr(m, name) != kinds[name]]
        differing += [] if same_appearance(m.appearance, models[0].appearance) else ["appearance"]
        if differing:
            raise FastGSError(f"the models cannot become one: their {differing[0].replace('_', ' ')} differs; render() shows them all.")
    widths = {"motion": kinds["basis"].terms, "rotation_motion": kinds["rotation_basis"].terms, "temporal": kinds["temporal_kind"].width}
    filling = {"temporal": ALWAYS.get(type(kinds["temporal_kind"]), ())}
    arrays: dict[str, list[np.ndarray]] = {name: [] for name in first.arrays}
    for m in models:
        for name, array in m.arrays.items():
            if name in widths and array.shape[1] != widths[name]:
                array = np.broadcast_to(np.array(filling.get(name, 0), np.float32), (len(m), widths[name], *array.shape[2:]))
            arrays[name].append(array)
    around = first.surroundings
    if len(models) > 1:  # the sphere of one model's backdrop says nothing of another's Gaussians
        around = replace(together([m.surroundings for m in models]), backdrop=None)
    kinds |= {name: _end_to_end(parts) for name, parts in arrays.items()}
    return replace(first, **kinds, surroundings=around, parts=parts_together([(m.parts, len(m)) for m in models]))


def _end_to_end(parts: list[np.ndarray]) -> np.ndarray:
    """np.concatenate(), in pages that go back to the system: between arrays that come and go as a long clip plays, glibc's heap grows."""
    shape, dtype = (sum(map(len, parts)), *parts[0].shape[1:]), np.result_type(*parts)
    size = sum(part.size for part in parts) * dtype.itemsize
    if size not in PAGES or not hasattr(mmap, "MAP_PRIVATE"):
        return np.concatenate(parts)
    return np.concatenate(parts, out=np.frombuffer(mmap.mmap(-1, size, mmap.MAP_PRIVATE), dtype).reshape(shape))


def _with_harmonics(model: GaussianModel, degree: int) -> GaussianModel:
    features = (model.features.astype(np.float64) - 0.5) / SH_C0 if isinstance(model.appearance, RGB) else model.features
    appearance = SH(degree)
    return replace(model, features=np.pad(features, ((0, 0), (0, appearance.width - features.shape[1]))), appearance=appearance)


@dataclass(frozen=True, eq=False)
class Segment:
    """A model of a part of the capture.

    model   in its own time
    begin   where its time 0 lies in the whole, in t
    length  how much of the whole its time 0..1 takes; bases with frequencies need the same length in all segments
    shown   (first, last) t at which it is fully there; None: no end on that side
    fade    width of the flanks outside `shown`, in t
    """

    model: GaussianModel
    begin: float
    length: float
    shown: tuple[float | None, float | None] = (None, None)
    fade: float = 0.01


def join(segments: list[Segment], clip: Clip) -> GaussianModel:
    """One model that shows at any time what its segments show; raises FastGSError where they do not fit together.

    Let `shown` overlap and each segment's flank lie where its neighbour is fully there: then nothing shines through.
    """
    first = segments[0].model
    for s in segments:
        _same(first, s.model)
    moving = _common([s.model.basis for s in segments], segments)
    turning = _common([s.model.rotation_basis for s in segments], segments)
    parts = [_in_whole_time(s, i, segments, moving, turning) for i, s in enumerate(segments)]
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return replace(first, **arrays, basis=moving, rotation_basis=turning, temporal_kind=WindowedRadial(), clip=clip,
                   surroundings=together([s.model.surroundings for s in segments]),
                   parts=parts_together([(s.model.parts, len(s.model)) for s in segments]))


def _same(first: GaussianModel, other: GaussianModel) -> None:
    constants = [(type(m.appearance), m.raster, m.axes, m.colour_space) for m in (first, other)]
    if constants[0] != constants[1]:
        raise FastGSError("the segments cannot be joined: their appearance, rasteriser constants, axes or colour space differ.")
    if isinstance(first.appearance, Changing):
        raise FastGSError("the segments cannot be joined: their colours change in time.")
    if not same_appearance(first.appearance, other.appearance):
        raise FastGSError("the segments cannot be joined: they need one appearance in common, with the same decoder.")
    if not isinstance(other.temporal_kind, (Always, Radial)):
        raise FastGSError(f"the segments cannot be joined: their temporal opacity is {other.temporal_kind.name}, not radial.")


def same_appearance(appearance: Appearance, other: Appearance) -> bool:
    """Whether two appearances are the same, weights included."""
    if not (isinstance(appearance, Features) and isinstance(other, Features)):
        return appearance == other
    return np.array_equal(appearance.w1, other.w1) and np.array_equal(appearance.w2, other.w2) and (
        appearance.activation, appearance.decode) == (other.activation, other.decode)


def _common(bases: list[Basis], segments: list[Segment]) -> Basis:
    """The basis in the whole's time that holds the motion of all segments."""
    first = bases[0]
    if any(basis != first for basis in bases):
        raise FastGSError("the segments cannot be joined: they move in different bases of time.")
    return first.joined([(s.begin, s.length) for s in segments])


def _in_whole_time(segment: Segment, number: int, segments: list[Segment], moving: Basis, turning: Basis) -> dict[str, np.ndarray]:
    """The arrays of a segment's model in the whole's time."""
    model, length = segment.model, segment.length
    n = len(model)
    arrays = {name: array.astype(np.float64) for name, array in model.arrays.items()}
    if isinstance(model.appearance, Features):
        arrays["features"][:, 6:9] /= length
    for constant, motion, basis, joined in (("position", "motion", model.basis, moving),
                                            ("rotation", "rotation_motion", model.rotation_basis, turning)):
        arrays[constant], arrays[motion] = basis.retimed(joined, segment.begin, length, arrays[constant], arrays[motion])
    arrays["mu_tau"] = segment.begin + length * arrays["mu_tau"]
    bell = arrays["temporal"][:, 0] - 2 * np.log(length) if isinstance(model.temporal_kind, Radial) else np.full(n, FLAT)
    begin, end = (sign * FOREVER if edge is None else edge for edge, sign in zip(segment.shown, (-1, 1)))
    arrays["temporal"] = np.stack([bell, *(np.full(n, v) for v in (begin, end, np.log(segment.fade)))], -1)
    return arrays
