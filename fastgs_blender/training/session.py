# SPDX-License-Identifier: GPL-3.0-or-later
"""A training run as users know it: a capture goes in, a folder with the model, its checkpoint and its history comes out.

    model.safetensors       the finished model; the same bytes whether or not the run was interrupted
    checkpoint.safetensors  the state to go on from
    run.json                the capture and the settings
    report.json             what came of it
    status.json, log.jsonl, loss.png, previews/, tensorboard/   see progress.py
"""
from __future__ import annotations

import contextlib
import json
import signal
import threading
from pathlib import Path

import numpy as np

from .. import formats
from ..errors import FastGSError
from ..formats.base import generator
from . import checkpoint
from .progress import Reporter, Silent
from .settings import Settings, from_dict

MODEL, RUN, REPORT = "model.safetensors", "run.json", "report.json"
PREVIEW_SHOTS = 4
MEMORY = 768 << 20
"""Bytes of pictures kept in memory."""


class Stopped(KeyboardInterrupt):
    """The user ended the run; the message says how to go on."""


def begin(out, wanted: dict, make: callable, resume: bool, overwrite: bool) -> Settings:
    """The settings of the run in a folder, which is made where there is none.

    wanted  the options that were asked for by name; make(wanted) gives the settings of a new run
    A run that is resumed has the settings it began with.  Raises FastGSError where that contradicts what is wanted, or where a
    run is in the folder already and neither resume nor overwrite says what to do with it.
    """
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FastGSError(f"{out}: the folder for the model cannot be made ({error.strerror}).") from error
    checkpoint.remove_leftovers(out)
    old = _earlier(out / RUN)
    if old is not None and resume:
        settings = from_dict(old)
        for name, value in wanted.items():
            if settings.to_dict()[name] != value:
                raise FastGSError(f"the run in {out} has {name} = {settings.to_dict()[name]}, not {value}; leave the option out to go on "
                                  "with it, or train into another folder.")
        return settings
    if not resume and not overwrite and any((out / name).exists() for name in (RUN, checkpoint.NAME, MODEL)):
        raise FastGSError(f"there is a training run in {out} already; --resume goes on with it, --overwrite begins anew.")
    settings = make(wanted)
    if not resume:
        for name in (checkpoint.NAME, MODEL, REPORT, "log.jsonl", "status.json"):
            (out / name).unlink(missing_ok=True)
    checkpoint.write_json(out / RUN, {"settings": settings.to_dict()})
    return settings


def train(capture, store, settings: Settings, out, group=None, quiet: bool = False, reporter_type=Reporter) -> dict:
    """Train, or go on with, the run in a folder; returns the report.

    capture, store  see captures.base; settings  what begin() gave; group  distributed.Group
    Raises Stopped after Ctrl-C or SIGTERM, with everything saved, and FastGSError.
    """
    from .distributed import Group

    group = group or Group()
    out = Path(out)
    found = group.first_does(lambda: checkpoint.load(out))
    done, elapsed = group.share((found[1]["iteration"], found[1].get("elapsed", 0.0)) if found else (0, 0.0))
    reporter = Silent()
    if group.first:
        reporter = reporter_type(out, settings.iterations, done, elapsed, quiet, settings.log_every)
    try:
        with _stop_flag() as stop:
            return _train(capture, store, settings, out, group, reporter, found, stop)
    except Stopped as stopped:
        reporter.status("stopped", reason=str(stopped))
        raise
    except BaseException as error:
        reporter.status("failed", reason=str(error) or type(error).__name__)
        raise
    finally:
        reporter.close()


