# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs training on a capture, in a folder that gets the model, its checkpoint and its history (files.py lists what is in it).

The finished model has the same bytes whether or not the run was interrupted.
"""
from __future__ import annotations

import contextlib
import json
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ... import formats
from ...evaluation import training_record
from ...formats.base import generator
from ...kernels.protocol import DeviceError
from ...util.backends import describe_backend
from ...util.errors import FastGSError
from ...util.outputs import remove_leftovers
from ...util.reading import read_json
from ...util.stopping import SIGNALS
from ..core.settings import Settings
from ..core.state import is_duration
from . import checkpoint, written
from . import plan as plans
from .files import CHECKPOINT, MODEL, REFINED, REPORT, SEGMENT_DONE, SEGMENT_MODEL, SEGMENTS
from .folder import release, take
from .plan import NOTHING, Plan, Source
from .progress import Reporter, Silent

PREVIEW_SHOTS = 4
MEMORY = 768 << 20
"""Bytes of pictures kept in memory."""


class Stopped(KeyboardInterrupt):
    """The user ended the run; the message says how to continue it."""


def begin(out, wanted: dict, make: Callable[[dict], Settings], resume: bool, overwrite: bool,
          source: Source = NOTHING) -> Plan:
    """The plan of the run in a folder, which is made where there is none; see plan.begin().

    No other process can train in the folder until train() or release() has been called, or this process has ended.  Raises FastGSError
    where another one does.
    """
    out = Path(out)
    take(out)
    try:
        for folder in (out, *(out / SEGMENTS).glob("*")):
            remove_leftovers(folder)
        return plans.begin(out, wanted, source, make, resume, overwrite)
    except BaseException:
        release(out)
        raise


def train(capture, store, plan: Plan, out, group=None, quiet: bool = False, reporter_type=Reporter, backend: str = "cpu") -> dict:
    """Train, or continue, the run in a folder; returns the report, in the first process.

    capture, store  see captures.capture; plan  what begin() gave; group  distributed.Group; backend  its name (util/backends.py)
    Raises Stopped after Ctrl-C or SIGTERM, with everything saved, and FastGSError.  A run that fails before its first checkpoint leaves
    no plan behind, so that the corrected one can start.
    """
    from ..core.distributed import Group
    from .segments import spans

    group = group or Group()
    out, settings = Path(out), plan.settings
    cuts = spans(capture.clip.frame_count, settings.segment_frames, settings.segment_overlap)
    if len(cuts) > 1 and settings.motion == "keyframes":
        raise FastGSError("a capture this long is trained in segments, and keyframes of several segments do not join; choose another "
                          "motion, or --set segment_frames=0.")
    reporter: Silent = Silent()
    if group.first:
        take(out)
        plans.write(out, plan)
        done, elapsed = progress_so_far(out, len(cuts), settings.iterations)
        reporter = reporter_type(out, len(cuts) * settings.iterations, done, elapsed, quiet, settings.log_every)
    reporter.device = describe_backend(backend)
    try:
        with StopFlag() as stop:
            return _train(capture, store, settings, out, group, reporter, stop, cuts, backend)
    except KeyboardInterrupt as stopped:
        reporter.status("stopped", reason=str(stopped) or "stopped.")
        raise
    except BaseException as error:
        reporter.status("failed", reason=str(error) or type(error).__name__)
        if group.first and not isinstance(error, SystemExit):
            plans.forget(out)
        raise
    finally:
        reporter.close()
        release(out)


def _train(capture, store, settings, out, group, reporter, stop, cuts, backend) -> dict:
    from .segments import joined_model

    reporter.status("preparing")
    capture, store, cameras = _refined(capture, store, settings, out, group, reporter)
    group.first_does(lambda: reporter.fill(store, capture.shots))
    about = {"trainer": generator(), "capture": Path(capture.path).name, "layout": capture.layout, "iterations": str(settings.iterations),
             "settings": json.dumps(settings.to_dict(), allow_nan=False), **training_record.record(capture)}
    if len(cuts) == 1:
        model = _segment(capture, store, settings, out, group, reporter, stop, None, 0, backend)
        evened = training_record.evened(model)
    else:
        models = []
        for number, cut in enumerate(cuts):
            folder = segment_folder(out, number)
            group.first_does(lambda folder=folder: folder.mkdir(parents=True, exist_ok=True))
            reporter.say(f"segment {number + 1} of {len(cuts)}: frames {cut.first} to {cut.first + cut.count - 1}")
            decoder = models[0] if models else None
            models.append(_segment(capture.part(cut.first, cut.count), store, settings, folder, group, reporter, stop, decoder, number,
                                   backend))
        evened = training_record.evened(models[0])  # exposures stay, and clocks run on
        model = joined_model(models, cuts, capture.clip, {})
    about |= training_record.evened_entry(evened | ({"cameras": cameras} if cameras else {}))
    return group.first_does(lambda: _finish(replace(model, provenance=about), capture, store, settings, out, group, reporter)) or {}


def _refined(capture, store, settings, out, group, reporter):
    """Capture and store with cameras that fit the pictures, and what was changed; nothing where none fit clearly better."""
    from ...captures.refined import refined
    from ..initial.refine import refinement

    if settings.poses == "off":
        return capture, store, {}
    begun = (out / CHECKPOINT).exists() or any((out / SEGMENTS).glob("*/*"))
    with reporter.stage("refining cameras", "picture") as report:
        found = group.share(group.first_does(lambda: refinement(capture, store, settings, out / REFINED, begun, reporter.say, report)))
    better = refined(capture, found["cameras"])
    return better, store if better is capture else store.of(better), found["cameras"]


def _segment(capture, store, settings, folder, group, reporter, stop, decoder, number, backend):
    """Train one segment (a short capture is one segment), continue it, or load it if it is finished; returns its model.

    decoder  the model whose decoder it shares, None: it learns its own
    Where the backend's device fails, the CPU goes on from the last checkpoint.
    """
    rest = (capture, store, settings, folder, group, reporter, stop, decoder, number)
    try:
        return _segment_on(backend, *rest)
    except DeviceError as error:
        if group.size > 1:
            raise FastGSError(f"a GPU fails ({error}); --resume continues the run, --device cpu without GPUs.") from error
        reporter.warn(f"the GPU fails ({error}): the processor goes on from the last checkpoint.")
        reporter.device = f"{reporter.device.partition(', then ')[0]}, then {describe_backend('cpu')}"
        return _segment_on("cpu", *rest)


def _segment_on(backend, capture, store, settings, folder, group, reporter, stop, decoder, number):
    """_segment() on one backend; raises DeviceError."""
    from ..core.trainer import Trainer, run

    name = folder / SEGMENT_MODEL
    if group.share(name.exists() if group.first else None):
        return formats.load(name)
    found = group.first_does(lambda: checkpoint.load(folder))
    trainer = _trainer(Trainer, capture, store, settings, group, reporter, found, decoder, backend)

    def save(last: bool):
        arrays, about = trainer.state()
        try:
            checkpoint.save(folder, arrays, {**about, "elapsed": getattr(reporter, "elapsed", 0.0)})
        except FastGSError as error:
            if last:
                raise
            reporter.warn(f"{error} Training continues and will try again.")

    if found is None:
        group.first_does(lambda: save(False))
    stop.patient = True
    complete = run(trainer, reporter, save, stop, preview_shots(capture), number * settings.iterations)
    stop.patient = False
    if not complete:
        raise Stopped(f"stopped after {trainer.iteration} of {settings.iterations} steps; --resume continues from there.")
    model = trainer.final_model({})
    if folder.parent.name == SEGMENTS:
        group.first_does(lambda: _keep_segment(model, folder, reporter))
    return model


def _keep_segment(model, folder, reporter):
    """Replace the checkpoint of a finished segment by its model."""
    checkpoint.write_json(folder / SEGMENT_DONE, {"elapsed": getattr(reporter, "elapsed", 0.0)})
    written.write(model, folder / SEGMENT_MODEL)
    (folder / CHECKPOINT).unlink(missing_ok=True)


def _trainer(kind, capture, store, settings, group, reporter, found, decoder, backend):
    """The trainer at its first step, or where the checkpoint left it; the first process tells the others."""
    about = group.share(found[1] if found else None)
    if about is not None:
        trainer = kind(capture, store, settings, None, group, decoder, backend=backend)
        trainer.restore(group.share_arrays(found[0] if found else {}), about)
        return trainer
    from ..core.model import empty_model
    from ..initial.start import Start, start

    with reporter.stage("finding starting points") as report:
        began = group.first_does(lambda: start(capture, store, settings, reporter.say, report))
    began = Start.of(group.share_arrays(began.arrays if began else {}), empty_model(settings, capture.clip, capture.axes))
    return kind(capture, store, settings, began.model, group, decoder, began.sizes, began.reach, backend, began.gains,
                began.fades, began.known, began.clocks)


def _finish(model, capture, store, settings, out, group, reporter) -> dict:
    from ..core.trainer import measure

    written.write(model, out / MODEL)
    report = {"model": str(out / MODEL), "gaussians": len(model), "iterations": settings.iterations, "extent": capture.extent,
              "model_bytes": (out / MODEL).stat().st_size, "seconds": round(getattr(reporter, "elapsed", 0.0), 1),
              "peak_memory_bytes": peak_memory(), "processes": group.size, "device": reporter.device, "settings": settings.to_dict()}
    found = training_record.evened(model)
    if found:
        report["evened"] = found
        reporter.say(training_record.sentence(found))
    if capture.held_out:
        whole, foreground, _ = measure(model, capture, store, settings, capture.held_out, fit_colours="exposures" in found)
        report |= {"held_out_views": capture.held_out_views, "held_out_psnr": whole, "held_out_foreground_psnr": foreground}
    checkpoint.write_json(out / REPORT, report)
    reporter.status("finished", iteration=reporter.iterations, **{k: v for k, v in report.items() if k == "held_out_psnr"})
    return report


def segment_folder(out: Path, number: int) -> Path:
    """The folder in which a segment of a long capture is trained."""
    return out / SEGMENTS / f"{number:03d}"


def progress_so_far(out: Path, segments: int, iterations: int) -> tuple[int, float]:
    """Steps and seconds of the run in a folder; raises FastGSError where a checkpoint cannot be used."""
    done, elapsed = 0, 0.0
    for folder in [out] if segments == 1 else [segment_folder(out, k) for k in range(segments)]:
        if (folder / SEGMENT_MODEL).exists():
            done += iterations
            with contextlib.suppress(FastGSError):
                about = read_json(folder / SEGMENT_DONE)
                if isinstance(about, dict) and is_duration(about.get("elapsed")):
                    elapsed = about["elapsed"]
        elif (found := checkpoint.load(folder)) is not None:
            done, elapsed = done + found[1]["iteration"], found[1].get("elapsed", 0.0)
    return done, elapsed


def preview_shots(capture) -> list:
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


class StopFlag:
    """Handles Ctrl-C and the other signals to stop (util/stopping.py).  While `patient`, they only set the flag, and the step that is being
    taken is finished; a second one does not wait.  Otherwise there is nothing to save, and they end the run at once.
    """

    def __init__(self):
        self.patient = self.asked = False

    def __call__(self) -> bool:
        return self.asked

    def __enter__(self):
        self._before = {}
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._handle) for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN}
        return self

    def __exit__(self, *error):
        for number, old in self._before.items():
            signal.signal(number, old)

    def _handle(self, number, frame):
        if self.asked or not self.patient:
            raise KeyboardInterrupt
        self.asked = True
