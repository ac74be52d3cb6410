# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture: a scene filmed by several cameras, as a list of shots.  Nothing is decoded before it is asked for.

World: as the layout gives it.  Cameras: OpenCV axes, world-to-camera, pixel centres at +0.5; pinholes, for lenses are undone.
"""
from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from pathlib import Path

import numpy as np

from ..cameras.camera import Camera
from ..cameras.flights import focus
from ..model.gaussians import Clip
from ..model.points import Points
from ..util.arguments import real, shown
from ..util.errors import FastGSError
from .sources import Source

MASKS = ("foreground", "valid")


@dataclass(frozen=True)
class Options:
    """The options of open_capture(); None: as the layout has it.

    scale     factor on the pictures' size, in (0, 1]
    frames    the part of the time line to use, as a slice of frame numbers from 0
    held_out  names of the views that are kept for evaluation
    offsets   by view, in frames: picture f of the view shows the moment f + offset (clocks/files.py)
    scan      the photographs of the place are wanted; a layout that has films besides leaves those out
    """

    scale: float | None = None
    frames: slice | None = None
    held_out: Sequence[str] | None = None
    offsets: Mapping[str, float] = field(default_factory=dict)
    scan: bool = False

    def __post_init__(self) -> None:
        if self.scale is not None:
            object.__setattr__(self, "scale", real(self.scale, "the scale of a capture's pictures"))
        part = self.frames
        if part is not None and not (isinstance(part, slice) and all(
                each is None or isinstance(each, Integral) for each in (part.start, part.stop, part.step))):
            raise FastGSError(f"the frames of a capture are chosen by a slice of whole numbers, such as slice(0, 100), not {shown(part)}.")
        if self.held_out is not None:
            object.__setattr__(self, "held_out", tuple(self.held_out))
        if not isinstance(self.offsets, Mapping):
            raise FastGSError(f"the offsets of clocks are given by view, as {{\"cam00\": 0.5}}, not as {shown(self.offsets)}.")
        for view, offset in self.offsets.items():
            real(offset, f"the offset of the clock of {view}")


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture: one camera at one time.

    view      the rig camera's name; a moving camera has one name and many poses
    frame     0 .. frame_count - 1; where clocks differ, the one whose moment is nearest
    camera    pinhole of the picture as FrameStore gives it, undistorted and scaled; None in a capture without poses
    image     source of its pixels
    mask      a file that goes with the picture, white where the picture counts (see Capture.mask_means); None: there is none
    held_out  kept for evaluation, never trained on
    t         model time in [0, 1]
    place     of a scan (scan.py): it shows the place at no moment of the clip; frame and t are 0
    """

    view: str
    frame: int
    camera: Camera | None
    image: Source
    mask: Source | None = None
    held_out: bool = False
    t: float = 0.0
    place: bool = False


def by_view(shots: Iterable[Shot]) -> dict[str, list[Shot]]:
    """The shots of each view, in their order."""
    views: dict[str, list[Shot]] = {}
    for shot in shots:
        views.setdefault(shot.view, []).append(shot)
    return views


