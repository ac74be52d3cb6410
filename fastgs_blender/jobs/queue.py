# SPDX-License-Identifier: GPL-3.0-or-later
"""The queue of training jobs: each job is a folder for its results and a process that outlives Blender.  No bpy here.

A small JSON file for each job in the extension's user folder lets any later Blender, or several at once, find it again:

    jobs/ID.json     the job
    jobs/ID.lock     held by its process while it lives
    jobs/ID.stop     asks its process to save and stop
    jobs/queue.lock  held by whoever changes the list, for the moment that this takes
    OUT/             what `fastgs train` writes (training/run/files.py), and console.log, what its process printed
"""
import contextlib
import json
import logging
import math
import os
import secrets
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

from ..training.run.files import CONSOLE, LOCK, RUN, STATUS
from ..util import locks
from ..util.errors import FastGSError, printable_lines
from ..util.outputs import appending, replacing
from ..util.reading import open_file
from . import causes
from .command import command_line
from .environment import environment
from .job import ENDED, LATEST, RUNNING, Job, State, read_job, read_status
from .places import place_for

log = logging.getLogger(__name__)
QUEUE_LOCK = "queue.lock"
PATIENCE = 30.0
"""Seconds to wait for another Blender that changes the list, which takes it milliseconds.  Only a guard against one that hangs."""
GRACE = 60.0 if os.name == "nt" else 0.0
"""Seconds that a process started by another Blender may take to hold its lock; elsewhere than on Windows it is born with it."""


