# SPDX-License-Identifier: GPL-3.0-or-later
"""Training jobs: each is a folder for its results and a process that does not end with Blender.  No bpy here.

A small JSON file for each job in the extension's user folder lets any later Blender find it again:

    jobs/ID.json   the job; jobs/ID.lock   held by its process while it lives; jobs/ID.stop   asks it to save and stop
    OUT/           what `fastgs train` writes (status.json, log.jsonl, previews/ ...), and console.log, what it said
"""
from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from ..util.errors import FastGSError
from ..util.locks import is_held
from ..util.outputs import replacing
from . import causes
from .environment import environment

CONSOLE, STATUS, RUN, MODEL, REPORT, PLOT = (
    "console.log", "status.json", "run.json", "model.safetensors", "report.json", "loss.png")
RUNNING = ('STARTING', 'PREPARING', 'TRAINING', 'STOPPING')
ENDED = ('FINISHED', 'FAILED', 'STOPPED')
GRACE = 5.0
"""Seconds that a process has for taking its lock."""
_children: dict[str, subprocess.Popen] = {}


@dataclass
class Job:
    """A training run that was asked for.

    id        of its files; created: when, in seconds of the epoch
    out       folder of the run; capture: what it is trained on; options: further arguments of `fastgs train`
    python    the training Python
    wish      QUEUED, RUN, PAUSE or STOP: what the user asked for last
    scene     about the scene that it belongs to, for the finished model: start_frame, world (16 numbers), blend
    first     what `fastgs train` is told about the folder at the first start: "", --resume or --overwrite
    begun     whether it has been started before
    started   when its process was started last, in seconds of the epoch
    console   length of console.log when the process began
    told      whether its end has been told
    """

    id: str
    out: str
    capture: str
    python: str
    options: list[str] = field(default_factory=list)
    wish: str = "QUEUED"
    scene: dict = field(default_factory=dict)
    created: float = 0.0
    first: str = ""
    begun: bool = False
    started: float = 0.0
    console: int = 0
    told: bool = False

    @property
    def name(self) -> str:
        return Path(self.out).name


@dataclass(frozen=True)
class State:
    """How a job stands.

    kind   QUEUED; STARTING, PREPARING, TRAINING, STOPPING: its process lives; PAUSED, STOPPED, FAILED, FINISHED
    text   one sentence for the user
    values of status.json, {} before there is one
    """

    kind: str
    text: str
    values: dict = field(default_factory=dict)

    @property
    def running(self) -> bool:
        return self.kind in RUNNING

    @property
    def seconds_left(self) -> float | None:
        """Seconds of training that are left, None before that can be told."""
        return self.values.get("seconds_left") if self.share > 0.02 else None

    @property
    def share(self) -> float:
        """How much of the run is done, 0..1."""
        whole = self.values.get("iterations") or 0
        return min((self.values.get("iteration") or 0) / whole, 1.0) if whole else 0.0


