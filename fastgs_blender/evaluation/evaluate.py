# SPDX-License-Identifier: GPL-3.0-or-later
"""evaluate(): a model rendered from a capture's held-out cameras and measured against their pictures."""
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import groupby
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras.camera import Camera
from ..cameras.poses import turned
from ..captures.capture import Capture, Shot
from ..captures.pixels.store import FrameStore
from ..captures.refined import refined
from ..model.gaussians import GaussianModel
from ..rendering import colour
from ..rendering.api import render
from ..rendering.images import write_png
from ..util.arguments import shown
from ..util.backends import describe_backend
from ..util.errors import FastGSError
from ..util.outputs import make_folder
from . import halves, metrics
from .film import available, film
from .perceptual import Flip, Lpips, Unavailable
from .pictures import comparison
from .training_record import TrainingRecord, corrections, recorded

MEASURES = ("psnr", "psnr_right", "psnr_foreground", "dssim1", "dssim1_skimage", "dssim2", "lpips", "lpips_normalised", "flip", "flicker")
"""What is measured of each frame, and averaged; None where a measure does not apply.  psnr_right is that of the right half,
where colours are fitted."""


def evaluate(model: GaussianModel, capture: Capture, store: FrameStore | None = None, *, views: Sequence[str] | None = None,
             frames: Sequence[int] | None = None, out: str | Path | None = None, images: int = 10, backend: str = "auto",
             lpips: bool = True, fit_colours: bool | None = None, progress: Callable | None = None) -> dict:
    """Measure a model against the pictures of a capture.

    store      gives the pictures (captures.pixels.store.FrameStore); None: they are decoded into the cache on disk first
    views      names of the cameras to use; None: those that the model was not trained on, as its file says, else the capture's choice
    frames     their numbers from 0, beyond the model's clip too; None: all that the clip covers
    out        folder for side-by-side pictures of `images` frames of each view, and a film of each view; None: no pictures
    lpips      measure LPIPS too, where its weights are on this machine, else FLIP, where its package is
    fit_colours  fit the colours of each half of a picture on its other half (halves.py); None: where training evened exposures, as the
               model says
    progress   called as progress(done, total, row) after each frame

    Returns JSON values: facts of the model and the capture; "rows", one for each frame; "views" and "average", the means of MEASURES
    (of PSNR, over the frames where it is finite); "held_out": whether no picture was trained on, None if the model does not say; "seen"
    and "unseen", the means of pictures that were and were not, where there are both; "fps" of rendering alone, on "device"; "notes".
    Raises FastGSError where there is nothing to measure.  Never more than two frames are in memory.

    Example:
        average = fg.evaluate(fg.load("run/model.safetensors"), fg.open_capture("my-capture", scale=0.5))["average"]
    """
    if not isinstance(model, GaussianModel) or not isinstance(capture, Capture):
        raise FastGSError("evaluate() needs a model, as fg.load(path) reads it, and a capture, as fg.open_capture(path) does, not "
                          f"{shown(model)} and {shown(capture)}.")
    progress, out = progress or (lambda *_: None), None if out is None else Path(out)
    known, differed = recorded(model), corrections(model)
    fit_colours = "exposures" in differed if fit_colours is None else fit_colours
    given, capture = capture, refined(capture, differed.get("cameras", {}))
    store = store if store is None or capture is given else store.of(capture)
    shots = chosen(capture, views, frames, known)
    if store is None:
        store = FrameStore(capture, 0, whole=known is not None and known.whole)
        store.fill(shots=shots)
    turns = {view: np.radians(turn) for view, turn in differed.get("poses", {}).items()}
    clock, notes = _clock(model, capture, beyond=frames is not None)
    notes = [*capture.notes, *notes]
    times = {id(shot): t for shot in shots if (t := clock(shot)[0]) is not None}
    covered = [shot for shot in shots if id(shot) in times]
    if not covered:
        raise FastGSError(f"the model's clip has none of the frames to evaluate of {capture.path}; choose others with --frames.")
    if len(covered) < len(shots):
        notes.append(f"{len(shots) - len(covered)} frames lie outside the model's clip and are left out")
    if capture.axes != model.axes:
        notes.append(f"the model's axes are {model.axes} and the capture's {capture.axes}: they may not share a world")
    perceptual = flip = None
    if lpips:
        try:
            perceptual = Lpips()
        except Unavailable as reason:
            notes.append(str(reason))
            try:
                flip = Flip()
            except Unavailable as reason:
                notes.append(str(reason))
    if out is not None:
        make_folder(Path(out), "results")
    if out is not None and not available():
        notes.append("no film is written, as PyAV is not installed (pip install av)")

    _picture(model, covered[0].camera, times[id(covered[0])], backend)  # compiles what is still to be compiled
    rows: list[dict[str, Any]] = []
    files: list[Path] = []
    seconds = 0.0
    for view, shots_of_view in groupby(covered, key=lambda shot: shot.view):
        group = list(shots_of_view)
        with ExitStack() as stack:
            gallery = _Gallery(stack, Path(out), view, group, images, capture.clip.fps, files) if out is not None else None
            before = None
            for shot in group:
                truth, foreground, valid = _truth(capture, store, shot)
                began = time.perf_counter()
                t = times[id(shot)]
                camera = shot.camera
                if view in turns:
                    camera = replace(camera, world_to_camera=turned(camera.world_to_camera, turns[view]))
                picture = _picture(model, camera, t, backend)
                spent = time.perf_counter() - began
                seconds += spent
                picture = _judged(picture, truth, valid, fit_colours)
                trained_on = None if known is None else known.saw(view, clock(shot)[1], model.clip.frame_count)
                row = {"view": view, "frame": shot.frame, "t": t, "trained_on": trained_on,
                       "milliseconds": round(1000 * spent, 3),
                       **_measures(picture, truth, foreground, valid, perceptual, flip, fit_colours)}
                if before is not None and before[0] == shot.frame - 1 and before[1].shape == picture.shape:
                    both = None if valid is None or before[3] is None else valid & before[3]
                    row["flicker"] = _finite(metrics.temporal_error(picture, before[1], truth, before[2], both))
                before = shot.frame, picture, truth, None if valid is None else np.asarray(valid) > 0
                rows.append(row)
                if gallery:
                    gallery.add(shot, picture, truth, row)
                progress(len(rows), len(covered), row)
    if fit_colours:
        notes.append(halves.NOTE)
    if any(row["view"] in turns or row["view"] in differed.get("cameras", {}) for row in rows):
        notes.append("views that were trained on are shown by the cameras that training refined")
    notes += _remarks(rows, known)
    seen, unseen = ([row for row in rows if row["trained_on"] is which] for which in (True, False))
    return {
        "gaussians": len(model), "memory_bytes": model.nbytes, "capture": str(capture.path), "layout": capture.layout,
        "held_out": None if known is None else not seen, "width": covered[0].camera.width, "height": covered[0].camera.height,
        "fit_colours": fit_colours, "backend": backend, "device": describe_backend(backend),
        "fps": round(len(rows) / max(seconds, 1e-9), 3),
        "average": _means(rows), **({"seen": _means(seen), "unseen": _means(unseen)} if seen and unseen else {}),
        "views": {view: _means([row for row in rows if row["view"] == view]) for view in dict.fromkeys(row["view"] for row in rows)},
        "rows": rows, "notes": notes, "files": [str(file) for file in files],
    }