class Jobs:
    """The training jobs of a user.

    folder  where their files are
    clock   gives the time in seconds of the epoch
    """

    _children: dict[str, tuple[float, subprocess.Popen]] = {}
    """By job: when this program started its process, and the process."""
    _passed_over: set[str] = set()
    _turn = threading.RLock()

    def __init__(self, folder: str | Path, clock: Callable[[], float] = time.time) -> None:
        self.folder, self.clock = Path(folder), clock

    def all(self) -> list[Job]:
        """The jobs, the oldest first; a file that holds no valid job is skipped, with a note in the log."""
        found = [self._read(path) for path in self.folder.glob("*.json")] if self.folder.is_dir() else []
        return sorted((job for job in found if job), key=lambda job: (job.created, job.id))

    def get(self, name: str) -> Job | None:
        """The job of that id."""
        return self._read(self._file(name))

    def add(self, out: str | Path, capture: str | Path, python: str, options: Sequence[str] = (), scene: dict | None = None,
            existing: str = "") -> Job:
        """Put a new job at the end of the queue; the arguments are Job's.

        Raises FastGSError where another job has that folder, or where a run is in it and `existing` does not say what becomes of it.
        """
        out = str(Path(out).absolute())
        with self._changing():
            others = self.all()
            for other in others:
                if other.out == out:
                    if self.state(other).kind not in ENDED:
                        raise FastGSError(f"{out} belongs to a training job that has not ended; choose another folder, or stop that job "
                                          "first.")
                    _refuse_another_run(out, existing)
                    self._remove(other)
            _refuse_another_run(out, existing)
            latest = max((other.created for other in others), default=0.0)
            created = min(max(self.clock(), math.nextafter(latest, math.inf)), LATEST)  # in order, whatever the clock does
            job = Job(self._new_id(created), out, str(capture), python, list(options), scene=scene or {}, created=created,
                      existing=existing)
            self._save(job)
        return job

    def forget(self, job: Job) -> None:
        """Take a job off the list; its folder stays.  Raises FastGSError where its process lives and has not finished."""
        with self._changing():
            if self.state(job).running:
                raise FastGSError(f"{job.name} is running; stop it first.")
            self._remove(job)

    def start(self, job: Job) -> None:
        """Start its process, which continues the run.  Raises FastGSError where that is impossible."""
        with self._changing():
            try:
                self._start(job)
            except FastGSError as error:
                with contextlib.suppress(FastGSError):
                    self._change(job, request="RUN", problem=str(error))
                raise

    def start_next(self, patience: float = PATIENCE) -> Job | None:
        """Start the first waiting job, unless one is running or paused; returns it.

        One that cannot start fails with the reason, and the next one is tried.  patience: seconds to wait for another Blender that
        changes the list; None is returned if it takes longer.
        """
        try:
            with self._changing(patience):
                jobs = self.all()
                kinds = [self.state(job).kind for job in jobs]
                if any(kind in RUNNING or kind == 'PAUSED' for kind in kinds):
                    return None
                for job, kind in zip(jobs, kinds):
                    if kind == 'QUEUED':
                        try:
                            self._start(job)
                        except FastGSError as error:
                            self._change(job, request="RUN", problem=str(error))
                            continue
                        return job
        except _Busy:
            pass
        return None

    def ask(self, job: Job, request: str) -> None:
        """Request PAUSE or STOP: its process, if it lives, saves and ends; QUEUED: the run continues when its turn comes."""
        with self._changing():
            queued = request == "QUEUED"
            self._change(job, request=request, **({"reported": False, "problem": ""} if queued else {}))
            if not queued and self.alive(job):
                self._file(job.id, ".stop").touch()

    def fail(self, job: Job, error: Exception) -> None:
        """Record why a job could not start."""
        with self._changing():
            self._change(job, request="RUN", problem=str(error))

    def report_end(self, job: Job) -> bool:
        """Record that the user has been informed of a job's end; False if that was done before, or if the job has been started again."""
        with self._changing():
            now = self.get(job.id)
            if now is None or now.reported or now.started != job.started:
                return False
            self._change(job, reported=True)
        return True

    def alive(self, job: Job) -> bool:
        """Whether its process lives, whoever started it."""
        if locks.is_locked(self._file(job.id, ".lock")):
            return True
        child = self._child(job)
        if child is not None:
            return child.poll() is None  # where there are no locks, or it does not hold it yet
        return 0 <= self.clock() - job.started < GRACE and not (Path(job.out) / STATUS).exists()

    def state(self, job: Job) -> State:
        """The state of a job.  A process that ended without a final status has crashed; its output then gives the reason."""
        alive = self.alive(job)  # asked first: what a process writes before it ends is then known
        values = read_status(Path(job.out) / STATUS) if job.started else {}  # before that, it tells of an earlier run in this folder
        status = values.get("state")
        if status == "finished":  # its process may still be clearing up
            return State('FINISHED', "Finished", values)
        if alive:
            if job.request in ("PAUSE", "STOP"):
                return State('STOPPING', "Saving", values)
            if status in ("preparing", "training"):
                return State(status.upper(), _preparing(values) if status == "preparing" else "Training", values)
            return State('STARTING', "Starting", {})
        if job.request == "QUEUED":
            return State('QUEUED', "Waiting for its turn", values)
        if status == "stopped" or (status is None and job.request in ("PAUSE", "STOP")):
            stopped = job.request == "STOP"
            return State('STOPPED' if stopped else 'PAUSED', "Stopped" if stopped else "Paused", values)
        child = self._child(job)
        reason = job.problem or (values.get("reason") if status == "failed" else None)
        code = None if job.problem or child is None else child.returncode
        return State('FAILED', causes.sentence(reason, "" if job.problem else self.console_end(job), code, job.out), values)

    def console_end(self, job: Job, limit: int = 20_000) -> str:
        """The end of what its last process printed."""
        with contextlib.suppress(OSError, FastGSError), open_file(Path(job.out) / CONSOLE) as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(min(job.console, file.tell()), file.tell() - limit))
            return printable_lines(file.read(limit).decode(errors="replace"))
        return ""

    def command(self, job: Job, more: Sequence[str] = ()) -> list[str]:
        """The command line of its process."""
        return command_line(job.python, ["train", job.capture, "--out", job.out, *job.options, *more], str(self._file(job.id, ".lock")),
                            str(self._file(job.id, ".stop")))

    def _start(self, job: Job) -> None:
        if self.alive(job):
            return
        out = Path(job.out)
        with self._take(job) as lock:
            if locks.is_locked(out / LOCK):
                raise FastGSError(f"{out}: another process is training in this folder; wait until it has ended, or choose another folder.")
            if not job.started:
                _refuse_another_run(out, job.existing)
            begun = job.begun or (job.started > 0 and (out / STATUS).exists())
            try:
                out.mkdir(parents=True, exist_ok=True)
                (out / STATUS).unlink(missing_ok=True)  # that of an earlier process says nothing about this one
                self._file(job.id, ".stop").unlink(missing_ok=True)
                console = appending(out / CONSOLE)
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                raise FastGSError(f"{out}: the training job cannot write there ({reason}); choose another folder.") from error
            with console:
                there = ["--resume"] if (out / RUN).exists() else []
                more = ["--overwrite"] if job.existing == "--overwrite" and not begun else there
                self._change(job, console=os.fstat(console.fileno()).st_size, request="RUN", reported=False, problem="",
                             started=self.clock(), begun=begun)
                inherited, variables = locks.handed_over(lock)
                try:
                    child = subprocess.Popen(
                        self.command(job, more), stdin=subprocess.DEVNULL, stdout=console, stderr=subprocess.STDOUT, cwd=out,
                        env=environment(job.python) | variables, **inherited, **_detached())
                except (OSError, ValueError) as error:
                    reason = getattr(error, "strerror", None) or error
                    raise FastGSError(f"{job.python}: the training Python does not start ({reason}); choose another in the "
                                      "preferences.") from error
            self._children[job.id] = job.started, child

    def _take(self, job: Job) -> BinaryIO:
        """The job's lock, held by this program until it is closed."""
        try:
            lock = locks.acquire(self._file(job.id, ".lock"), PATIENCE)
        except locks.NoLocks:
            return open(os.devnull, "rb")
        except OSError as error:
            raise self._unwritable(error) from error
        if lock is None:
            raise FastGSError(f"{job.name} is being started by another Blender.")
        return lock

    def _child(self, job: Job) -> subprocess.Popen | None:
        """The job's process, if this program was the one that started it last."""
        started, child = self._children.get(job.id, (None, None))
        return child if started == job.started else None

    def _new_id(self, created: float) -> str:
        """A new unique id: its lock file is created here exclusively, so that no other process can get the same."""
        while True:
            name = f"{created:.3f}-{os.getpid()}-{secrets.token_hex(4)}"
            try:
                self._file(name, ".lock").touch(exist_ok=False)
            except FileExistsError:
                continue
            except OSError as error:
                raise self._unwritable(error) from error
            return name

    def _change(self, job: Job, **values: Any) -> None:
        """Set some values in a job's file and read the others from it, as another process may have changed them."""
        now = self.get(job.id)
        if now is None:
            raise FastGSError(f"{job.name} is not on the list of training jobs any more.")
        vars(job).update({**vars(now), **values})
        self._save(job)

    def _save(self, job: Job) -> None:
        try:
            with replacing([self._file(job.id)]) as (part,):
                part.write_text(json.dumps(asdict(job), indent=1, allow_nan=False), "utf-8")
        except OSError as error:
            raise self._unwritable(error) from error

    def _remove(self, job: Job) -> None:
        for suffix in (".json", ".lock", ".stop"):
            with contextlib.suppress(PermissionError):  # Windows, where a process that has finished still holds its lock
                self._file(job.id, suffix).unlink(missing_ok=True)
        self._children.pop(job.id, None)

    @contextlib.contextmanager
    def _changing(self, patience: float = PATIENCE) -> Iterator[None]:
        """Context manager that locks the list: neither another Blender nor another thread changes it meanwhile."""
        with self._turn:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                lock: contextlib.AbstractContextManager | None = locks.acquire(self.folder / QUEUE_LOCK, patience)
            except locks.NoLocks:  # a file system without them
                lock = contextlib.nullcontext()
            except OSError as error:
                raise self._unwritable(error) from error
            if lock is None:
                raise _Busy(f"{self.folder}: another Blender has been changing the list of training jobs for {patience:.0f} seconds; "
                            "close it, then try again.")
            with lock:
                yield

    def _unwritable(self, error: OSError) -> FastGSError:
        return FastGSError(f"{self.folder}: the list of training jobs cannot be written ({error.strerror}); free some space.")

    def _file(self, name: str, suffix: str = ".json") -> Path:
        return self.folder / f"{name}{suffix}"

    def _read(self, path: Path) -> Job | None:
        """The job in a file; None where there is no valid one, with a note in the log, once, if the file exists."""
        try:
            return read_job(path)
        except FastGSError as error:
            if path.exists() and str(path) not in self._passed_over:
                self._passed_over.add(str(path))
                log.warning("%s  This file is skipped.", error)
            return None


def _preparing(values: dict) -> str:
    """What a run does before its first step, and how far it is."""
    if "stage" not in values:
        return "Preparing the pictures"
    share = values.get("stage_share")
    return values["stage"].capitalize() + ("" if share is None else f", {share:.0%}")


def _refuse_another_run(out: str | Path, existing: str) -> None:
    """Raise FastGSError for a folder that holds a run, unless `existing` says what becomes of it."""
    if not existing and (trouble := place_for(str(out), 'REFUSE').trouble):
        raise FastGSError(trouble)


class _Busy(FastGSError):
    """Another program is changing the list."""


def _detached() -> dict:
    """Arguments for Popen with which a process outlives the one that starts it."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}
