# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts training runs, and checks beforehand whether training can work."""
import os
import sys
import time
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..fastgs_blender.jobs import checks
from ..fastgs_blender.training.core import costs
from ..fastgs_blender.training.run.files import MODEL
from ..fastgs_blender.util.errors import FastGSError
from ..fastgs_blender.util.screen import tell
from ..scene import devices, paths
from ..scene.background import in_background
from ..scene.settings import BLEND_RELATIVE
from ..scene.training import alignment, folders, installation, plates, results, watch
from ..scene.training.options import EXISTING, TrainingOptions, arguments
from .action import Action
from .stepwise import REPORT_EVERY, Stepwise

FROM_PANEL = (*TrainingOptions.__annotations__, "existing", "import_result")
"""The options that a press of the button takes from the panel."""


class FASTGS_OT_train(Action, TrainingOptions, bpy.types.Operator):
    """Train a model from a capture in a separate process, which continues when Blender is closed. Options not given are the panel's"""

    bl_idname = "fastgs.train"
    bl_label = "Train"
    bl_options = {'REGISTER'}

    start_frame: IntProperty(name="Start Frame", description="Scene frame of the capture's first frame; by default the scene's first frame")
    existing: EnumProperty(
        name="Existing Run", description="What to do if the folder contains a run already", items=EXISTING, default='REFUSE')
    hide_originals: BoolProperty(
        name="Hide Originals", description="Hide the objects that the capture was filmed from once the model is in the scene",
        default=False, options={'SKIP_SAVE'})
    import_result: BoolProperty(name="Import When Done", description="Add the finished model to the scene", default=True)
    wait: BoolProperty(name="Wait", description="Return only when training has ended; the default without a window", default=False)

    def invoke(self, context, event):
        self.fill(**{name: getattr(context.scene.fastgs.training, name) for name in FROM_PANEL})
        if self.source == 'SCENE' and self.existing != 'RESUME':
            return self._capture_first(context)
        return self.execute(context)

    def act(self, context):
        job = self._job(context, self._place())
        if self.wait or (bpy.app.background and not self.properties.is_property_set("wait")):
            return self._run(context, job)
        known = installation.jobs()
        known.start_next()
        watch.begin()
        state = known.state(known.get(job.id))
        if state.kind == 'FAILED':
            raise FastGSError(state.text)
        return f"{job.name}: training {'waits for its turn' if state.kind == 'QUEUED' else 'has begun'}"

    def _place(self):
        """Where the results go.  Raises FastGSError where that cannot be."""
        place = folders.place(self.out, self.existing)
        if place.trouble:
            raise FastGSError(place.trouble)
        return place

    def _capture_first(self, context):
        try:  # what is wrong with these would make filming useless
            installation.python()
            self._place()
            done = bpy.ops.fastgs.capture_scene('INVOKE_DEFAULT', train=True)
        except (FastGSError, RuntimeError) as error:  # Blender's own begins with a word of its own
            return self.fail(str(error).strip().removeprefix("Error: "))
        return {'CANCELLED'} if 'CANCELLED' in done else {'FINISHED'}  # the capture continues by itself

    def _job(self, context, place):
        """The job of the run that was asked for, in the queue: a new one, or the one that is on the list and continues."""
        if place.existing == "--resume":
            known = installation.jobs()
            before = next((job for job in known.all() if job.out == place.out), None)
            if before is not None:
                known.ask(before, 'QUEUED')
                return before
        return self._add(context, place)

    def _add(self, context, place):
        scene = context.scene
        self.fill(start_frame=scene.frame_start)
        python, capture = installation.python(), self._capture(context, place)
        pixels, views, frames = checks.picture_size(capture)
        pixels = costs.trained_pixels(self.preset, pixels, self.scale)
        size = costs.size_of(self.preset, self.iterations, self.max_gaussians, pixels * views, frames)
        _, memory = costs.estimate(pixels, *size, views * frames)
        for remark in checks.before_start(place.out, memory):
            self.warn(remark)
        resumed = place.existing == "--resume"
        options = ["--device", devices.wanted(scene)] + ([] if resumed else arguments(self))  # a run continues with its own
        about = {"blend": bpy.data.filepath, "process": os.getpid(), "start_frame": self.start_frame, "import": self.import_result,
                 "hide": self.hide_originals, "world": alignment.world_of(scene, capture)}
        return installation.jobs().add(place.out, capture, python, options, about, place.existing)

    def _capture(self, context, place) -> str:
        """The capture's folder; that of the scene's own cameras is written first.  Raises FastGSError."""
        if place.capture:
            return place.capture
        if self.source == 'SCENE':
            raise FastGSError("Capture the scene first, with fastgs.capture_scene, and train on its folder.")
        if self.source == 'CAMERAS':
            return plates.write_capture(context, Path(place.out) / "capture")
        return installation.capture_path(self.capture)

    def _run(self, context, job):
        """Start the job at once and wait until it has ended."""
        known = installation.jobs()
        try:
            known.start(job)
            printed = time.monotonic()
            while (state := known.state(job)).running:
                time.sleep(0.2)
                if time.monotonic() - printed > REPORT_EVERY:
                    printed = time.monotonic()
                    tell(f"FAST-GS: {progress(job, state)}", sys.stdout)
        except KeyboardInterrupt:
            known.ask(job, 'PAUSE')
            raise
        except FastGSError as error:
            known.fail(job, error)
            raise
        known.report_end(job)
        watch.refresh()
        if state.kind != 'FINISHED':
            raise FastGSError(state.text)
        tell(f"FAST-GS: {job.name} {watch.summary(state)}", sys.stdout)
        if self.import_result:
            results.add_finished(context, job)
        return f"{job.name}: {watch.summary(state)}; {Path(job.out) / MODEL}"


def progress(job, state) -> str:
    """One line about a running job."""
    values = state.values
    text = f"{job.name}: {state.text.lower()}"
    if values.get("iteration"):
        text += f", step {values['iteration']} of {values['iterations']}"
    if values.get("psnr"):
        text += f", {values['psnr']:.1f} dB"
    if state.seconds_left:
        text += f", {results.duration(state.seconds_left)} left"
    return text


class FASTGS_OT_train_check(Stepwise, bpy.types.Operator):
    """Read what the capture holds (cameras, frames, sizes of pictures) and whether all its files are there, for the estimate of the time"""

    bl_idname = "fastgs.train_check"
    bl_label = "Read Capture"
    doing, free, interrupted = "Reading the capture", True, "{} was interrupted"

    capture: StringProperty(name="Capture", description="The capture's folder; by default the panel's", subtype='DIR_PATH',
                            options={'SKIP_SAVE'} | BLEND_RELATIVE)

    def steps(self, context):
        path, python = paths.bare(bpy.path.abspath(self.capture or context.scene.fastgs.training.capture)), installation.python()
        return in_background(lambda _: checks.inspect(python, path), cancel=False)

    def finish(self, context, found):
        watch.redraw()
        for problem in found.problems:
            self.warn(problem)
        if found.problems:
            raise FastGSError(f"{len(found.problems)} problems: {'; '.join(found.problems[:4])}")
        return found.text
