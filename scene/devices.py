# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists the GPUs, and chooses the one that renders and trains a scene.

GPUs are tested in a process of their own (jobs/examination.py): a driver that crashes takes no Blender along, and nothing waits for it
but a render that needs to know.
"""
import threading
from collections.abc import Callable

import bpy

from ..fastgs_blender.jobs.examination import Examination
from ..fastgs_blender.util import backends
from ..fastgs_blender.util.verdicts import Verdict, read_verdict
from . import notices, settings

EVERY = 0.2
"""Seconds between two looks at a test."""
_listing: threading.Thread | None = None
_listed: dict | None = None
_examination: Examination | None = None
_reported = False
"""Whether the list has been made anew since the last test."""
_turn = threading.Lock()


def wanted(scene) -> str:
    """The device of a scene, as `--device` takes it."""
    return "cpu" if scene.fastgs.device == 'CPU' else settings.gpu or "auto"


def found() -> dict | None:
    """The GPUs as backends.describe_devices() lists them, with None as the verdict of one that has not been tested; None while they are
    looked for."""
    if _listing is None:
        refresh()
    return _listed


def refresh() -> None:
    """Look for the GPUs and at their verdicts, in a thread.  Where there is a user, what has not been tested is, but for software."""
    global _listing
    _listing = threading.Thread(target=_list, name="FAST-GS GPUs", daemon=True)
    _listing.start()
    _begin_to_watch()


def _list():
    global _listed
    try:
        _listed = backends.describe_devices(test=False)
    except Exception as error:  # noqa: BLE001 (drivers raise anything, and in a thread nobody else would tell)
        _listed = {"devices": [], "auto": None, "reason": f"no GPU can be used ({error}): the CPU is used."}
    untested = next((each["name"] for each in _listed["devices"] if each["self_test"] is None and not each["software"]), None)
    if untested and not bpy.app.background and not trouble():
        with _turn:
            _examine(untested)


def line() -> str:
    """The last remark of a test that is under way, "" where there is none."""
    running = _examination
    return "" if running is None or running.done else running.line


def trouble() -> str:
    """Why the last test could not be done, in a sentence, or ""."""
    return "" if _examination is None or not _examination.done else _examination.trouble


def test() -> Examination:
    """Begin to test all GPUs, those that have been tested too; those that have failed may be used again."""
    with _turn:
        if _examination is None or _examination.done:
            backends.try_again()
        running = _examine("", again=True)
    _begin_to_watch()
    return running


def _examine(part: str, again: bool = False) -> Examination:
    """The examination under way, or a new one."""
    global _examination, _reported
    if _examination is None or _examination.done:
        _examination, _reported = Examination(part, again), False
    return _examination


def backend(device: str, progress: Callable[[float], None] | None = None) -> tuple[str, str]:
    """(the backend's name, why this one or "") of a device as wanted() gives it.

    progress  called again and again while the GPU is being tested, which it is where that has not been done; what it raises passes
              through.  None: what has not been tested is not used
    To be called from any thread.
    """
    def examine(adapter):
        verdict = backends.stored_verdict(adapter)
        if verdict is None and progress is not None:
            verdict = _verdict_of(adapter, progress)
        return verdict

    try:
        return backends.choose_device(device, examine)
    except backends.FastGSError as error:
        return "auto", str(error).removesuffix("; use the device cpu.").rstrip(".") + ": the CPU is used."


def _verdict_of(adapter, progress) -> Verdict | None:
    """The verdict of a test of one adapter."""
    verdict = running = None
    for _ in range(2):  # one that is under way may be another's
        with _turn:
            running = _examine(adapter.name)
        while not running.wait(EVERY):
            progress(0.0)
        told = running.found["devices"] if running.found else ()
        verdict = next((read_verdict(each) for each in told if (each["name"], each["driver"]) == (adapter.name, adapter.driver)), None)
        if verdict is not None:
            return verdict
    return Verdict(running.trouble.rstrip(".")) if running.trouble else None


def _begin_to_watch():
    if not bpy.app.background and not bpy.app.timers.is_registered(_watch):
        bpy.app.timers.register(_watch, first_interval=EVERY, persistent=True)


def _watch():
    """Redraw the preferences and the properties until the list and the test have come to their end."""
    global _reported
    notices.redraw('PREFERENCES', 'PROPERTIES')
    if _listing is not None and _listing.is_alive():
        return EVERY
    if _examination is not None and not _reported:
        if _examination.done:
            _reported = True
            refresh()
        return EVERY
    return None


def unregister():
    global _listing, _listed, _examination
    if bpy.app.timers.is_registered(_watch):
        bpy.app.timers.unregister(_watch)
    if _examination is not None:
        _examination.stop()
    _listing = _listed = _examination = None
