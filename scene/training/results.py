# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings what a training run has made into Blender: its model as an object, its report as text."""
from __future__ import annotations

from pathlib import Path

import bpy

from ...fastgs_blender.jobs.job import Job
from ...fastgs_blender.training.run.files import PREVIEWS, REPORT
from ...fastgs_blender.util.errors import FastGSError
from ...fastgs_blender.util.reading import read_json, reading
from ..splats import splat_object
from . import alignment


def add_model(context, job, path) -> bpy.types.Object:
    """Add a run's model to the scene, where its cameras are; the one that an earlier look at the same run added is used again."""
    if context.mode != 'OBJECT':
        bpy.ops.object.mode_set(mode='OBJECT')
    before = next((obj for obj in context.scene.objects if obj.get("fastgs_job") == job.id), None)
    if before is not None and before.name in context.view_layer.objects:
        splat_object.show_file(before, str(path))
        return before
    obj = splat_object.create(context, str(path), relative=True)
    obj["fastgs_job"] = job.id
    obj.name = job.name
    obj.fastgs.start_frame = job.scene.get("start_frame", context.scene.frame_start)
    alignment.align(context.scene, obj, job.scene.get("world", ""))
    return obj


def report_text(job: Job) -> str:
    """The run's report as lines; raises FastGSError where there is none yet."""
    path = Path(job.out) / REPORT
    if not path.exists():
        raise FastGSError(f"{job.out}: there is no report yet; it comes when training has finished.")
    with reading(path):
        return _lines(job, read_json(path))


def _lines(job: Job, values: dict) -> str:
    rows = [("Model", values["model"]), ("Gaussians", values["gaussians"]), ("Size", f"{values['model_bytes'] / 1e6:.2f} MB"),
            ("Steps", values["iterations"]), ("Time", duration(values["seconds"]))]
    if values.get("held_out_psnr") is not None:
        rows += [("Held-out views", ", ".join(values["held_out_views"])), ("Held-out PSNR", f"{values['held_out_psnr']:.2f} dB")]
    if values.get("held_out_foreground_psnr") is not None:
        rows.append(("of the foreground", f"{values['held_out_foreground_psnr']:.2f} dB"))
    picture = newest_preview(job)
    if picture is not None:
        rows.append(("Model beside truth", picture))
    rows += [("", ""), *sorted(values["settings"].items())]
    return "\n".join(f"{name:<20} {value}".rstrip() for name, value in rows) + "\n"


def duration(seconds: float) -> str:
    """A duration as text: 45 s, 12 min, 1 h 5 min."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def newest_preview(job: Job) -> Path | None:
    """The newest preview picture of a run: the model on the left, the truth on the right."""
    return max((Path(job.out) / PREVIEWS).glob("*.png"), default=None)
