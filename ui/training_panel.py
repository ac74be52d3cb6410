# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of training in the sidebar of the 3D view, and its line in the status bar."""
from pathlib import Path

import bpy

from ..fastgs_blender.jobs import capture_check, checks
from ..fastgs_blender.jobs.places import Place
from ..fastgs_blender.training.core import costs
from ..scene import paths
from ..scene.filming import progress
from ..scene.settings import EXTENSION
from ..scene.training import folders, installation, plates, readiness, results, watch
from . import facts
from .object_panels import Sidebar, draw_column, draw_rows, draw_trouble, split

ICONS = {'QUEUED': 'TIME', 'PAUSED': 'PAUSE', 'STOPPED': 'SNAP_FACE', 'FAILED': 'ERROR', 'FINISHED': 'CHECKMARK'}


def estimate_rows(context, settings) -> list[tuple[str, str]]:
    """Time and memory that filming and training will need, if the number and the size of the pictures are known."""
    scene = context.scene
    pixels = views = pictures = 0
    filming = 0.0
    if settings.source == 'SCENE':
        pixels = settings.width * settings.height
        frames = (scene.frame_end - scene.frame_start) // settings.frame_step + 1
        views = readiness.count_of_cameras(context, settings.cameras, settings.count)
        pictures = frames * views
        filming = progress.estimate(scene, settings, pictures)
    elif (found := checks.latest) and settings.source == 'FOLDER' and found.capture == paths.bare(bpy.path.abspath(settings.capture)):
        pixels, views, pictures = found.width * found.height, found.views, found.views * found.frames
    if not pixels:
        return [("Estimate", "Read the capture first" if settings.source == 'FOLDER' else "Not known yet")]
    pixels = costs.trained_pixels(settings.preset, pixels, settings.scale)
    size = costs.size_of(settings.preset, settings.iterations, settings.max_gaussians, pixels * views, pictures // max(views, 1))
    seconds, memory = costs.estimate(pixels, *size, pictures, views)
    rows = [("Estimate", f"about {results.duration(filming + seconds)}")]
    if settings.source == 'SCENE':
        rows.append(("Filming", f"{results.duration(filming)} of it"))
    return [*rows, ("Memory", f"about {facts.size(memory)}")]


def draw_place(layout, context, settings) -> Place:
    """Draw the folder of the results and what will happen to what is in it; returns its Place."""
    layout.prop(settings, "out")
    place = folders.place(settings.out, settings.existing)
    if place.asks:
        layout.prop(settings, "existing")
    if not place.trouble:
        draw_trouble(layout, context, place.text, 'INFO')
    return place


def draw_start(layout, context, settings, place):
    """Draw the buttons, and why they cannot be pressed where that is so."""
    unable, source = installation.trouble(), readiness.source_trouble(context)
    reason = unable or place.trouble.replace(place.out, Path(place.out).name) or ("" if place.capture else source)
    if reason:
        draw_trouble(layout, context, reason)
    if unable:
        row = layout.row(align=True)
        row.operator("fastgs.test_training_python", icon='CHECKMARK')
        row.operator("preferences.addon_show", text="Preferences", icon='PREFERENCES').module = EXTENSION
    row = layout.row(align=True)
    if settings.source == 'SCENE':
        other = row.row(align=True)
        other.enabled = not source
        other.operator("fastgs.capture_scene", text="Capture Only", icon='OUTLINER_OB_CAMERA')
    sub = row.row(align=True)
    sub.enabled = not reason
    sub.operator("fastgs.train", icon='PLAY')


def draw_capture(layout, context, settings):
    """Draw the capture's folder, what can be done with it before training, in the order of use, and what that has found."""
    layout.prop(settings, "capture")
    col = layout.column(align=True)
    col.enabled = not (installation.trouble() or readiness.source_trouble(context))
    col.operator("fastgs.train_check", icon='FILE_REFRESH')
    col.operator("fastgs.sync_cameras", icon='TIME')
    col.operator("fastgs.check_capture", icon='VIEWZOOM')
    capture = paths.bare(bpy.path.abspath(settings.capture))
    if (found := checks.latest) and found.capture == capture:
        size = f"{found.width} x {found.height}"
        draw_rows(layout, [("Found", f"{found.views} cameras, {found.frames} frames"), ("Pictures", size)])
        for problem in found.problems[:3]:
            draw_trouble(layout, context, problem)
    draw_verdict(layout, context, capture)
    if lacking := installation.lacking():
        draw_trouble(layout, context, lacking, 'INFO')


def draw_verdict(layout, context, capture):
    """Draw what the last check of this capture said, and the worst of it."""
    values = capture_check.latest
    if values is None or values["asked"] != capture:
        return
    bad = [finding for finding in values["findings"] if finding["severity"] == "wrong"]
    draw_trouble(layout, context, values["verdict"], 'ERROR' if bad else 'INFO')
    for finding in bad[:2]:
        draw_trouble(layout, context, finding["sentence"])


class FASTGS_PT_training(Sidebar, bpy.types.Panel):
    bl_label = "Train"

    def draw(self, context):
        layout, settings = split(self.layout, decorate=False), context.scene.fastgs.training
        layout.prop(settings, "source")
        if settings.source == 'FOLDER':
            draw_capture(layout, context, settings)
        elif settings.source == 'CAMERAS':
            draw_rows(layout, [("Found", f"{plates.count(context.scene)} filmed cameras")])
        else:
            layout.prop(settings, "cameras")
            if settings.cameras in ('DOME', 'ARC'):
                layout.prop(settings, "count")
            draw_column(layout, settings, "width", "height", align=True)
        col = layout.column()
        col.prop(settings, "preset")
        col.prop(context.scene.fastgs, "device")
        draw_rows(col, estimate_rows(context, settings))
        place = draw_place(layout, context, settings)
        col = layout.column(align=True)
        col.prop(settings, "import_result", text="Import")
        if settings.source == 'SCENE':
            row = col.row()
            row.enabled = settings.import_result
            row.prop(settings, "hide_originals")
        draw_start(layout, context, settings, place)


class FASTGS_PT_training_filming(Sidebar, bpy.types.Panel):
    bl_label = "Filming"
    bl_parent_id = "FASTGS_PT_training"

    @classmethod
    def poll(cls, context):
        return context.scene.fastgs.training.source == 'SCENE'

    def draw(self, context):
        layout, settings = split(self.layout, decorate=False), context.scene.fastgs.training
        draw_column(layout, settings, *("distance", "angle") * (settings.cameras in ('DOME', 'ARC')), "subject", "frame_step")
        draw_column(layout, settings, "quality", *("samples",) * (settings.quality == 'FAST'), "world", "hold_out")


class FASTGS_PT_training_options(Sidebar, bpy.types.Panel):
    bl_label = "Options"
    bl_parent_id = "FASTGS_PT_training"

    def draw(self, context):
        layout, settings = split(self.layout, decorate=False), context.scene.fastgs.training
        draw_column(layout, settings, "scan", "frames", "scale", "held_out")
        draw_column(layout, settings, "iterations", "max_gaussians", "order").prop(settings, "motion_weight", text="Smoothing")


class FASTGS_PT_training_runs(Sidebar, bpy.types.Panel):  # last of all: nothing below it lies over a run while panels move apart
    bl_label = "Runs"
    bl_parent_id = "FASTGS_PT_training"
    bl_options = set()

    def draw(self, context):
        layout = self.layout
        rows = watch.ordered()
        filming = progress.current
        if filming is not None:
            draw_filming(layout.box(), context, filming)
        elif not rows:
            layout.label(text="None yet", icon='INFO')
        for job, state in rows:
            draw_job(layout.box(), context, job, state)


def draw_filming(box, context, filming):
    """Draw the filming under way."""
    box.label(text=filming.name, icon='OUTLINER_OB_CAMERA')
    left = f", {results.duration(filming.seconds_left)} left" if filming.seconds_left else ""
    box.progress(factor=filming.share, text=f"{filming.doing} {100 * filming.share:.0f} %{left}")
    draw_rows(box, [("Pictures", f"{filming.done:,} of {filming.total:,}")])
    draw_trouble(box, context, "Meanwhile only the view can be turned, between two pictures; Esc interrupts.", 'INFO')


def draw_job(box, context, job, state):
    """Draw a run: its name, its buttons, its state."""
    row = box.row(align=True)
    row.label(text=job.name, icon=ICONS.get(state.kind, 'RENDER_ANIMATION'))
    if state.running or state.kind == 'QUEUED':
        row.operator("fastgs.train_pause", text="", icon='PAUSE').job = job.id
        row.operator("fastgs.train_stop", text="", icon='SNAP_FACE').job = job.id
    else:
        if state.kind != 'FINISHED':
            row.operator("fastgs.train_resume", text="", icon='PLAY').job = job.id
        row.operator("fastgs.train_forget", text="", icon='X').job = job.id
    if state.running:
        left = f", {results.duration(state.seconds_left)} left" if state.seconds_left else ""
        box.progress(factor=state.share, text=f"{state.text} {100 * state.share:.0f} %{left}")
    elif state.kind == 'FAILED':
        col = box.column(align=True)
        col.alert = True
        draw_trouble(col, context, state.text)
    draw_rows(box, job_rows(state))
    if not watch.belongs_here(job):
        draw_rows(box, [("Of", Path(job.scene.get("blend", "")).name or "an unsaved file")])
    if state.kind == 'FINISHED' or state.values.get("iteration"):
        row = box.row(align=True)
        text = "Add Model" if state.kind == 'FINISHED' else "View Model So Far"
        row.operator("fastgs.train_import", text=text, icon='IMPORT').job = job.id
        if state.kind == 'FINISHED':
            row.operator("fastgs.train_report", icon='TEXT').job = job.id


def job_rows(state) -> list[tuple[str, str]]:
    """(label, value) pairs about a run."""
    values, rows = state.values, []
    if not state.running and state.kind != 'FAILED':
        rows.append(("State", state.text))
    if values.get("iteration"):
        rows.append(("Step", f"{values['iteration']:,} of {values['iterations']:,}"))
    if values.get("gaussians"):
        rows.append(("Gaussians", f"{values['gaussians']:,}"))
    if values.get("psnr"):
        rows.append(("PSNR", f"{values['psnr']:.1f} dB"))
    if values.get("device"):
        rows.append(("Device", values["device"]))
    if values.get("held_out_psnr"):
        rows.append(("Held Out", f"{values['held_out_psnr']:.2f} dB"))
    return rows


def draw_status(self, context):
    """Draw the running job into the status bar."""
    text = watch.line()
    if text:
        self.layout.label(text=text, icon='RENDER_ANIMATION')


def register():
    bpy.types.STATUSBAR_HT_header.append(draw_status)


def unregister():
    bpy.types.STATUSBAR_HT_header.remove(draw_status)
