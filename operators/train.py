# SPDX-License-Identifier: GPL-3.0-or-later
"""Training runs: start, pause, resume, stop, and what they bring into the scene."""
from __future__ import annotations

import json
import os
import threading
import time
from functools import partial
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..fastgs_blender.jobs import checks
from ..fastgs_blender.jobs import queue as jobs
from ..fastgs_blender.util.errors import FastGSError
from ..scene.splats import splat_object
from ..scene.splats.splat_object import sentence
from ..scene.training import alignment, places, plates, store, watch
from ..scene.training.options import TrainingOptions, arguments

REPORT_EVERY = 5.0
"""Seconds between two lines of progress without a window."""


class FASTGS_OT_train(TrainingOptions, bpy.types.Operator):
    """Train a model from a capture in a process of its own, which goes on when Blender is closed; what is not given comes from the panel"""

    bl_idname = "fastgs.train"
    bl_label = "Train"

    start_frame: IntProperty(name="Start Frame", description="Scene frame of the capture's first frame; the scene's first unless given")
    existing: EnumProperty(
        name="Existing Run", description="What to do where the folder holds a run already",
        items=(
            ('REFUSE', "Refuse", "Say so", 0),
            ('RESUME', "Go On", "Go on where it was", 1),
            ('OVERWRITE', "Overwrite", "Begin anew", 2),
        ), default='REFUSE')
    import_result: BoolProperty(name="Import When Done", description="Add the finished model to the scene", default=True)
    wait: BoolProperty(
        name="Wait", description="Come back when training has ended; always so without a window, unless it is given", default=False)

    @classmethod
    def poll(cls, context):
        return context.scene is not None

    def invoke(self, context, event):
        settings = context.scene.fastgs.training
        for name in (*TrainingOptions.__annotations__, "import_result"):
            if not self.properties.is_property_set(name):
                setattr(self, name, getattr(settings, name))
        if self.source == 'SCENE':
            return self._capture_first(context, settings)
        return self.execute(context)

    def execute(self, context):
        if self.source == 'SCENE':
            self.report({'ERROR'}, "Capture the scene first, with fastgs.capture_scene, and train on its folder.")
            return {'CANCELLED'}
        try:
            job = self._add(context)
        except FastGSError as error:
            return self._fail(error)
        if self.wait or (bpy.app.background and not self.properties.is_property_set("wait")):
            return self._run(context, job)
        known = store.jobs()
        known.start_next()
        watch.begin()
        state = known.state(known.get(job.id))
        if state.kind == 'FAILED':
            return self._fail(FastGSError(state.text))
        self.report({'INFO'}, f"{job.name}: training {'waits for its turn' if state.kind == 'QUEUED' else 'has begun'}")
        return {'FINISHED'}

    def _capture_first(self, context, settings):
        from ..scene.filming.options import CaptureOptions

        chosen = {name: getattr(settings, name) for name in CaptureOptions.__annotations__}
        try:
            store.python()  # without one, filming would be for nothing
        except FastGSError as error:
            return self._fail(error)
        try:
            done = bpy.ops.fastgs.capture_scene('INVOKE_DEFAULT', train=True, **chosen)
        except RuntimeError as error:  # it has said why in Blender's own way
            return self._fail(FastGSError(str(error).strip().removeprefix("Error: ")))
        return {'CANCELLED'} if 'CANCELLED' in done else {'FINISHED'}  # the capture goes on by itself

    def _add(self, context):
        scene = context.scene
        if not self.properties.is_property_set("start_frame"):
            self.start_frame = scene.frame_start
        python = store.python()
        out = bpy.path.abspath(self.out) if self.out else places.fresh("training")
        if self.source == 'CAMERAS':
            capture = plates.write_capture(context, Path(out) / "capture")
        else:
            capture = bpy.path.abspath(self.capture).rstrip("/\\")
            if not capture:
                raise FastGSError("no capture is chosen; choose its folder.")
            if not Path(capture).exists():
                raise FastGSError(f"{capture}: there is no such capture; check the folder.")
        pixels, views, frames = checks.picture_size(capture)
        size = checks.size_of(self.preset, self.iterations, self.max_gaussians)
        _, memory = checks.estimate(round(pixels * (self.scale or 1) ** 2), *size, views * frames)
        for remark in checks.before_start(out, memory):
            self.report({'WARNING'}, sentence(remark))
        options = arguments(self)
        if (Path(capture) / "points.ply").is_file():
            options += ["--set", "start=file"]  # what a capture brings along is better than what can be guessed
        about = {"blend": bpy.data.filepath, "process": os.getpid(), "start_frame": self.start_frame, "import": self.import_result,
                 "world": alignment.world_of(scene, capture)}
        first = {'REFUSE': "", 'RESUME': "--resume", 'OVERWRITE': "--overwrite"}[self.existing]
        return store.jobs().add(out, capture, python, options, about, first)

    def _run(self, context, job):
        """Start the job at once and wait for its end."""
        known = store.jobs()
        try:
            known.start(job)
            told = time.monotonic()
            while (state := known.state(job)).running:
                time.sleep(0.2)
                if time.monotonic() - told > REPORT_EVERY:
                    told = time.monotonic()
                    print(f"FAST-GS: {progress(job, state)}", flush=True)
        except KeyboardInterrupt:
            known.ask(job, 'PAUSE')
            raise
        except FastGSError as error:
            known.fail(job, error)
            return self._fail(error)
        job.told = True
        known.save(job)
        watch.look()
        if state.kind != 'FINISHED':
            return self._fail(FastGSError(state.text))
        print(f"FAST-GS: {job.name} {watch.summary(state)}", flush=True)
        if self.import_result:
            try:
                add_model(context, job, Path(job.out) / jobs.MODEL)
            except FastGSError as error:
                return self._fail(error)
        self.report({'INFO'}, f"{job.name}: {watch.summary(state)}; {Path(job.out) / jobs.MODEL}")
        return {'FINISHED'}

    def _fail(self, error):
        self.report({'ERROR'}, sentence(error))
        return {'CANCELLED'}