def _train(capture, store, settings, out, group, reporter, found, stop) -> dict:
    import torch

    from .trainer import Trainer, run

    torch.set_num_threads(1)  # the kernels have threads of their own; and sums do not depend on the machine
    reporter.status("preparing")
    trainer = _trainer(Trainer, capture, store, settings, group, reporter, found)

    def save(last: bool):
        arrays, about = trainer.state()
        try:
            checkpoint.save(out, arrays, {**about, "elapsed": getattr(reporter, "elapsed", 0.0)})
        except FastGSError as error:
            if last:
                raise
            reporter.say(f"{error} Training goes on, and tries again.")

    if found is None:
        group.first_does(lambda: save(False))
    complete = run(trainer, reporter, save, stop, preview_shots(capture))
    if not complete:
        raise Stopped(f"stopped after {trainer.iteration} of {settings.iterations} steps; --resume goes on from there.")
    return group.first_does(lambda: _finish(trainer, capture, settings, out, reporter)) or {}


def _trainer(kind, capture, store, settings, group, reporter, found):
    """The trainer at its first step, or where the checkpoint left it; the first process tells the others."""
    about = group.share(found[1] if found else None)
    if about is not None:
        trainer = kind(capture, store, settings, None, group)
        trainer.restore(group.share_arrays(found[0] if found else {}), about)
        return trainer
    from .model import model_from_points

    points = group.first_does(lambda: _points(capture, store, settings, reporter))
    arrays = {} if points is None else {"xyz": np.asarray(points.xyz), "rgb": np.asarray(points.rgb)}
    if points is not None and points.t is not None:
        arrays["t"] = np.asarray(points.t)
    arrays = group.share_arrays(arrays)
    from ..captures.base import Points

    points = Points(arrays["xyz"], arrays["rgb"], arrays.get("t"))
    return kind(capture, store, settings, model_from_points(points, settings, capture.clip, capture.axes, capture.extent), group)


def _points(capture, store, settings, reporter):
    from .initial import initial_points

    return initial_points(capture, store, settings, reporter.say)


def _finish(trainer, capture, settings, out, reporter) -> dict:
    about = {"trainer": generator(), "capture": Path(capture.path).name, "layout": capture.layout, "iterations": str(trainer.iteration),
             "settings": json.dumps(settings.to_dict(), allow_nan=False)}
    model = trainer.final_model(about)
    formats.save(model, out / MODEL)
    report = {"model": str(out / MODEL), "gaussians": len(model), "iterations": trainer.iteration, "extent": capture.extent,
              "model_bytes": (out / MODEL).stat().st_size, "seconds": round(getattr(reporter, "elapsed", 0.0), 1),
              "peak_memory_bytes": peak_memory(), "processes": trainer.group.size, "settings": settings.to_dict()}
    if capture.held_out:
        whole, part, _ = trainer.measure(capture.held_out)
        report |= {"held_out_views": capture.held_out_views, "held_out_psnr": whole, "held_out_foreground_psnr": part}
    checkpoint.write_json(out / REPORT, report)
    reporter.status("finished", iteration=trainer.iteration, **{k: v for k, v in report.items() if k.startswith("held_out_psnr")})
    return report


def preview_shots(capture) -> list:
    """Some held-out shots, spread over the time of the first held-out view."""
    views = capture.held_out_views
    shots = [shot for shot in capture.held_out if shot.view == views[0]] if views else []
    picked = np.unique(np.linspace(0, len(shots) - 1, min(PREVIEW_SHOTS, len(shots))).round().astype(int)) if shots else []
    return [shots[i] for i in picked]


def peak_memory() -> int | None:
    """The most memory that this process has had, in bytes; None where the system does not say."""
    try:
        import resource
    except ImportError:
        return None
    import sys

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _earlier(path: Path) -> dict | None:
    """The settings of the run in a folder, if there is one."""
    if not path.exists():
        return None
    try:
        return json.loads(path.read_text("utf-8"))["settings"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FastGSError(f"{path} cannot be read ({error}); delete it to train from the beginning.") from error


@contextlib.contextmanager
def _stop_flag():
    """Gives stop(): whether Ctrl-C or SIGTERM came.  The step that is being taken is finished; a second Ctrl-C does not wait."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return

    def handler(number, frame):
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, old in before.items():
            signal.signal(number, old)
