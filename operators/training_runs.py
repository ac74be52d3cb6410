# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on the list of training runs: pause, resume, stop, remove, and bring models and reports into Blender."""
from __future__ import annotations

import time
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from ..fastgs_blender.training.run.files import MODEL
from ..fastgs_blender.util.errors import FastGSError
from ..scene.splats.splat_object import sentence
from ..scene.training import installation, results, watch


class _JobOperator:
    """Base class of operators on one job: the job with the given id, else the panel's."""

    job: StringProperty(name="Job", description="The job's id; empty: the job that the panel shows", options={'HIDDEN', 'SKIP_SAVE'})

    @classmethod
    def poll(cls, context):
        if watch.current() is None:
            cls.poll_message_set("There is no training job")
        return watch.current() is not None

    def found(self):
        """(Jobs, Job, State) now."""
        known = installation.jobs()
        row = watch.current()
        job = known.get(self.job or row[0].id)
        if job is None:
            raise FastGSError("this training job is not on the list any more.")
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
    """Save the run and end its process; waiting jobs do not start until it is resumed or stopped"""

    bl_idname = "fastgs.train_pause"
    bl_label = "Pause"

    def act(self, context, known, job, state):
        if not state.running and state.kind != 'QUEUED':
            raise FastGSError(f"{job.name} is not running.")
        known.ask(job, 'PAUSE')
        return f"{job.name}: saving and pausing"


class FASTGS_OT_train_resume(_JobOperator, bpy.types.Operator):
    """Continue a run that was paused, was stopped, or has failed"""

    bl_idname = "fastgs.train_resume"
    bl_label = "Resume"

    wait: BoolProperty(name="Wait", description="Return only when training has ended", default=False, options={'SKIP_SAVE'})

    def act(self, context, known, job, state):
        if state.running or state.kind in ('QUEUED', 'FINISHED'):
            raise FastGSError(f"{job.name} cannot be resumed now; its state is: {state.text.lower()}.")
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
        return f"{job.name}: training continues"


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
        known.forget(job)


class FASTGS_OT_train_import(_JobOperator, bpy.types.Operator):
    """Add the run's model to the scene, aligned with its cameras; of an unfinished run, the model of the last checkpoint"""

    bl_idname = "fastgs.train_import"
    bl_label = "View Model"

    def act(self, context, known, job, state):
        path = Path(job.out) / MODEL
        so_far = state.kind != 'FINISHED'
        if so_far:
            from ..fastgs_blender.training.run.intermediate import write_model

            path = write_model(job.out)
        obj = results.add_model(context, job, path)
        return f"{obj.name}: {obj.fastgs.gaussian_count} Gaussians{' so far' if so_far else ''}"


class FASTGS_OT_train_report(_JobOperator, bpy.types.Operator):
    """Write the run's report into a text: quality in the held-out views, size, time, settings"""

    bl_idname = "fastgs.train_report"
    bl_label = "Report"

    def act(self, context, known, job, state):
        text = bpy.data.texts.get("FAST-GS Report") or bpy.data.texts.new("FAST-GS Report")
        text.use_fake_user = False
        text.from_string(results.report_text(job))
        return f"The report is in the text {text.name}"


CLASSES = (
    FASTGS_OT_train_pause,
    FASTGS_OT_train_resume,
    FASTGS_OT_train_stop,
    FASTGS_OT_train_forget,
    FASTGS_OT_train_import,
    FASTGS_OT_train_report,
)
