# SPDX-License-Identifier: GPL-3.0-or-later
"""All options of a training run in one frozen dataclass, their presets and checks, and their conversion to and from JSON."""
import math
from dataclasses import MISSING, asdict, dataclass, fields

from ...model.appearance import DECODES
from ...model.motion import trained_motions
from ...util.arguments import one_of, shown
from ...util.errors import FastGSError
from .presets import PRESETS

CHOICES = {
    "appearance": ("features", "rgb", "sh1", "sh2", "sh3"),
    "activation": ("clamp", "sigmoid", "none"),
    "decode": DECODES,
    "temporal": ("radial", "always"),
    "density": ("default", "mcmc"),
    "regulariser": ("mean", "group", "printed"),
    "loss": ("mixed", "sum"),
    "rate_unit": ("depth", "extent"),
    "masks": ("auto", "cut", "weight", "only", "off"),
    "background": ("auto", "black", "white", "random"),
    "densify_time": ("keep", "random"),
    "init": ("auto", "triangulate", "file", "model", "random"),
    "densify_gradient": ("plain", "absolute"),
    "exposures": ("auto", "on", "off"),
    "clocks": ("auto", "on", "off"),
    "poses": ("auto", "on", "off"),
}


@dataclass(frozen=True)
class Settings:
    """The options of a run.  Lengths are in units of the capture's extent, times in units of the clip.

    The run
      iterations      steps of the optimiser
      batch           views per step and process, of one moment where there are as many
      seed            of all random numbers; the result depends on nothing else
      preset          the name of the table in presets.py that the other values began from

    The model
      motion          basis of the positions; paper: the printed form, period 1 (eq. 3-4)
      order           Fourier frequencies, cosines, degree or keyframes; 0: the usual one, lower for short clips, or, where training
                      begins with a model, the one that follows it; a run's plan says which, and rotation_degree with it
      rotation_degree degree of the quaternion's polynomial (eq. 7: 1)
      temporal        opacity over time: radial (eq. 6), or always the same
      appearance      features with decoder (STG, FAST-GS), or plain colours, or spherical harmonics by degree
      activation      of the decoder's output
      decode          what the decoder is given: the features divided by alpha (normalised), or their sum, as STG (premultiplied)
      decoder_place   whether the decoder gets the camera's position, as STG's does; with few cameras it overfits to them
      antialiased     opacity compensated for the blur of a pixel

    The loss
      loss            mixed: (1 - dssim) L1 + dssim (1 - SSIM), as 3DGS; sum: L1 + (1 - SSIM), as printed (eq. 9)
      dssim           share of D-SSIM beside L1, where they are mixed
      motion_weight   lambda of the motion regulariser
      regulariser     reading of its norm: mean over the Gaussians; or one norm over all of them, divided by the root of their number
                      (group) or, as printed in eq. 8, not divided, and in the capture's own unit of length (printed)
      opaque_weight   weight of the mean transparency as a penalty, where the capture shows something in every pixel
      masks           cut: what lies outside is transparent; weight: what lies inside counts twice;
                      only: nothing else counts; off; auto: cut for pictures with alpha, weight for mask files that show
                      the foreground, only for those that say which pixels are valid
      moving_weight   where there are no masks and cameras stand still: what moves counts so many times
      background      colour behind transparent parts while training; auto: random where pictures are cut, else black

    Cameras that differ (camera_response.py, camera_turns.py, initial/refine.py)
      exposures       a gain and an offset for each camera and channel, taken out of its pictures; auto: where they are seen to differ
      clocks          a shift in time for each camera, of a frame or less; auto: where it is found to differ
      poses           poses and focal lengths of cameras that stand still are refined before training; auto: where features that pictures
                      have in common then fit clearly better, and not in captures that bring a model; on: where they fit better at all.
                      While training each camera is turned until its pictures agree with the model's; auto: where one is off by
                      0.4 of a pixel

    Learning rates (position and motion in extents)
      position_rate, position_rate_end   exponential decay from one to the other; the first in units of how far away is what the
                                         cameras film, which is the extent for a rig around its subject: a step is about a
                                         share of the focal length in pixels, 0.8 of a pixel where that is 500
      rate_unit       unit of position_rate: depth, as just said, or extent, as published trainers have it
      motion_rate     of frequency 1; divided by k for frequency k
      warm_start_rate      factor on both of these where training begins with a model (init_model, a bake); its root on those of shapes
      motion_decay    end of the motion's rate, as a fraction of its beginning
      rotation_rate, turn_rate, scale_rate, opacity_rate, base_rate, direction_rate, time_rate, centre_rate, duration_rate, decoder_rate
      rate_decay      end of these last ones, as a fraction of their beginning: long steps first, so that Gaussians soon have their
                      shapes, short ones at the end, so that they come to rest
      cool_down       share of the run, its last part, in which all rates also fall to nothing in a straight line: what moves is seen in
                      few pictures, and goes to and fro with the latest ones until steps are short

    Starting values
      init            where the Gaussians come from: points triangulated from the pictures, the layout's point file, random points,
                      or a model; auto: init_model, else the capture's own model, else the first of the others that gives points
      init_model      a model, as a bake makes one, whose Gaussians are taken with their motion
      init_points     most starting points
      backdrop        points far behind the scene, where pictures show none of these, as a share of them (backdrop.py)
      init_opacity    opacity of the starting Gaussians
      init_scale      their size in distances to their three nearest neighbours
      init_duration   time over which a timed point's opacity falls to 1/e on either side
      init_duration_static  the same for points without a time
      init_motion     whether timed points begin with the velocities that the moments beside theirs show; else all are at rest

    Density control
      density         default (clone, split, prune, opacity reset) or mcmc (relocation and noise)
      max_gaussians   never more than this
      densify_from, densify_until, densify_every   first and last step as fractions of the run, and steps between
      densify_gradient   absolute: the sum of the absolute gradients on the screen per pixel, which do not cancel where a Gaussian covers
                      detail; or plain, their sum, as 3DGS
      densify_threshold  of that gradient: above it Gaussians are cloned or split; in units of half the image's size
      densify_size    scale in extents: larger Gaussians are split, smaller ones cloned
      densify_share   largest share of Gaussians that is added at once
      densify_rounds  how often Gaussians are added at most, 0: until densify_until; transparent ones are removed until then anyway
      densify_time    temporal centre of copies: the original's, or random
      prune_opacity   Gaussians below this opacity are removed
      prune_size      Gaussians larger than this times their distance to the nearest camera are removed too, those of the backdrop
                      made smaller
      reset_every     steps between opacity resets, 0: none

    Resolution
      warm_up         fractions of the run that see pictures at a quarter and at half the size end here
    Long captures (segments.py)
      segment_frames  clips with more frames are cut into segments of at most this many, 0: never
      segment_overlap frames that neighbouring segments share; 0: none, and they change over between two frames

    Bookkeeping (without influence on the result)
      checkpoint_seconds, preview_every (0: none)
    """

    iterations: int = 7000
    batch: int = 1
    seed: int = 0
    preset: str = "standard"

    motion: str = "cosine"
    order: int = 0
    rotation_degree: int = 1
    temporal: str = "radial"
    appearance: str = "features"
    activation: str = "clamp"
    decode: str = "normalised"
    decoder_place: bool = False
    antialiased: bool = False

    loss: str = "mixed"
    dssim: float = 0.2
    motion_weight: float = 0.01
    regulariser: str = "mean"
    opaque_weight: float = 0.01
    masks: str = "auto"
    moving_weight: float = 2.0
    background: str = "auto"

    exposures: str = "auto"
    clocks: str = "auto"
    poses: str = "auto"

    rate_unit: str = "depth"
    position_rate: float = 1.6e-3
    position_rate_end: float = 1.6e-6
    motion_rate: float = 1e-3
    motion_decay: float = 0.1
    warm_start_rate: float = 0.1
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
    rate_decay: float = 0.3
    cool_down: float = 0.1

    backdrop: float = 0.3
    init: str = "auto"
    init_model: str = ""
    init_points: int = 20_000
    init_opacity: float = 0.5
    init_scale: float = 0.7
    init_duration: float = 0.06
    init_duration_static: float = 4.0
    init_motion: bool = True

    density: str = "default"
    max_gaussians: int = 50_000
    densify_from: float = 0.05
    densify_until: float = 0.6
    densify_every: int = 100
    densify_gradient: str = "absolute"
    densify_threshold: float = 2e-4
    densify_size: float = 0.01
    densify_share: float = 0.15
    densify_rounds: int = 0
    prune_opacity: float = 0.005
    prune_size: float = 0.3
    reset_every: int = 0
    densify_time: str = "keep"

    warm_up: tuple[float, ...] = (0.02, 0.08)

    segment_frames: int = 120
    segment_overlap: int = 8

    checkpoint_seconds: float = 15.0
    preview_every: int = 500

    def __post_init__(self):
        for field in fields(self):
            value = getattr(self, field.name)
            object.__setattr__(self, field.name, _checked(field, value))
        for name, known in {"motion": (*trained_motions(), "static"), **CHOICES}.items():
            if getattr(self, name) not in known:
                raise FastGSError(f"the training option {name} is one of {', '.join(known)}, not {getattr(self, name)!r}.")
        one_of(self.preset, "the preset", PRESETS)
        for name, low, high in LIMITS:
            if not low <= getattr(self, name) <= high:
                raise FastGSError(f"the training option {name} must lie between {low:g} and {high:g}, not at {getattr(self, name):g}.")
        if not all(0 <= a <= 1 for a in self.warm_up) or list(self.warm_up) != sorted(self.warm_up) or len(self.warm_up) > 4:
            raise FastGSError(f"the training option warm_up has at most four rising numbers from 0 to 1, not {self.warm_up}.")

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


