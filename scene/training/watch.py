# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks at the training jobs once a second: starts the next one, shows pictures and logs, says when one has ended and adds its model."""
import logging
import os

import bpy

from ...fastgs_blender.jobs.job import Job, State
from ...fastgs_blender.util.errors import FastGSError
from .. import notices
from . import displays, installation, results

log = logging.getLogger(__name__)
EVERY = 1.0
SOON = 0.1
"""Seconds between two looks while a model is being read."""
SETTLED = 0.4
"""Seconds after which panels that moved stand still."""

_found: list[tuple[Job, State]] | None = None
_readings: list[tuple[Job, results.Reading]] = []
"""Of models that are to be added to the scene."""


def found() -> list[tuple[Job, State]]:
    """The jobs and their states when the queue was last read."""
    return refresh() if _found is None else _found


def refresh() -> list[tuple[Job, State]]:
    """Read the jobs and their states now."""
    global _found
    known = installation.jobs()
    _found = [(job, known.state(job)) for job in known.all()]
    return _found


def ordered() -> list[tuple[Job, State]]:
    """The jobs as the panel lists them: the running one, those that wait or are paused in their order, the others from the newest on."""
    rows = found()
    running = [row for row in rows if row[1].running]
    waiting = [row for row in rows if row[1].kind in ('PAUSED', 'QUEUED')]
    return running + waiting + [row for row in reversed(rows) if row not in running and row not in waiting]


def current() -> tuple[Job, State] | None:
    """The first job as the panel lists them, with its state; None without any."""
    return next(iter(ordered()), None)


def begin() -> None:
    """Start a timer that looks at the jobs until none is running or waiting."""
    refresh()
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=EVERY, persistent=True)


def _tick():
    try:
        return _poll()
    except Exception:  # a timer that raises is never called again
        log.exception("Looking at the training jobs failed")
        return 10 * EVERY


def _poll():
    known = installation.jobs()
    known.start_next(patience=0.0)  # another Blender that changes the list will have started it by the next look
    before = _found
    rows = refresh()
    for job, state in rows:
        if state.running:
            displays.update(job)
        elif state.kind in ('FINISHED', 'FAILED') and not job.reported and known.report_end(job):
            displays.update(job)
            report_end(job, state)
    _add_models()
    if before != rows:
        redraw()
    busy = any(state.running or state.kind == 'QUEUED' for _, state in rows)
    return SOON if _readings else EVERY if busy else None


def report_end(job: Job, state: State) -> None:
    """Report that a job has ended, and let its model be read, where it is to be added to the scene from which it was started."""
    good = state.kind == 'FINISHED'
    text = f"{job.name}: {summary(state) if good else state.text}"
    log.log(logging.INFO if good else logging.ERROR, text)
    window = next(iter(bpy.context.window_manager.windows), None)
    if window is None:
        return
    if good and job.scene.get("import") and belongs_here(job):
        _readings.append((job, results.Reading(job.out, True)))
    with bpy.context.temp_override(window=window):
        if not bpy.app.background:
            bpy.context.window_manager.popup_menu(
                lambda menu, context: menu.layout.label(text=text), title="Training has finished" if good else "Training has failed",
                icon='INFO' if good else 'ERROR')


def _add_models() -> None:
    """Add the models that have been read by now to the scene."""
    for row in [row for row in _readings if row[1].done]:
        _readings.remove(row)
        job, reading = row
        window = next(iter(bpy.context.window_manager.windows), None)
        if window is None or not belongs_here(job):  # another file has been opened meanwhile
            continue
        with bpy.context.temp_override(window=window):
            try:
                reading.path  # noqa: B018  what went wrong
                results.add_finished(bpy.context, job)
                bpy.ops.ed.undo_push(message="Add Trained Model")
            except (RuntimeError, FastGSError) as error:  # of a mode in which nothing can be added; the panel has a button
                log.warning("%s: its model was not added: %s", job.name, error)


def belongs_here(job: Job) -> bool:
    """Whether a job was started from the open file; for an unsaved file, whether this Blender started it."""
    return job.scene.get("blend") == bpy.data.filepath and (bool(bpy.data.filepath) or job.scene.get("process") == os.getpid())


def summary(state: State) -> str:
    """One line about the result of a finished job."""
    psnr = state.values.get("held_out_psnr")
    return f"finished{f', {psnr:.2f} dB in the held-out views' if psnr else ''}"


def redraw() -> None:
    """The panels and the status bars of all windows, and once more: panels that grow are put in their places one redraw later."""
    _redraw()
    if not bpy.app.background and not bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.register(_redraw, first_interval=SETTLED)


def _redraw() -> None:
    notices.redraw('VIEW_3D', 'IMAGE_EDITOR', 'TEXT_EDITOR')
    for window in bpy.context.window_manager.windows:
        if not len(window.modal_operators):  # clears no other operator's text; and nothing else redraws a status bar
            window.workspace.status_text_set(None)


def line() -> str:
    """One line about the job that is running, "" where there is none."""
    row = current()
    if row is None or not row[1].running:
        return ""
    job, state = row
    left = state.seconds_left
    return f"{job.name}: {state.text.lower()} {100 * state.share:.0f} %{f', {results.duration(left)} left' if left else ''}"


def register():
    global _found
    _found = None
    if not bpy.app.background:
        bpy.app.timers.register(_tick, first_interval=EVERY, persistent=True)


def unregister():
    global _found
    _found = None
    _readings.clear()
    for timer in (_tick, _redraw):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    displays.unregister()
    installation.unregister()
