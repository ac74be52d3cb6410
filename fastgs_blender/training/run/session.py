# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs training on a capture, in a folder that gets the model, its checkpoint and its history (files.py lists what is in it).

The finished model has the same bytes whether or not the run was interrupted.
"""
import contextlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import formats
from ...captures.capture import Capture, Shot
from ...captures.pixels.store import FrameStore
from ...captures.refined import refined
from ...evaluation import training_record
from ...formats.base import generator
from ...kernels.protocol import DeviceError
from ...model.chapters import Chapters
from ...model.gaussians import GaussianModel
from ...util.backends import describe_backend
from ...util.errors import FastGSError
from ...util.reading import read_json
from ..core import camera_response, camera_turns
from ..core.measure import measure
from ..core.processes import Processes
from ..core.spans import Span, spans
from ..core.state import LONGEST, is_number
from ..core.trainer import Trainer
from ..initial.calibrate import with_poses
from ..initial.continued import freeze_still, start_after
from ..initial.refine import refinement
from ..initial.start import expected_clocks, start
from ..initial.visual_hull import hull_of
from . import checkpoint, written
from . import plan as plans
from .files import CHECKPOINT, MODEL, REFINED, REPORT, SEGMENT_DONE, SEGMENT_MODEL, SEGMENTS
from .folder import release, take
from .plan import Plan
from .progress import Reporter
from .segments import joined_clip
from .stopping import StopFlag, Stopped

PREVIEW_SHOTS = 4
MEMORY = 768 << 20
"""Bytes of pictures kept in memory."""


def run(capture: Capture, store: Any, plan: Plan, out: str | Path, *, quiet: bool = False, reporter_type: type[Reporter] = Reporter,
        backend: str = "cpu", processes: Processes | None = None, forecast: float = 0.0) -> dict:
    """Train, or continue, the run in a folder; returns the report.

    capture, store  see captures.capture; plan  what plan.begin() gave; backend  its name (util/backends.py)
    processes       those that take the steps together; forecast: seconds that the run is expected to take, 0: unknown
    Raises Stopped after Ctrl-C or SIGTERM, with everything saved, and FastGSError.  A run that fails before its first checkpoint leaves
    no plan behind, so that the corrected one can start.
    """
    out, settings = Path(out), plan.settings
    cuts = spans(capture.clip.frame_count, settings.segment_frames, settings.segment_overlap)
    if len(cuts) > 1 and settings.motion == "keyframes":
        raise FastGSError("a capture this long is trained in segments, and keyframes of several segments do not join; choose another "
                          "motion, or --set segment_frames=0.")
    take(out)
    plans.write(out, plan)
    steps = [settings.of_segment(k).iterations for k in range(len(cuts))]
    done, elapsed = progress_so_far(out, steps)
    reporter = reporter_type(out, sum(steps), done, elapsed, quiet, forecast=forecast)
    reporter.device = describe_backend(backend)
    try:
        with StopFlag() as stop:
            return _Session(plan, out, reporter, stop, processes or Processes()).train(capture, store, cuts, backend)
    except KeyboardInterrupt as stopped:
        reporter.status("stopped", reason=str(stopped) or "stopped.")
        raise
    except BaseException as error:
        reporter.status("failed", reason=str(error) or type(error).__name__)
        if not isinstance(error, SystemExit):
            plans.forget(out)
        raise
    finally:
        reporter.close()
        release(out)


@dataclass
class _Session:
    """A run in its folder; cameras: what was changed in those that the capture gives (initial/refine.py)."""

    plan: Plan
    out: Path
    reporter: Any
    stop: StopFlag
    processes: Processes
    cameras: dict | None = None

    def train(self, capture: Capture, store: FrameStore, cuts: list[Span], backend: str) -> dict:
        """All segments of a capture, a short one in one; returns the report."""
        reporter, settings = self.reporter, self.plan.settings
        reporter.status("preparing")
        begun = (self.out / CHECKPOINT).exists() or any((self.out / SEGMENTS).glob("*/*"))
        if not capture.posed:
            with reporter.stage("finding the cameras", "part") as report:
                capture = with_poses(capture, store, self.out, reporter.say, report)
            store = store.of(capture)
        with reporter.stage("refining cameras", "picture") as report:
            self.cameras = refinement(capture, store, settings, self.out / REFINED, begun, reporter.say, report)["cameras"]
        given, capture = capture, refined(capture, self.cameras)
        store = store if capture is given else store.of(capture)
        for number, cut in enumerate(cuts):
            if len(cuts) > 1:
                reporter.say(f"segment {number + 1} of {len(cuts)}: frames {cut.first} to {cut.first + cut.count - 1}")
            only = self._segment(capture, store, cuts, number, backend)
        first = self._finished(0) if only is None else only
        corrections = training_record.corrections(first)  # exposures stay, and clocks run on
        corrections |= {"cameras": self.cameras} if self.cameras else {}
        about = {"trainer": generator(), "capture": Path(capture.path).name, "layout": capture.layout,
                 "iterations": str(settings.iterations), "settings": json.dumps(settings.to_dict(), allow_nan=False),
                 **training_record.record(capture, store.whole), **training_record.corrections_entry(corrections)}
        model = joined_clip(self._finished, cuts, capture.clip, about) if only is None else replace(first, provenance=about)
        return self._finish(model, capture, store, cuts)

    def _finished(self, number: int) -> GaussianModel:
        """The model of a segment whose training has ended."""
        return formats.load(segment_folder(self.out, number) / SEGMENT_MODEL)

    def _segment(self, capture: Capture, store: FrameStore, cuts: list[Span], number: int, backend: str) -> GaussianModel | None:
        """Train one segment, or continue it, if it is not finished.  Where the device fails, the CPU goes on from the last checkpoint.

        Returns the model of a capture that is one segment; others lie in their folders.
        """
        folder = self.out if len(cuts) == 1 else segment_folder(self.out, number)
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / SEGMENT_MODEL).exists():
            (folder / CHECKPOINT).unlink(missing_ok=True)
            return None
        part = capture if len(cuts) == 1 else capture.part(cuts[number].first, cuts[number].count)
        self.reporter.fill(store, part.shots)
        if store.plain is not None and not number:
            self.reporter.say("what stands before the pictures' plain background is cut out; --masks off keeps the background")
        earlier = capture.part(cuts[number - 1].first, cuts[number - 1].count) if number else None
        try:
            model = self._trained(part, store, cuts, folder, number, backend, earlier)
        except DeviceError as error:
            if self.processes.count > 1:
                raise FastGSError(f"a GPU fails ({error}); --resume continues the run, --device cpu without GPUs.") from error
            self.reporter.warn(f"the GPU fails ({error}): the processor goes on from the last checkpoint.")
            self.reporter.device = f"{self.reporter.device.partition(', then ')[0]}, then {describe_backend('cpu')}"
            model = self._trained(part, store, cuts, folder, number, "cpu", earlier)
        if len(cuts) > 1:  # the model replaces the checkpoint
            model = freeze_still(model, part, store, self.plan.settings) if self.plan.settings.segment_steps else model
            checkpoint.write_json(folder / SEGMENT_DONE, {"elapsed": self.reporter.elapsed})
            written.write(model, folder / SEGMENT_MODEL)
            (folder / CHECKPOINT).unlink(missing_ok=True)
            return None
        return model

    def _trained(self, capture: Capture, store: FrameStore, cuts: list[Span], folder: Path, number: int, backend: str,
                 earlier: Capture | None) -> GaussianModel:
        """_segment() on one backend, after the segment of the capture `earlier`; raises DeviceError.

        It shares the decoder of the first segment, which learns its own, and begins from the one before.
        """
        settings, found, span = self.plan.settings.of_segment(number), checkpoint.load(folder), cuts[number]
        began, decoder = None, self._finished(0) if number else None
        if found is None:
            with self.reporter.stage("comparing clocks", "picture") as report:
                clocks = expected_clocks(capture, store, settings, self.reporter.say, report)
            with self.reporter.stage("finding starting points", "part") as report:
                if earlier is not None and settings.segment_steps:
                    at = (span.first - cuts[number - 1].first) / cuts[number - 1].count
                    began = start_after(self._finished(number - 1), earlier, at, capture, store, settings, self.reporter.say, report)
                else:
                    began = start(capture, store, settings, self.reporter.say, report)
            began = replace(began, clocks=clocks, unsure={view: change.get("unsure", 0.0) for view, change in (self.cameras or {}).items()})
        trainer = Trainer(capture, store, settings, began, decoder=decoder, backend=backend, processes=self.processes,
                          hull=hull_of(capture, store, self.reporter.say))
        if found is not None:
            trainer.restore(*found)

        def save(last: bool) -> None:
            arrays, about = trainer.state()
            try:
                checkpoint.save(folder, arrays, {**about, "elapsed": self.reporter.elapsed})
            except FastGSError as error:
                if last:
                    raise
                self.reporter.warn(f"{error} Training continues and will try again.")

        if found is None:
            save(False)
        if self.processes.count > 1:
            arrays, about = trainer.state()
            self.processes.send({"plan": self.plan.to_dict(), "out": str(self.out), "cameras": self.cameras, "about": about,
                                 "number": number, "span": [span.first, span.count], "fixed": trainer.fixed}, arrays)
        self.stop.patient = True
        complete = take_steps(trainer, self.reporter, save, self.stop, preview_shots(capture),
                              sum(self.plan.settings.of_segment(k).iterations for k in range(number)))
        self.stop.patient = False
        if not complete:
            raise Stopped(f"stopped after {trainer.iteration} of {settings.iterations} steps; --resume continues from there.")
        return trainer.final_model({})

    def _finish(self, model: GaussianModel | Chapters, capture: Capture, store: FrameStore, cuts: list[Span]) -> dict:
        """Write the model and measure it; returns the report."""
        out, settings, reporter = self.out, self.plan.settings, self.reporter
        written.write(model, out / MODEL)
        report = {"model": str(out / MODEL), "gaussians": len(model), "iterations": settings.iterations, "extent": capture.extent,
                  "model_bytes": (out / MODEL).stat().st_size, "seconds": round(reporter.elapsed, 1), "peak_memory_bytes": peak_memory(),
                  "processes": self.processes.count, "device": reporter.device, "settings": settings.to_dict()}
        found = training_record.corrections(model)
        if found:
            report["corrections"] = found
            reporter.say(training_record.sentence(found))
        for text in at_limits(found):
            reporter.warn(text)
        if capture.held_out:
            shown = model if isinstance(model, GaussianModel) else formats.open_source(out / MODEL)
            with reporter.stage("measuring the held-out views", "picture") as measured:
                psnr, foreground = measure(shown, capture, store, settings, self._held_out(capture, store, cuts),
                                           fit_colours="exposures" in found, progress=measured)
            report |= {"held_out_views": capture.held_out_views, "held_out_psnr": psnr, "held_out_foreground_psnr": foreground}
        checkpoint.write_json(out / REPORT, report)
        reporter.status("finished", iteration=reporter.iterations, **{k: v for k, v in report.items() if k == "held_out_psnr"})
        return report

    def _held_out(self, capture: Capture, store: FrameStore, cuts: list[Span]) -> Iterator[Shot]:
        """The held-out shots, with the pictures of one segment after another in the cache."""
        for number, cut in enumerate(cuts):
            end = cuts[number + 1].first if number + 1 < len(cuts) else cut.first + cut.count
            shots = [shot for shot in capture.held_out if cut.first <= shot.frame < end]
            self.reporter.fill(store, shots)
            yield from shots


def at_limits(found: dict) -> list[str]:
    """Warnings of what training_record.corrections() gave and training stopped at a limit: the truth lies beyond it."""
    turns = {view: float(np.linalg.norm(np.radians(turn))) for view, turn in found.get("poses", {}).items()}
    pairs = (("pose", "turn by more than 2 degrees", "calibrate again", turns, 0.99 * camera_turns.FARTHEST),
             ("clock", "differ by more than 1.5 frames", "run fastgs sync", found.get("clocks", {}), 0.99 * camera_response.FARTHEST))
    return [f"warning: the {what} of {', '.join(far)} may {how}, which is the most that training corrects; {remedy}, then train again."
            for what, how, remedy, values, most in pairs if (far := [view for view, value in values.items() if abs(value) >= most])]


def take_steps(trainer: Trainer, reporter: Reporter, save: Callable[[bool], None], stop: Callable[[], bool], preview: Sequence[Shot] = (),
               before: int = 0) -> bool:
    """Take all steps that are left; returns whether the run is complete.

    save()   writes a checkpoint; called at the end, and about every settings.checkpoint_seconds (0: after every step)
    stop()   whether to end early, for example because of Ctrl-C
    preview  shots to look at now and then
    before   steps of earlier segments, by which the reporter counts on
    """
    s = trainer.settings
    saved, pause = time.monotonic(), s.checkpoint_seconds

    def report(finished: list[dict]) -> None:
        for values in finished:
            reporter.step({**values, "iteration": before + values["iteration"]})

    while trainer.iteration < s.iterations:
        report(trainer.advance())
        i = trainer.iteration
        stopped = stop()
        last = stopped or i == s.iterations
        previews = preview and s.preview_every and (i % s.preview_every == 0 or i == s.iterations)
        keep = last or time.monotonic() - saved > pause
        if previews or keep:
            report(trainer.finish())
            if trainer.iteration < i:
                continue
        if previews:
            psnr, foreground, pictures = trainer.measure(preview)
            kind = "held_out" if preview[0].held_out else "preview"
            measured = {f"{kind}_psnr": psnr} | ({} if foreground is None else {f"{kind}_foreground_psnr": foreground})
            reporter.preview(before + i, np.concatenate(pictures[len(pictures) // 2], 1), measured)
        if keep:
            began = time.monotonic()
            save(last)
            saved = time.monotonic()
            pause = max(s.checkpoint_seconds, 20 * (saved - began)) if s.checkpoint_seconds else 0.0  # a slow disk is asked less often
        if stopped:
            return i == s.iterations
    return True


def segment_folder(out: Path, number: int) -> Path:
    """The folder in which a segment of a long capture is trained."""
    return out / SEGMENTS / f"{number:03d}"


def progress_so_far(out: Path, steps: list[int]) -> tuple[int, float]:
    """Steps and seconds of the run in a folder; steps: those of each segment.  Raises FastGSError where a checkpoint cannot be used."""
    done, elapsed = 0, 0.0
    for k, iterations in enumerate(steps):
        folder = segment_folder(out, k) if len(steps) > 1 else out
        if (folder / SEGMENT_MODEL).exists():
            done += iterations
            with contextlib.suppress(FastGSError):
                about = read_json(folder / SEGMENT_DONE)
                if isinstance(about, dict) and is_number(about.get("elapsed"), 0, LONGEST):
                    elapsed = about["elapsed"]
        elif (found := checkpoint.load(folder)) is not None:
            done, elapsed = done + found[1]["iteration"], found[1].get("elapsed", 0.0)
    return done, elapsed


def preview_shots(capture: Capture) -> list:
    """Shots for previews, spread over the time of the first held-out view, or of the first view where none is held out."""
    pool = capture.held_out or capture.training
    shots = [shot for shot in pool if shot.view == pool[0].view]
    picked = np.unique(np.linspace(0, len(shots) - 1, min(PREVIEW_SHOTS, len(shots))).round().astype(int))
    return [shots[i] for i in picked]


def peak_memory() -> int | None:
    """The most memory that this process has had, in bytes; None where the system does not say."""
    try:
        import resource
    except ImportError:
        return None
    import sys

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