def _remarks(rows: list[dict[str, Any]], known: TrainingRecord | None) -> list[str]:
    """What must be known to read the measures."""
    remarks = []
    exact, seen = sum(row["psnr"] is None for row in rows), sum(row["trained_on"] is True for row in rows)
    if exact:
        remarks.append(f"{exact} frames equal the truth exactly: their PSNR is infinite and left out of the averages")
    if known is None:
        remarks.append("the model's file does not say which pictures it was trained on, so whether these were held out is not known")
    elif seen:
        remarks.append(f"{seen} of the {len(rows)} pictures were trained on: they tell how well the model remembers, "
                       "not how well it holds in new views")
    return remarks


def chosen(capture: Capture, views: Sequence[str] | None = None, frames: Sequence[int] | None = None,
           known: TrainingRecord | None = None) -> list:
    """The shots of those views and frames (default: all), view by view in the order of time.

    views  default: those that the model was not trained on, as `known` says; without it those that the capture holds out
    """
    there = capture.views
    listed = ", ".join(there[:12]) + (", ..." if len(there) > 12 else "")
    if frames is not None:
        numbered = tuple(frames) if isinstance(frames, Iterable) else (None,)
        if not all(isinstance(frame, Integral) for frame in numbered):
            raise FastGSError(f"the frames to evaluate must be a list of whole numbers, not {shown(frames)}.")
        frames = numbered
    if views is None and known is not None:
        shots = [shot for shot in capture.shots if shot.view not in known.views]
        if not shots:
            raise FastGSError(f"the model was trained on all {len(there)} views of {capture.path}; choose views with --views, and frames "
                              "that it was not trained on with --frames.")
    elif views is None:
        shots = capture.held_out
        if not shots:
            raise FastGSError(f"{capture.path} holds out no view to evaluate with; choose views with --views (there are {listed}).")
    else:
        for name in views:
            if name not in there:
                raise FastGSError(f"{capture.path} has no view {name!r}; there are {listed}.")
        shots = [shot for shot in capture.shots if shot.view in set(views)]
    if frames is not None:
        wanted = set(frames)
        shots = [shot for shot in shots if shot.frame in wanted]
        if not shots:
            raise FastGSError(f"{capture.path} has none of the frames to evaluate; it has the frames 0 to {capture.clip.frame_count - 1}.")
    if any(shot.camera is None for shot in shots):
        raise FastGSError(f"{capture.path} does not say where its cameras are, so a model cannot be compared with its pictures.")
    return sorted(shots, key=lambda shot: (there.index(shot.view), shot.frame, shot.t))