LIMITS = (
    ("iterations", 1, 10**8), ("batch", 1, 1024), ("seed", 0, 2**63 - 1), ("order", 0, 64), ("rotation_degree", 0, 3), ("dssim", 0, 1),
    ("motion_weight", 0, 1e6), ("opaque_weight", 0, 1e3), ("moving_weight", 0, 1e3),
    ("init_points", 1, 10**8), ("backdrop", 0, 10), ("max_gaussians", 1, 10**8),
    ("init_opacity", 1e-4, 0.999), ("init_scale", 1e-3, 1e3), ("init_duration", 1e-4, 1e4), ("init_duration_static", 1e-4, 1e4),
    ("densify_every", 1, 10**8), ("densify_share", 0, 100), ("densify_rounds", 0, 10**8), ("reset_every", 0, 10**8),
    ("preview_every", 0, 10**8),
    ("segment_frames", 0, 10**8), ("segment_overlap", 0, 10**6),
    ("checkpoint_seconds", 0, 10**7), ("motion_decay", 0, 1),
    ("warm_start_rate", 0, 1), ("rate_decay", 0, 1), ("cool_down", 0, 1), ("position_rate", 0, 1),
    ("position_rate_end", 0, 1), ("motion_rate", 0, 1),
)
"""Least and greatest value of options; rates and thresholds beyond reason only waste the user's own time."""