@dataclass(eq=False)
class Capture:
    """A multi-view capture.

    path        folder or file that it was opened from
    layout      name of its layout
    shots       ordered by frame, then by view as the layout lists them
    clip        the time line of its frames
    axes        of its world, as in GaussianModel
    scale       of its pictures against their files
    points      points that the layout brings along, or None
    mask_means  meaning of the mask files: "foreground" (white: the subject) or "valid" (black: to be ignored)
    notes       remarks on how it was read
    model       a file that shows the same scene at the same times, as a bake of it does, or None
    within      begin and length of the part of that model's time that the clip covers
    faults      problems found while the description was read, a clause each; pixels.checks.problems() lists all

    Example:
        views = fg.open_capture("my-capture").views
    """

    path: Path
    layout: str
    shots: list[Shot]
    clip: Clip
    axes: str = "RDF"
    scale: float = 1.0
    points: Points | None = None
    mask_means: str = "foreground"
    notes: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    model: Path | None = None
    within: tuple[float, float] = (0.0, 1.0)

    def __len__(self) -> int:
        return len(self.shots)

    @property
    def views(self) -> list[str]:
        """Names of the cameras, in order."""
        return list(dict.fromkeys(shot.view for shot in self.shots))

    @property
    def posed(self) -> bool:
        """Whether every shot has a camera."""
        return all(shot.camera is not None for shot in self.shots)

    @property
    def training(self) -> list[Shot]:
        """The shots to train on."""
        return [shot for shot in self.shots if not shot.held_out]

    @property
    def held_out(self) -> list[Shot]:
        """The shots kept for evaluation."""
        return [shot for shot in self.shots if shot.held_out]

    @property
    def training_views(self) -> list[str]:
        """Names of the views with shots to train on."""
        return list(dict.fromkeys(shot.view for shot in self.training))

    @property
    def held_out_views(self) -> list[str]:
        """Names of the views with shots kept for evaluation."""
        return list(dict.fromkeys(shot.view for shot in self.held_out))

    @property
    def films(self) -> list[Shot]:
        """The shots to train on that belong to a moment."""
        return [shot for shot in self.training if not shot.place]

    @property
    def scan(self) -> list[Shot]:
        """The shots to train on that show the place alone (scan.py)."""
        return [shot for shot in self.training if shot.place]

    def at_frame(self, frame: int) -> list[Shot]:
        """All shots of one frame."""
        return [shot for shot in self.shots if shot.frame == frame]

    def part(self, begin: int, count: int) -> Capture:
        """The frames begin .. begin + count - 1, with times from 0 to 1 of their own; the pictures are the same files."""
        clip, whole = Clip(count, self.clip.fps, self.clip.start_frame + begin), self.clip.frame_count
        at, length = begin / whole, count / whole
        shots = [shot if shot.place else replace(shot, frame=shot.frame - begin, t=(shot.t - at) / length)
                 for shot in self.shots if shot.place or begin <= shot.frame < begin + count]
        points = self.points
        if points is not None and points.t is not None:
            t = (np.asarray(points.t) - at) / length
            points = replace(points, t=t).take(~((t < 0) | (t >= 1)))  # those without a time, NaN, stay
        first, all_of_it = self.within
        return replace(self, shots=shots, clip=clip, points=points, within=(first + all_of_it * at, all_of_it * length))

    def middle(self, most: int) -> Capture:
        """The frames in the middle, at most so many."""
        count = min(self.clip.frame_count, most)
        return self.part((self.clip.frame_count - count) // 2, count)

    def centres(self, shots: Iterable[Shot] | None = None) -> np.ndarray:
        """Camera centres [n, 3] of the shots (default: those to train on), each different one once."""
        chosen = [shot for shot in (self.training if shots is None else shots) if shot.camera is not None]
        matrices = np.array([shot.camera.world_to_camera for shot in chosen if shot.camera is not None]).reshape(-1, 4, 4)
        return np.unique(-np.einsum("nij,ni->nj", matrices[:, :3, :3], matrices[:, :3, 3]), axis=0)

    @property
    def extent(self) -> float:
        """Size of the scene: 1.1 x the largest distance of a training camera from their mean (3DGS); 1 where they all are at one place."""
        centres = self.centres()
        size = 1.1 * float(np.linalg.norm(centres - centres.mean(0), axis=1).max(initial=0)) if len(centres) else 0.0
        return size if size > 1e-9 else 1.0

    @property
    def focus(self) -> np.ndarray:
        """The point [3] nearest to all training cameras' optical axes; see flights.focus()."""
        cameras = (shot.camera for shot in self.training if shot.camera is not None)
        return focus(list({camera.world_to_camera.tobytes(): camera for camera in cameras}.values()))