def _clock(model: GaussianModel, capture: Capture, beyond: bool = False) -> tuple[Callable[[Shot], tuple[float | None, float]], list[str]]:
    """Gives (model time of a shot or None outside of the model's clip, its frame counted from the clip's first), and notes; beyond: times
    outside of the clip are given too.

    A model of the whole capture, or of one frame, shares its time.  One of a part of it is placed by its start frame; one of every
    n-th frame by its frame rate.  Pictures are told apart by their frames, not by their times: clocks of cameras may differ.
    """
    whole, part = capture.clip, model.clip
    first = whole.start_frame - part.start_frame
    if part.frame_count in (1, whole.frame_count):
        return (lambda shot: (shot.t, shot.frame if part.frame_count > 1 else shot.frame + first)), []
    step = max(round(whole.fps / part.fps), 1)

    def time_of(shot: Shot) -> tuple[float | None, float]:
        number = (first + shot.frame) / step
        inside = beyond or -1e-6 <= number <= part.frame_count - 1 + 1e-6
        return (first + shot.t * whole.frame_count) / step / part.frame_count if inside else None, number

    clips = (f"{clip.frame_count} frames from {clip.start_frame}" for clip in (part, whole))
    return time_of, ["the model's clip is {}, the capture's {}: frames are matched by their numbers".format(*clips)]


def _picture(model: GaussianModel, camera: Camera, t: float, backend: str) -> np.ndarray:
    """What the model shows over black, as display colours [h, w, 3]."""
    image = render(model, camera, t, ("rgb", "alpha"), backend)
    return image["rgb"] if model.colour_space == "srgb" else colour.linear_to_srgb(image["rgb"])