def progress(job, state) -> str:
    """One line about a running job."""
    values = state.values
    text = f"{job.name}: {state.text.lower()}"
    if values.get("iteration"):
        text += f", step {values['iteration']} of {values['iterations']}"
    if values.get("psnr"):
        text += f", {values['psnr']:.1f} dB"
    if state.seconds_left:
        text += f", {watch.duration(state.seconds_left)} left"
    return text


def add_model(context, job, path) -> bpy.types.Object:
    """Add a run's model to the scene, where its cameras are; the one that an earlier look at the same run added is used again."""
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


class _JobOperator:
    """An operator about one job; without a name, about the panel's."""

    job: StringProperty(name="Job", description="Which job; empty for the one that the panel shows", options={'HIDDEN', 'SKIP_SAVE'})

    @classmethod
    def poll(cls, context):
        if watch.current() is None:
            cls.poll_message_set("There is no training job")
        return watch.current() is not None

    def found(self):
        """(Jobs, Job, State) now."""
        known = store.jobs()
        row = watch.current()
        job = known.get(self.job or row[0].id)
        if job is None:
            raise FastGSError("that training job is not on the list any more.")
        return known, job, known.state(job)

    def execute(self, context):
        try:
            known, job, state = self.found()
            done = self.act(context, known, job, state)
        except FastGSError as error:
            self.report({'ERROR'}, sentence(error))
            return {'CANCELLED'}
        watch.begin()
        watch.redraw()
        if done:
            self.report({'INFO'}, done)
        return {'FINISHED'}


class FASTGS_OT_train_pause(_JobOperator, bpy.types.Operator):
    """Save the run and end its process; jobs that wait go on waiting"""

    bl_idname = "fastgs.train_pause"
    bl_label = "Pause"

    def act(self, context, known, job, state):
        if not state.running and state.kind != 'QUEUED':
            raise FastGSError(f"{job.name} is not running.")
        known.ask(job, 'PAUSE')
        return f"{job.name}: saving and pausing"


class FASTGS_OT_train_resume(_JobOperator, bpy.types.Operator):
    """Go on with a run that was paused, stopped, or that failed"""

    bl_idname = "fastgs.train_resume"
    bl_label = "Resume"

    wait: BoolProperty(name="Wait", description="Come back when training has ended", default=False, options={'SKIP_SAVE'})

    def act(self, context, known, job, state):
        if state.running or state.kind in ('QUEUED', 'FINISHED'):
            raise FastGSError(f"{job.name} has nothing to resume: it is {state.text.lower()}.")
        others = [other for other in known.all() if other.id != job.id and known.state(other).running]
        if others and not self.wait:
            known.ask(job, 'QUEUED')
            return f"{job.name} waits until {others[0].name} has ended"
        known.start(job)
        if self.wait:
            while known.state(job).running:
                time.sleep(0.2)
            end = known.state(job)
            if end.kind != 'FINISHED':
                raise FastGSError(end.text)
        return f"{job.name}: training goes on"


class FASTGS_OT_train_stop(_JobOperator, bpy.types.Operator):
    """Save the run, end its process and let the next job begin; it can be resumed later"""

    bl_idname = "fastgs.train_stop"
    bl_label = "Stop"

    def act(self, context, known, job, state):
        if state.kind in ('FINISHED', 'FAILED', 'STOPPED'):
            raise FastGSError(f"{job.name} has ended already.")
        known.ask(job, 'STOP')
        return f"{job.name}: saving and stopping"


class FASTGS_OT_train_forget(_JobOperator, bpy.types.Operator):
    """Take an ended job off the list; its folder stays"""

    bl_idname = "fastgs.train_forget"
    bl_label = "Remove from List"

    def act(self, context, known, job, state):
        if state.running:
            raise FastGSError(f"{job.name} is running; stop it first.")
        known.forget(job)