def settings(preset: str = "standard", **options) -> Settings:
    """The settings of a preset with some options replaced; raises FastGSError for unknown ones."""
    return from_dict({**PRESETS[one_of(preset, "the preset", PRESETS)], "preset": preset, **options})


def from_dict(values: dict) -> Settings:
    """The inverse of Settings.to_dict; absent options keep their defaults, unknown ones raise FastGSError."""
    if not isinstance(values, dict):
        raise FastGSError(f"training options are a table of names and values, not {shown(values)}.")
    known = {field.name for field in fields(Settings)}
    unknown = [name for name in values if name not in known]
    if unknown:
        raise FastGSError(f"there is no training option {unknown[0]!r}; there are {', '.join(sorted(known))}.")
    return Settings(**values)


def option_from_text(text: str) -> tuple[str, object]:
    """(name, value) of "name=value" as written on a command line; raises FastGSError."""
    name, equals, value = (part.strip() for part in text.partition("="))
    field = next((field for field in fields(Settings) if field.name == name), None)
    if not equals:
        raise FastGSError(f"an option is written name=value, not {text!r}.")
    if field is None:
        from_dict({name: value})
    kind = type(field.default)
    try:
        if kind is bool:
            return name, {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}[value.lower()]
        if kind is tuple:
            return name, tuple(float(part) for part in value.split(",") if part.strip())
        return name, int(float(value)) if kind is int and float(value) == int(float(value)) else kind(value)
    except (KeyError, ValueError, OverflowError) as error:
        raise FastGSError(f"the training option {name} cannot be {value!r}; its default is {field.default!r}.") from error


def _checked(field, value):
    """The value in the type of the field's default; raises FastGSError where it is of another."""
    example = field.default
    assert example is not MISSING
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300  # JSON's integers have no limit
    if isinstance(example, bool):
        good = isinstance(value, bool)
    elif isinstance(example, int):
        good = number and math.isfinite(value) and value == int(value)
        value = int(value) if good else value
    elif isinstance(example, float):
        good = number and math.isfinite(value)
        value = float(value) if good else value
    elif isinstance(example, tuple):
        good = isinstance(value, (list, tuple)) and all(isinstance(v, (int, float)) and abs(v) < 1e300 for v in value)
        value = tuple(float(v) for v in value) if good else value
    else:
        good = isinstance(value, str)
    if not good:
        raise FastGSError(f"the training option {field.name} cannot be {value!r}; its default is {example!r}.")
    return value