def _truth(capture: Capture, store: FrameStore, shot: Shot) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """What a shot should look like, [h, w, 3]; the masks [h, w] of its foreground and of its valid pixels, None where there is none.

    Transparent pictures are judged over black, as models are.  What is not valid (beyond the lens' picture, or ruled out by the
    capture's masks) is black on both sides, and no part of any measure.
    """
    pixels = store.pixels(shot)
    rgb, mask, valid = pixels.rgb, pixels.mask, pixels.valid
    if pixels.alpha is not None:
        rgb = rgb * pixels.alpha[..., None]
    if mask is not None and shot.mask is None:
        rgb = rgb * mask[..., None]
    elif mask is not None and capture.mask_means == "valid":
        inside = mask >= metrics.FOREGROUND
        mask, valid = None, inside if valid is None else inside & valid
    if valid is not None:
        rgb = rgb * valid[..., None]
        mask = None if mask is None else mask * valid
    return rgb, mask, valid


def _judged(picture: np.ndarray, truth: np.ndarray, valid: np.ndarray | None, fit: bool) -> np.ndarray:
    """The picture as it is shown and measured: with fitted colours, black where it is not valid."""
    picture = halves.fitted(picture, truth, valid) if fit else picture
    return picture if valid is None else picture * valid[..., None]


def _measures(picture: np.ndarray, truth: np.ndarray, foreground: np.ndarray | None, valid: np.ndarray | None, perceptual: Any,
              flip: Any, fitted: bool) -> dict:
    values = dict.fromkeys(MEASURES)
    values["psnr"] = metrics.psnr(picture, truth, valid)
    if fitted:
        right = np.s_[:, halves.middle(picture):]
        values["psnr_right"] = metrics.psnr(picture[right], truth[right], None if valid is None else valid[right])
    if foreground is not None:
        values["psnr_foreground"] = metrics.psnr(picture, truth, foreground)
    values |= {name: getattr(metrics, name)(picture, truth, valid) for name in ("dssim1", "dssim1_skimage", "dssim2")}
    if perceptual:
        values["lpips"], values["lpips_normalised"] = perceptual(picture, truth, valid)
    if flip:
        values["flip"] = flip(picture, truth, valid)
    return {name: _finite(value) for name, value in values.items()}


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else value


def _means(rows: list[dict[str, Any]]) -> dict:
    """The mean of each measure over the rows that have it; None where none has."""
    means = {}
    for name in MEASURES:
        values = [row[name] for row in rows if row[name] is not None]
        means[name] = float(np.mean(values)) if values else None
    return {"frames": len(rows), **means}


class _Gallery:
    """Side-by-side pictures of some frames of one view, and a film of all."""

    def __init__(self, stack: ExitStack, out: Path, view: str, shots: list, images: int, fps: float, files: list) -> None:
        self._stack, self._folder, self._fps, self._files = stack, out, fps, files
        self._name = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in view).lstrip(".") or "view"
        picked = np.unique(np.linspace(0, len(shots) - 1, min(images, len(shots))).round().astype(int)) if images > 0 else []
        self._picked = {id(shots[i]) for i in picked}
        self._film: Callable | None = None
        self._filming = len(shots) > 1 and available()

    def add(self, shot: Shot, picture: np.ndarray, truth: np.ndarray, row: dict[str, Any]) -> None:
        label = f"{shot.view}  frame {shot.frame}"
        if id(shot) in self._picked:
            psnr = "" if row["psnr"] is None else f"  {row['psnr']:.2f} dB"
            sheet = comparison(truth, picture, label + psnr, error=True)
            path = self._folder / f"{self._name}-{shot.frame:04d}.png"
            write_png(path, {"rgb": sheet.astype(np.float32) / 255, "alpha": np.ones(sheet.shape[:2], np.float32)}, "srgb")
            self._files.append(path)
        if self._filming:
            sheet = comparison(truth, picture, label, error=False)
            if self._film is None:
                path = self._folder / f"{self._name}.mp4"
                self._size = sheet.shape
                self._film = self._stack.enter_context(film(path, sheet.shape[1], sheet.shape[0], self._fps))
                self._files.append(path)
            if self._film is not None and sheet.shape == self._size:
                self._film(sheet)