class FASTGS_OT_train_import(_JobOperator, bpy.types.Operator):
    """Add the run's model to the scene, aligned with the cameras that it came from: the finished one, or the one so far"""

    bl_idname = "fastgs.train_import"
    bl_label = "View Model"

    def act(self, context, known, job, state):
        if context.mode != 'OBJECT':
            bpy.ops.object.mode_set(mode='OBJECT')
        path = Path(job.out) / jobs.MODEL
        so_far = state.kind != 'FINISHED'
        if so_far:
            from ..fastgs_blender.training.run.intermediate import write_model

            path = write_model(job.out)
        obj = add_model(context, job, path)
        return f"{obj.name}: {obj.fastgs.gaussian_count} Gaussians{' so far' if so_far else ''}"


class FASTGS_OT_train_check(bpy.types.Operator):
    """Look for what would keep training from working: the Python, the capture's poses, pictures and synchronisation, disk, memory"""

    bl_idname = "fastgs.train_check"
    bl_label = "Check"

    capture: StringProperty(name="Capture", description="The capture's folder; the panel's unless given", subtype='DIR_PATH',
                            options={'SKIP_SAVE'})

    def invoke(self, context, event):
        """Look in a thread, so that Blender goes on meanwhile."""
        try:
            work = self._work(context)
        except FastGSError as error:
            return self._tell(error)
        self._thread = threading.Thread(target=self._run, args=(work,), daemon=True)
        self._thread.start()
        self._timer = context.window_manager.event_timer_add(0.2, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("Checking the training Python and the capture")
        return {'RUNNING_MODAL'}

    def modal(self, context, event):
        if event.type != 'TIMER' or self._thread.is_alive():
            return {'PASS_THROUGH'}
        self.cancel(context)
        watch.redraw()
        return self._tell(self._found)

    def cancel(self, context):
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def execute(self, context):
        try:
            self._run(self._work(context))
        except FastGSError as error:
            self._found = error
        return self._tell(self._found)

    def _work(self, context):
        """What to do without Blender's data: a function that returns Facts."""
        path = bpy.path.abspath(self.capture or context.scene.fastgs.training.capture).rstrip("/\\")
        return partial(checks.inspect, store.python(), path)

    def _run(self, work):
        try:
            self._found = work()
        except FastGSError as error:
            self._found = error
        except Exception as error:  # in a thread nobody else would tell
            self._found = FastGSError(f"the capture could not be looked at ({error}).")

    def _tell(self, found):
        """Report Facts, or the error there was instead."""
        if isinstance(found, FastGSError):
            self.report({'ERROR'}, sentence(found))
            return {'CANCELLED'}
        for problem in found.problems:
            self.report({'WARNING'}, sentence(problem))
        if found.problems:
            self.report({'ERROR'}, f"{len(found.problems)} problems: {'; '.join(found.problems[:4])}")
            return {'CANCELLED'}
        self.report({'INFO'}, found.text)
        return {'FINISHED'}


class FASTGS_OT_train_report(_JobOperator, bpy.types.Operator):
    """Write what came of a run into a text: quality in the held-out views, size, time, settings"""

    bl_idname = "fastgs.train_report"
    bl_label = "Report"

    def act(self, context, known, job, state):
        try:
            values = json.loads((Path(job.out) / jobs.REPORT).read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise FastGSError(f"{job.out}: there is no report yet; it comes when training has finished.") from error
        text = bpy.data.texts.get("FAST-GS Report") or bpy.data.texts.new("FAST-GS Report")
        text.use_fake_user = False
        text.from_string(report_text(job, values))
        return f"The report is in the text {text.name}"


def report_text(job, values: dict) -> str:
    """A run's report as lines."""
    rows = [("Model", values["model"]), ("Gaussians", values["gaussians"]), ("Size", f"{values['model_bytes'] / 1e6:.2f} MB"),
            ("Steps", values["iterations"]), ("Time", watch.duration(values["seconds"]))]
    if values.get("held_out_psnr") is not None:
        rows += [("Held-out views", ", ".join(values["held_out_views"])), ("Held-out PSNR", f"{values['held_out_psnr']:.2f} dB")]
    if values.get("held_out_foreground_psnr") is not None:
        rows.append(("of the foreground", f"{values['held_out_foreground_psnr']:.2f} dB"))
    picture = watch.newest_preview(job)
    if picture is not None:
        rows.append(("Model beside truth", picture))
    rows += [("", ""), *sorted(values["settings"].items())]
    return "\n".join(f"{name:<20} {value}".rstrip() for name, value in rows) + "\n"


CLASSES = (
    FASTGS_OT_train,
    FASTGS_OT_train_pause,
    FASTGS_OT_train_resume,
    FASTGS_OT_train_stop,
    FASTGS_OT_train_forget,
    FASTGS_OT_train_import,
    FASTGS_OT_train_check,
    FASTGS_OT_train_report,
)
