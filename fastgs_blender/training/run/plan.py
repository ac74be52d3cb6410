# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a training run: its capture and its settings, which run.json in the run's folder records.

begin() makes the plan of a new run, or brings back that of a run which is resumed, and takes the folder.  It changes nothing in it: a run
that cannot start leaves everything as it was.
"""
import os
import shutil
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from ...captures import open_capture, open_scan
from ...captures.capture import Capture
from ...captures.scan import with_scan
from ...util.errors import FastGSError
from ...util.outputs import remove_leftovers
from ...util.reading import read_json
from ..core.costs import calm, draft_scale, longer, rooms
from ..core.presets import LENGTHS, WARM_START
from ..core.settings import Settings, from_dict
from ..core.spans import spans
from . import checkpoint
from .files import CHECKPOINT, LOG, MODEL, PLOT, PREVIEWS, REFINED, REPORT, RUN, SEGMENTS, SO_FAR, STATUS
from .folder import release, take

DAMAGED = "delete it to train from the beginning"


NO_END = 1 << 30
"""The end of a part of a capture that goes to its last frame."""


@dataclass(frozen=True)
class Source:
    """What a run is trained on, as open_capture() takes it; None where the layout of the capture decides.

    capture  the folder or file;  scan: that of photographs of its place, or None
    frames   first frame, end (not included; or NO_END) and step of the part that is used
    """

    capture: str | None = None
    layout: str | None = None
    scale: float | None = None
    frames: tuple[int, int, int] | None = None
    held_out: tuple[str, ...] | None = None
    scan: str | None = None

    def open(self) -> Capture:
        """The capture; raises FastGSError."""
        if self.capture is None:
            raise FastGSError("the folder of the run does not say what it was trained on; name the capture.")
        frames = None
        if self.frames is not None:
            first, end, step = self.frames
            frames = slice(first, end if end < NO_END else None, step)
        capture = open_capture(self.capture, scale=self.scale, frames=frames, held_out=self.held_out, layout=self.layout)
        return capture if self.scan is None else with_scan(capture, open_scan(self.scan))


NOTHING = Source()
"""Nothing was said of the capture."""


@dataclass(frozen=True)
class Plan:
    """A run: what it is trained on, its settings, and whether it starts from the beginning."""

    settings: Settings
    source: Source
    fresh: bool = True

    def to_dict(self) -> dict:
        """Plain JSON values."""
        source = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self.source).items()}
        return {"settings": self.settings.to_dict(), "source": source, "fresh": self.fresh}


def plan_from_dict(values: object, where: str = "the plan of a run") -> Plan:
    """The inverse of Plan.to_dict; raises FastGSError, which names `where`.  A plan may name no source."""
    settings = values.get("settings") if isinstance(values, dict) else None
    if not isinstance(values, dict) or not isinstance(settings, dict):
        raise FastGSError(f"{where}: it holds no settings; {DAMAGED}.")
    source = values.get("source") or {}
    wrong = "source" if not isinstance(source, dict) else next((name for name, value in source.items() if not _sound(name, value)), None)
    if wrong is not None:
        raise FastGSError(f"{where}: its {wrong} is not valid; {DAMAGED}.")
    source = {name: tuple(value) if isinstance(value, list) else value for name, value in source.items()}
    return Plan(from_dict(settings), Source(**source), values.get("fresh") is True)


def _sound(name: str, value: object) -> bool:
    if name not in {field.name for field in fields(Source)}:
        return False
    if value is None:
        return True
    if name == "scale":
        return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value <= 1
    if name == "frames":
        return (isinstance(value, list) and len(value) == 3 and all(isinstance(v, int) and 0 <= v < 1 << 31 for v in value)
                and value[2] > 0)
    texts = value if name == "held_out" else [value]
    return isinstance(texts, list) and all(isinstance(text, str) and "\0" not in text for text in texts)


def read_plan(out: str | Path) -> Plan | None:
    """The plan of the run in a folder, None where there is none; raises FastGSError where it cannot be read."""
    path = Path(out) / RUN
    if not path.exists():
        return None
    return replace(plan_from_dict(read_json(path, advice=DAMAGED), str(path)), fresh=False)


def begin(out: str | Path, wanted: dict, make: Callable[[dict], Settings], resume: bool = False, overwrite: bool = False,
          source: Source = NOTHING) -> Plan:
    """The plan of the run in a folder, which is made where there is none.

    wanted, source  the options that were asked for by name; make(wanted) gives the settings of a new run
    A run that is resumed has the settings and the capture it began with.  No other process can train in the folder until session.run() or
    folder.release() has been called, or this process has ended.  Raises FastGSError where another one does, where settings or capture
    contradict what is asked for, or where a run is in the folder already and neither resume nor overwrite says what to do with it.
    """
    out = Path(out)
    take(out)
    try:
        for folder in (out, *(out / SEGMENTS).glob("*")):
            remove_leftovers(folder)
        old = read_plan(out) if resume else None
        if old is not None:
            for name, value in wanted.items():
                _agree(out, name, getattr(old.settings, name), value)
            return replace(old, source=_continued(out, old.source, source))
        if not resume and not overwrite and any((out / name).exists() for name in (RUN, CHECKPOINT, MODEL)):
            raise FastGSError(f"there is a training run in {out} already; --resume continues it, --overwrite starts again from the "
                              "beginning.")
        return Plan(make(wanted), source, fresh=not resume)
    except BaseException:
        release(out)
        raise


def suited(settings: Settings, capture: Capture, named: Collection[str] = ()) -> Settings:
    """The settings for a new run on this capture: more Gaussians for a large rig (costs.rooms), more steps for long segments (costs.longer)
    and a lower floor under slopes for drafts (costs.calm); where the capture brings a model to begin with, steps and motion as that needs.

    named  the settings that were asked for by name, which stay
    """
    from ..initial.warm_start import begins_with_model, following

    if not begins_with_model(capture, settings):
        first = spans(capture.clip.frame_count, settings.segment_frames, settings.segment_overlap)[0]
        return _for_its_size(settings, capture, first.count, named) if settings.preset in LENGTHS else settings
    chosen = replace(settings, **{name: value for name, value in WARM_START.get(settings.preset, {}).items() if name not in named})
    cuts = spans(capture.clip.frame_count, chosen.segment_frames, chosen.segment_overlap)
    each = [following(capture.part(cut.first, cut.count), chosen) for cut in cuts]  # segments are joined, so all have the same motion
    freedom = {name: max(getattr(one, name) for one in each) for name in ("order", "rotation_degree") if name not in named}
    return replace(chosen, **freedom)


def smaller(source: Source, capture: Capture, preset: str) -> Source:
    """The source of a new run, with the scale that suits a draft of large pictures (costs.draft_scale), where none was asked for."""
    pixels = max((shot.camera.width * shot.camera.height for shot in capture.training if shot.camera is not None), default=0)
    factor = draft_scale(preset, pixels) if source.scale is None else 1.0
    return source if factor == 1 else replace(source, scale=factor * capture.scale)


def _for_its_size(settings: Settings, capture: Capture, frames: int, named: Collection[str]) -> Settings:
    """The settings with as many Gaussians and starting points as the training cameras show, steps as the frames of a segment ask, and the
    floor under slopes that suits these."""
    sizes = {shot.view: shot.camera.width * shot.camera.height for shot in capture.training if shot.camera is not None}
    times = dict.fromkeys(("max_gaussians", "init_points"), rooms(sum(sizes.values())))
    times["iterations"] = longer(frames)
    sized = replace(settings, **{name: round(factor * getattr(settings, name)) for name, factor in times.items() if name not in named})
    share = 1.0 if "slope_floor" in named else calm(sized.iterations, sized.max_gaussians)
    return replace(sized, slope_floor=share * sized.slope_floor)


def _continued(out: Path, old: Source, new: Source) -> Source:
    """What a resumed run is trained on.  A capture that was moved is taken from its new place."""
    for name in ("layout", "scale", "frames", "held_out", "scan"):
        if getattr(new, name) is not None and old.capture is not None:
            _agree(out, name, getattr(old, name), getattr(new, name))
    if old.capture is None:
        return new
    if new.capture is None or os.path.realpath(new.capture) == os.path.realpath(old.capture):
        return old
    if os.path.exists(old.capture):
        raise FastGSError(f"the run in {out} is trained on {old.capture}, not on {new.capture}; leave the capture out to continue it, or "
                          "train into another folder.")
    return replace(old, capture=new.capture)


def _agree(out: Path, name: str, old: object, new: object) -> None:
    if old != new:
        raise FastGSError(f"the run in {out} has {name} = {_words(old)}, not {_words(new)}; leave the option out to continue it, or train "
                          "into another folder.")


def _words(value: object) -> str:
    return "its default" if value is None else ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def write(out: str | Path, plan: Plan) -> None:
    """Record the plan, and remove from the folder what an earlier run left there if this one starts from the beginning."""
    out = Path(out)
    if plan.fresh:
        for name in (CHECKPOINT, MODEL, SO_FAR, REFINED, REPORT, LOG, STATUS, PLOT):
            (out / name).unlink(missing_ok=True)
        for name in (SEGMENTS, PREVIEWS):
            shutil.rmtree(out / name, ignore_errors=True)
    checkpoint.write_json(out / RUN, {name: value for name, value in plan.to_dict().items() if name != "fresh"})


def forget(out: str | Path) -> None:
    """Remove the plan of a run that has failed before its first checkpoint: there is nothing to resume."""
    out = Path(out)
    if not (out / CHECKPOINT).exists() and not any((out / SEGMENTS).glob("*/*")):
        (out / RUN).unlink(missing_ok=True)
