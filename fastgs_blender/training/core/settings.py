# SPDX-License-Identifier: GPL-3.0-or-later
"""All options of a training run in one frozen dataclass, each with its default, meaning and limits; their conversion to and from JSON."""
from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import MISSING, Field, asdict, dataclass, field, fields, replace
from typing import Any

from ...model.appearance import DECODES
from ...model.motion import trained_motions
from ...util.arguments import like, one_of, shown
from ...util.errors import FastGSError
from .presets import PRESETS


def _number(default: Any, low: float, high: float) -> Any:
    """A number that lies between two; rates and thresholds beyond reason, which only waste the user's own time, are not checked."""
    return field(default=default, metadata={"limits": (low, high)})


def _choice(default: str, *others: str, more: Callable[[], Iterable[str]] = tuple) -> Any:
    """One of several words; more() gives those that are only known when it is asked."""
    return field(default=default, metadata={"words": lambda: (default, *others, *more())})


@dataclass(frozen=True)
class Settings:
    """The options of a run.  Lengths are in units of the capture's extent, times in units of the clip."""

    # The run
    iterations: int = _number(7000, 1, 10**8)  # steps of the optimiser
    batch: int = _number(1, 1, 1024)  # views per step and process, of one moment where there are as many
    seed: int = _number(0, 0, 2**63 - 1)  # of all random numbers; the result depends on nothing else
    preset: str = "standard"  # the name of the table in presets.py that the other values began from

    # The model
    motion: str = _choice("cosine", "static", more=trained_motions)  # basis of the positions; paper: the printed form, period 1 (eq. 3-4)
    # Fourier frequencies, cosines, degree or keyframes.  0: the usual one, lower for short clips, or, where training begins with a model,
    # the one that follows it; a run's plan says which, and rotation_degree with it
    order: int = _number(0, 0, 64)
    rotation_degree: int = _number(1, 0, 3)  # degree of the quaternion's polynomial (eq. 7: 1)
    temporal: str = _choice("radial", "always")  # opacity over time: radial (eq. 6), or always the same
    appearance: str = _choice("features", "rgb", "sh1", "sh2", "sh3")  # features with decoder (STG, FAST-GS), plain colours, or harmonics
    activation: str = _choice("clamp", "sigmoid", "none")  # of the decoder's output
    decode: str = _choice(*DECODES)  # the decoder is given the features divided by alpha (normalised), or their sum, as STG (premultiplied)
    decoder_place: bool = False  # whether the decoder gets the camera's position, as STG's does; with few cameras it overfits to them
    antialiased: bool = False  # opacity compensated for the blur of a pixel

    # The loss
    loss: str = _choice("mixed", "sum")  # (1 - dssim) L1 + dssim (1 - SSIM), as 3DGS; or L1 + (1 - SSIM), as printed (eq. 9)
    dssim: float = _number(0.2, 0, 1)  # share of D-SSIM beside L1, where they are mixed
    motion_weight: float = _number(0.01, 0, 1e6)  # lambda of the motion regulariser
    # reading of its norm: mean over the Gaussians; or one norm over all of them, divided by the root of their number (group) or, as
    # printed in eq. 8, not divided, and in the capture's own unit of length (printed)
    regulariser: str = _choice("mean", "group", "printed")
    opaque_weight: float = _number(0.01, 0, 1e3)  # of the mean transparency as a penalty, where the capture shows something in every pixel
    # cut: what lies outside is transparent; weight: what lies inside counts twice; only: nothing else counts; off; auto: cut for pictures
    # with alpha, weight for mask files that show the foreground, only for those that say which pixels are valid
    masks: str = _choice("auto", "cut", "weight", "only", "off")
    moving_weight: float = _number(2.0, 0, 1e3)  # where there are no masks and cameras stand still: what moves counts so many times
    # colour behind transparent parts while training; auto: random where pictures are cut, else black
    background: str = _choice("auto", "black", "white", "random")

    # Cameras that differ (camera_response.py, camera_turns.py, initial/refine.py)
    exposures: str = _choice("auto", "on", "off")  # gain and offset of each camera and channel; auto: where two cameras show it
    clocks: str = _choice("auto", "on", "off")  # a shift in time for each camera, of a frame or less; auto: where it is found to differ
    # poses and focal lengths of cameras that stand still are refined before training; auto: where features that pictures have in common
    # then fit clearly better, and not in captures that bring a model; on: where they fit better at all.  While training cameras are
    # turned until their pictures agree with the model's; auto: those that were refined, as far as features are unsure of them
    poses: str = _choice("auto", "on", "off")

    # Learning rates (position and motion in extents)
    rate_unit: str = _choice("depth", "extent")  # of position_rate: how far away what is filmed is; or as published trainers
    # position_rate to position_rate_end: exponential decay.  Depth is the extent for a rig around its subject: a step is about a share of
    # the focal length in pixels, 0.8 of a pixel where that is 500
    position_rate: float = _number(1.6e-3, 0, 1)
    position_rate_end: float = _number(1.6e-6, 0, 1)
    # below such slopes of the loss, places and motion take shorter steps (schedule.slope_floors); less in short runs (costs.calm)
    slope_floor: float = _number(3e-4, 0, 1)
    motion_rate: float = _number(1e-3, 0, 1)  # of frequency 1; divided by k for frequency k
    motion_decay: float = _number(0.1, 0, 1)  # end of the motion's rate, as a fraction of its beginning
    warm_start_rate: float = _number(0.1, 0, 1)  # factor on both where training begins with a model; its root for shapes
    rotation_rate: float = 1e-3
    turn_rate: float = 1e-3
    scale_rate: float = 3e-2
    opacity_rate: float = 0.05
    base_rate: float = 5e-3
    direction_rate: float = 2.5e-3
    time_rate: float = 2.5e-3
    centre_rate: float = 1e-3
    duration_rate: float = 0.03
    decoder_rate: float = 1e-3
    # end of these last ones, as a fraction of their beginning: long steps first, so that Gaussians soon have their shapes, short ones at
    # the end, so that they come to rest
    rate_decay: float = _number(0.3, 0, 1)
    # share of the run, its last part, in which all rates also fall to nothing in a straight line: what moves is seen in few pictures, and
    # goes to and fro with the latest ones until steps are short
    cool_down: float = _number(0.1, 0, 1)

    # Starting values
    backdrop: float = _number(0.3, 0, 10)  # points far behind the scene, where pictures show none, as a share of these
    # where the Gaussians come from: points triangulated from the pictures, the layout's point file, random points, or a model; auto:
    # init_model, else the capture's own model, else the first of the others that gives points
    init: str = _choice("auto", "triangulate", "file", "model", "random")
    init_model: str = ""  # a model, as a bake makes one, whose Gaussians are taken with their motion
    init_points: int = _number(20_000, 1, 10**8)  # most starting points
    init_opacity: float = _number(0.5, 1e-4, 0.999)  # of the starting Gaussians
    init_scale: float = _number(0.7, 1e-3, 1e3)  # their size in distances to their three nearest neighbours
    init_duration: float = _number(0.06, 1e-4, 1e4)  # time over which a timed point's opacity falls to 1/e on either side
    init_duration_static: float = _number(4.0, 1e-4, 1e4)  # the same for points without a time
    init_motion: bool = True  # whether timed points begin with the velocities that the moments beside theirs show; else all are at rest

    # Density control
    density: str = _choice("default", "mcmc")  # clone, split, prune, opacity reset; or relocation and noise
    max_gaussians: int = _number(50_000, 1, 10**8)  # never more than this
    densify_from: float = 0.05  # first and last step as fractions of the run, and steps between
    densify_until: float = 0.6
    densify_every: int = _number(100, 1, 10**8)
    # the sum of the absolute gradients on the screen per pixel, which do not cancel where a Gaussian covers detail, times the root
    # of the pixel's error; or their sum, as 3DGS
    densify_gradient: str = _choice("absolute", "plain")
    densify_threshold: float = 2e-4  # of that gradient: above it Gaussians are cloned or split; in units of half the image's size
    densify_size: float = 0.01  # scale in extents: larger Gaussians are split, smaller ones cloned
    densify_share: float = _number(0.15, 0, 100)  # largest share of Gaussians that is added at once
    densify_rounds: int = _number(0, 0, 10**8)  # how often Gaussians are added at most, 0: until densify_until; pruning goes on until then
    prune_opacity: float = 0.005  # Gaussians below this opacity are removed
    prune_size: float = 0.3  # and those larger than this times their distance to the nearest camera; those of the backdrop are made smaller
    reset_every: int = _number(0, 0, 10**8)  # steps between opacity resets, 0: none
    densify_time: str = _choice("keep", "random")  # temporal centre of copies: the original's, or random

    warm_up: tuple[float, ...] = (0.02, 0.08)  # fractions of the run that see pictures at a quarter and at half the size end here

    # A scan of the place (captures/scan.py)
    scan_share: float = _number(0.3, 0, 0.9)  # of the steps that see its pictures, 0: they give starting points alone

    # Long captures (segments.py)
    segment_frames: int = _number(160, 0, 10**8)  # clips with more frames are cut into segments of at most this many, 0: never
    segment_overlap: int = _number(8, 0, 10**6)  # frames that neighbours share; 0: none, and they change over between two frames
    # share of the steps that a segment takes which begins from the one before, holding what stands still; 0: each is trained for itself
    segment_steps: float = _number(0.5, 0, 1)

    # Bookkeeping (without influence on the result)
    checkpoint_seconds: float = _number(15.0, 0, 10**7)
    preview_every: int = _number(500, 0, 10**8)  # 0: none

    def __post_init__(self) -> None:
        for option in fields(self):
            value = _checked(option, getattr(self, option.name))
            object.__setattr__(self, option.name, value)
            words = option.metadata["words"]() if "words" in option.metadata else (value,)
            if value not in words:
                raise FastGSError(f"the training option {option.name} is one of {', '.join(dict.fromkeys(words))}, not {value!r}.")
            low, high = option.metadata.get("limits", (value, value))
            if not low <= value <= high:
                raise FastGSError(f"the training option {option.name} must lie between {low:g} and {high:g}, not at {value:g}.")
        one_of(self.preset, "the preset", PRESETS)
        if not all(0 <= a <= 1 for a in self.warm_up) or list(self.warm_up) != sorted(self.warm_up) or len(self.warm_up) > 4:
            raise FastGSError(f"the training option warm_up has at most four rising numbers from 0 to 1, not {self.warm_up}.")

    def of_segment(self, number: int) -> Settings:
        """The settings of a segment, counted from 0: those after the first take fewer steps, all of them at full size."""
        if not (number and self.segment_steps):
            return self
        return replace(self, iterations=max(round(self.segment_steps * self.iterations), 1), warm_up=())

    @property
    def dissimilarity(self) -> float:
        """The share d of 1 - SSIM in a loss (1 - d) L1 + d (1 - SSIM) that is the chosen one divided by loss_scale."""
        return 0.5 if self.loss == "sum" else self.dssim

    @property
    def loss_scale(self) -> float:
        """See dissimilarity."""
        return 2.0 if self.loss == "sum" else 1.0

    def to_dict(self) -> dict:
        """Plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


def settings(preset: str = "standard", **options: Any) -> Settings:
    """The settings of a preset with some options replaced; raises FastGSError for unknown ones."""
    return from_dict({**PRESETS[one_of(preset, "the preset", PRESETS)], "preset": preset, **options})


def from_dict(values: Any) -> Settings:
    """The inverse of Settings.to_dict; absent options keep their defaults, unknown ones raise FastGSError."""
    if not isinstance(values, dict):
        raise FastGSError(f"training options are a table of names and values, not {shown(values)}.")
    known = {option.name for option in fields(Settings)}
    unknown = [name for name in values if name not in known]
    if unknown:
        raise FastGSError(f"there is no training option {unknown[0]!r}; there are {', '.join(sorted(known))}.")
    return Settings(**values)


def option_from_text(text: str) -> tuple[str, object]:
    """(name, value) of "name=value" as written on a command line; raises FastGSError."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise FastGSError(f"an option is written name=value, not {text!r}.")
    default: Any = next((option.default for option in fields(Settings) if option.name == name), MISSING)
    if default is MISSING:
        from_dict({name: value})
    kind = type(default)
    try:
        if kind is bool:
            return name, {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}[value.lower()]
        if kind is tuple:
            return name, tuple(float(part) for part in value.split(",") if part.strip())
        return name, int(float(value)) if kind is int and float(value) == int(float(value)) else kind(value)
    except (KeyError, ValueError, OverflowError) as error:
        raise FastGSError(f"the training option {name} cannot be {value!r}; its default is {default!r}.") from error


def _checked(option: Field, value: Any) -> Any:
    """The value in the type of the field's default; raises FastGSError where it is of another."""
    if (found := like(value, option.default, 1 << 63)) is None:
        raise FastGSError(f"the training option {option.name} cannot be {value!r}; its default is {option.default!r}.")
    return found
