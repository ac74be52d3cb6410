# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings what a training run has made into Blender: its model as an object, its report as text."""
import threading
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...fastgs_blender.jobs.job import Job
from ...fastgs_blender.training.run.files import MODEL, PREVIEWS, REPORT
from ...fastgs_blender.util.errors import FastGSError, printable
from ...fastgs_blender.util.reading import read_json, reading
from .. import objects
from ..filming.film import filmed_objects
from ..splats import proxy, splat_object
from . import alignment


class Reading:
    """Reads a run's model into memory and prepares its proxy in a thread, so that adding it to the scene takes no time.

    Of a run that has not finished it is the model of the last checkpoint.  Nothing of Blender's data is touched.
    """

    def __init__(self, out: str, finished: bool):
        self._out, self._finished = out, finished
        self._path: Path | None = None
        self._error: FastGSError | None = None
        self._thread = threading.Thread(target=self._read, name="FAST-GS model", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether the model has been read, or cannot be."""
        return not self._thread.is_alive()

    @property
    def path(self) -> Path:
        """The model's file, when it has been read; waits until then.  Raises FastGSError."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._path

    def _read(self):
        try:
            path = Path(self._out) / MODEL if self._finished else _model_so_far(self._out)
            proxy.prepare(objects.load_model(str(path)))
            self._path = path
        except FastGSError as error:
            self._error = error
        except Exception as error:  # noqa: BLE001 (in a thread nobody else would tell)
            self._error = FastGSError(f"{self._out}: its model could not be read ({error}).")


def _model_so_far(out: str) -> Path:
    from ...fastgs_blender.training.run import intermediate  # only when it is needed: it brings the trainer along

    return intermediate.write_model(out)


def add_model(context, job, path) -> bpy.types.Object:
    """Add a run's model to the scene, where its cameras are; the one that an earlier look at the same run added is used again."""
    if context.mode != 'OBJECT':
        bpy.ops.object.mode_set(mode='OBJECT')
    before = next((obj for obj in context.scene.objects if obj.get("fastgs_job") == job.id), None) or _showing(context.scene, path)
    if before is not None and before.name in context.view_layer.objects:
        splat_object.show_file(before, str(path))
        before["fastgs_job"] = job.id
        return before
    obj = splat_object.create(context, str(path), relative=True)
    obj["fastgs_job"] = job.id
    obj.name = job.name
    obj.fastgs.start_frame = job.scene.get("start_frame", context.scene.frame_start)
    alignment.align(context.scene, obj, job.scene.get("world", ""))
    return obj


def _showing(scene, path) -> bpy.types.Object | None:
    """The object that shows this file already, as it does of a run that was begun anew."""
    return next((obj for obj in scene.objects if objects.is_splat(obj) and Path(objects.abspath(obj)) == Path(path)), None)


def add_finished(context, job: Job) -> bpy.types.Object:
    """Add a finished run's model to the scene, and hide what it was filmed from, where that is wanted."""
    obj = add_model(context, job, Path(job.out) / MODEL)
    if job.scene.get("hide"):
        hide_originals(context, job.capture)
    return obj


def hide_originals(context, capture: str) -> int:
    """Hide the objects that a capture was filmed from, in viewports and renders; returns how many."""
    found = [obj for name in filmed_objects(capture) if (obj := context.scene.objects.get(name)) and not objects.is_splat(obj)]
    for obj in found:
        if obj.name in context.view_layer.objects:
            obj.hide_set(True)
        if obj.is_editable:
            obj.hide_render = True
    return len(found)


@dataclass(frozen=True)
class Report:
    """A finished run's report: (label, value) pairs about its result and its settings, and its newest preview picture."""

    numbers: list[tuple[str, str]]
    settings: list[tuple[str, str]]
    picture: Path | None

    @property
    def text(self) -> str:
        """All of it as lines."""
        picture = [("Model beside truth", printable(self.picture))] if self.picture else []
        return "\n".join(f"{name:<20} {value}".rstrip() for name, value in (*self.numbers, *picture, ("", ""), *self.settings)) + "\n"


def report_of(job: Job) -> Report:
    """The run's report; raises FastGSError where there is none yet."""
    path = Path(job.out) / REPORT
    if not path.exists():
        raise FastGSError(f"{job.out}: there is no report yet; it comes when training has finished.")
    with reading(path):
        return _report(job, read_json(path))


def _report(job: Job, values: dict) -> Report:
    rows = []
    if values.get("held_out_psnr") is not None:
        rows += [("Held-out PSNR", f"{values['held_out_psnr']:.2f} dB")]
    if values.get("held_out_foreground_psnr") is not None:
        rows.append(("of the foreground", f"{values['held_out_foreground_psnr']:.2f} dB"))
    if values.get("held_out_psnr") is not None:
        rows += [("Held-out views", ", ".join(values["held_out_views"]))]
    device = [("Device", values["device"])] if "device" in values else []
    rows += [("Gaussians", f"{values['gaussians']:,}"), ("Size", f"{values['model_bytes'] / 1e6:.2f} MB"),
             ("Steps", f"{values['iterations']:,}"), ("Time", duration(values["seconds"])), *device, ("Model", values["model"])]
    return Report([(name, printable(value)) for name, value in rows],
                  [(printable(name), printable(value)) for name, value in sorted(values["settings"].items())], newest_preview(job))


def duration(seconds: float) -> str:
    """A duration as text: 45 s, 12 min, 1 h 5 min."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def newest_preview(job: Job) -> Path | None:
    """The newest preview picture of a run: the model on the left, the truth on the right."""
    return max((Path(job.out) / PREVIEWS).glob("*.png"), default=None)
