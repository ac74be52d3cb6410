# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on the list of training runs: pause, resume, stop, remove, and bring models and reports into Blender."""
import time

import bpy
from bpy.props import BoolProperty, StringProperty

from ..fastgs_blender.util.errors import FastGSError
from ..scene.training import displays, installation, results, watch
from .action import Action, Need, keep_text
from .stepwise import PAUSE, Stepwise

REPORT_WIDTH, REPORT_PICTURE = 460, 10.0
"""Width of the report's dialog in pixels, and height of its picture in rows of text."""


class _JobOperator(Action):
    """Base class of operators on one job: the job with the given id, else the panel's."""

    bl_options = {'REGISTER'}
    needs = (Need(lambda context: watch.current() is not None, "There is no training job"),)
    job: StringProperty(name="Job", description="The job's id; empty: the job that the panel shows", options={'HIDDEN', 'SKIP_SAVE'})

    def found(self):
        """(Jobs, Job, State) now."""
        known = installation.jobs()
        row = watch.current()
        job = known.get(self.job or row[0].id)
        if job is None:
            raise FastGSError("this training job is not on the list any more.")
        return known, job, known.state(job)

    def invoke(self, context, event):
        try:
            return self.ask(context, event, *self.found())
        except FastGSError as error:
            return self.fail(error)

    def ask(self, context, event, known, job, state) -> set[str]:
        """What to do at the press of the button."""
        return self.execute(context)

    def act(self, context):
        done = self.do(context, *self.found())
        watch.begin()
        watch.redraw()
        return done

    def do(self, context, known, job, state) -> str | None:
        """act(), for a job."""
        raise NotImplementedError


class FASTGS_OT_train_pause(_JobOperator, bpy.types.Operator):
    """Save the run and end its process; waiting jobs do not start until it is resumed or stopped"""

    bl_idname = "fastgs.train_pause"
    bl_label = "Pause"

    def do(self, context, known, job, state):
        if not state.running and state.kind != 'QUEUED':
            raise FastGSError(f"{job.name} is not running.")
        known.ask(job, 'PAUSE')
        return f"{job.name}: saving and pausing"


class FASTGS_OT_train_resume(_JobOperator, bpy.types.Operator):
    """Continue a run that was paused, was stopped, or has failed"""

    bl_idname = "fastgs.train_resume"
    bl_label = "Resume"

    wait: BoolProperty(name="Wait", description="Return only when training has ended", default=False, options={'SKIP_SAVE'})

    def do(self, context, known, job, state):
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

    def do(self, context, known, job, state):
        if state.kind in ('FINISHED', 'FAILED', 'STOPPED'):
            raise FastGSError(f"{job.name} has ended already.")
        known.ask(job, 'STOP')
        return f"{job.name}: saving and stopping"


class FASTGS_OT_train_forget(_JobOperator, bpy.types.Operator):
    """Take an ended job off the list; its folder stays"""

    bl_idname = "fastgs.train_forget"
    bl_label = "Remove from List"

    def ask(self, context, event, known, job, state):
        return context.window_manager.invoke_confirm(
            self, event, title=f"Take {job.name} off the list of runs?", message=f"Its folder stays: {job.out}", confirm_text="Remove")

    def do(self, context, known, job, state):
        known.forget(job)


class FASTGS_OT_train_import(Stepwise, _JobOperator, bpy.types.Operator):
    """Add the run's model to the scene, aligned with its cameras; of an unfinished run, the model of the last checkpoint"""

    bl_idname = "fastgs.train_import"
    bl_label = "View Model"
    bl_options = {'REGISTER', 'UNDO'}
    doing, free, interrupted = "Reading the model", True, "{} was interrupted"

    def steps(self, context):
        _, self._job, state = self.found()
        self._finished = state.kind == 'FINISHED'
        return _read(results.Reading(self._job.out, self._finished))

    def finish(self, context, path):
        obj = results.add_finished(context, self._job) if self._finished else results.add_model(context, self._job, path)
        watch.begin()
        watch.redraw()
        return f"{obj.name}: {obj.fastgs.gaussian_count:,} Gaussians{'' if self._finished else ' so far'}"


def _read(reading):
    """Yields until a model has been read; returns its file."""
    while not reading.done:
        time.sleep(PAUSE)
        yield 0.0
    return reading.path


class FASTGS_OT_train_report(_JobOperator, bpy.types.Operator):
    """Show the run's quality in the held-out views, its picture beside the truth, size, time and settings; OK keeps it as a text"""

    bl_idname = "fastgs.train_report"
    bl_label = "Report"

    show_settings: BoolProperty(name="Settings", description="Show the run's settings", default=False, options={'SKIP_SAVE'})

    def ask(self, context, event, known, job, state):
        self._report = results.report_of(job)
        self._icons = displays.icons_of(self._report.picture) if self._report.picture else []
        self.job = job.id
        return context.window_manager.invoke_props_dialog(
            self, width=REPORT_WIDTH, title=f"Report of {job.name}", confirm_text="Keep as Text")

    def check(self, context):
        return True  # the settings are shown or hidden at once

    def draw(self, context):
        layout = self.layout
        rows_of(layout, self._report.numbers)
        row = layout.row()
        for name, icon in zip(("Model", "Truth"), self._icons):
            col = row.column(align=True)
            col.template_icon(icon_value=icon, scale=REPORT_PICTURE)
            col.label(text=name)
        row = layout.row()
        row.alignment = 'LEFT'
        row.prop(self, "show_settings", icon='TRIA_DOWN' if self.show_settings else 'TRIA_RIGHT', emboss=False)
        if self.show_settings:
            rows_of(layout, self._report.settings)

    def do(self, context, known, job, state):
        return f"The report is in the text {keep_text(context, 'FAST-GS Report', results.report_of(job).text)}"


def rows_of(layout, rows):
    """Draw pairs of text in two columns."""
    col = layout.column(align=True)
    for name, value in rows:
        split = col.split(factor=0.3)
        split.label(text=name)
        split.label(text=value)