class Jobs:
    """All jobs of a user; folder: where their files are."""

    def __init__(self, folder):
        self.folder = Path(folder)

    def all(self) -> list[Job]:
        """The jobs, the oldest first; files that are none are passed over."""
        found = [self._read(path) for path in self.folder.glob("*.json")] if self.folder.is_dir() else []
        return sorted((job for job in found if job), key=lambda job: (job.created, job.id))

    def get(self, name: str) -> Job | None:
        """The job of that id."""
        return self._read(self.folder / f"{name}.json")

    def add(self, out, capture, python: str, options=(), scene=None, first: str = "") -> Job:
        """A new job at the end of the queue; the arguments are Job's.  Raises FastGSError where another job has that folder."""
        out = str(Path(out).absolute())
        for other in self.all():
            if other.out == out:
                if self.state(other).kind not in ENDED:
                    raise FastGSError(f"{out} belongs to a training job that has not ended; choose another folder, or stop that job first.")
                self.forget(other)
        made = time.time()
        job = Job(f"{made:.3f}-{os.getpid()}", out, str(capture), python, list(options), scene=scene or {}, created=made,
                  first=first)
        self.save(job)
        return job

    def save(self, job: Job) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing([self.folder / f"{job.id}.json"]) as (part,):
                part.write_text(json.dumps(asdict(job), indent=1), "utf-8")
        except OSError as error:
            raise FastGSError(f"{self.folder}: the list of training jobs cannot be written ({error.strerror}); free some space.") from error

    def forget(self, job: Job) -> None:
        """Take an ended job off the list; its folder stays."""
        for suffix in (".json", ".lock", ".stop"):
            (self.folder / f"{job.id}{suffix}").unlink(missing_ok=True)
        _children.pop(job.id, None)

    def start(self, job: Job) -> None:
        """Let its process begin, or go on where the run was.  Raises FastGSError where that is impossible."""
        if self.alive(job):
            return
        out = Path(job.out)
        try:
            out.mkdir(parents=True, exist_ok=True)
            (out / STATUS).unlink(missing_ok=True)  # that of an earlier process says nothing about this one
            (self.folder / f"{job.id}.stop").unlink(missing_ok=True)
            console = (out / CONSOLE).open("ab")
        except OSError as error:
            raise FastGSError(f"{out}: the training job cannot write there ({error.strerror}); choose another folder.") from error
        there = ["--resume"] if (out / RUN).exists() else []
        more = there if job.begun else [job.first] if job.first else []
        job.console, job.wish, job.told, job.begun = (out / CONSOLE).stat().st_size, "RUN", False, True
        job.started = time.time()
        self.save(job)
        with console:
            try:
                _children[job.id] = subprocess.Popen(
                    self.command(job, more), stdin=subprocess.DEVNULL, stdout=console, stderr=subprocess.STDOUT, cwd=out,
                    env=environment(job.python), **_detached())
            except OSError as error:
                raise FastGSError(f"{job.python}: the training Python does not start ({error.strerror}); choose another in the "
                                  "preferences.") from error

    def command(self, job: Job, more=()) -> list[str]:
        """What its process is."""
        files = [str(self.folder / f"{job.id}{suffix}") for suffix in (".lock", ".stop")]
        here = Path(__file__).resolve()  # one place for the kernels that numba keeps by path
        return [job.python, str(here.with_name("child.py")), str(here.parents[2]), *files,
                "train", job.capture, "--out", job.out, "--quiet", *job.options, *more]

    def ask(self, job: Job, wish: str) -> None:
        """PAUSE or STOP: its process, if it lives, saves and ends; QUEUED: it goes on when its turn comes."""
        job.wish = wish
        if wish == "QUEUED":
            job.told = False
        self.save(job)
        if wish != "QUEUED" and self.alive(job):
            (self.folder / f"{job.id}.stop").touch()

    def alive(self, job: Job) -> bool:
        """Whether its process lives."""
        child = _children.get(job.id)
        if child is not None:
            return child.poll() is None
        if is_held(self.folder / f"{job.id}.lock"):
            return True
        begins = 0 <= time.time() - job.started < GRACE  # another Blender started it just now, and Python has to come up first
        return begins and not (Path(job.out) / STATUS).exists()

    def state(self, job: Job) -> State:
        """How the job stands; a process that has ended without saying so has crashed, and the reason is looked for."""
        values = _read_json(Path(job.out) / STATUS)
        said = values.get("state")
        if said == "finished":  # its process may still be clearing up
            return State('FINISHED', "Finished", values)
        if self.alive(job):
            if job.wish in ("PAUSE", "STOP"):
                return State('STOPPING', "Saving", values)
            if said in ("preparing", "training"):
                return State(said.upper(), "Preparing the pictures" if said == "preparing" else "Training", values)
            return State('STARTING', "Starting", {})
        if job.wish == "QUEUED":
            return State('QUEUED', "Waiting for its turn", values)
        if said == "stopped" or (said is None and job.wish in ("PAUSE", "STOP")):
            return State('STOPPED' if job.wish == "STOP" else 'PAUSED', "Stopped" if job.wish == "STOP" else "Paused", values)
        child = _children.get(job.id)
        reason = values.get("reason") if said == "failed" else None
        return State('FAILED', causes.sentence(reason, self.said(job), child.returncode if child else None, job.out), values)

    def said(self, job: Job, limit: int = 20_000) -> str:
        """The end of what its last process said."""
        with contextlib.suppress(OSError), (Path(job.out) / CONSOLE).open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(job.console, file.tell() - limit))
            return file.read().decode(errors="replace")
        return ""

    def start_next(self) -> Job | None:
        """Start the first job that waits, unless one is running or paused; returns it.  One that cannot start says why and ends."""
        jobs = self.all()
        kinds = [self.state(job).kind for job in jobs]
        if any(kind in RUNNING or kind == 'PAUSED' for kind in kinds):
            return None
        for job, kind in zip(jobs, kinds):
            if kind == 'QUEUED':
                try:
                    self.start(job)
                except FastGSError as error:
                    self.fail(job, error)
                    continue
                return job
        return None

    def fail(self, job: Job, error: Exception) -> None:
        """Note why a job could not start."""
        job.wish = "RUN"
        self.save(job)
        with contextlib.suppress(OSError), (Path(job.out) / CONSOLE).open("a", encoding="utf-8") as file:
            file.write(f"fastgs: {error}\n")

    def _read(self, path: Path) -> Job | None:
        values = _read_json(path)
        known = {f.name for f in fields(Job)}
        try:
            return Job(**{key: value for key, value in values.items() if key in known})
        except TypeError:
            return None


def _detached() -> dict:
    """What lets a process outlive the one that starts it."""
    if sys.platform == "win32":
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
        return {"creationflags": flags}
    return {"start_new_session": True}


def _read_json(path: Path) -> dict:
    try:
        values = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}
