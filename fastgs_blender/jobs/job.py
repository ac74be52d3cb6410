# SPDX-License-Identifier: GPL-3.0-or-later
"""Data of a training job and of its state, and checks of the JSON files that hold them.

Job files lie in the user's folder and status files in the runs' folders; other programs, other versions and full disks write to both.
"""
import re
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ..util.errors import FastGSError, printable
from ..util.reading import read_json

Check = Callable[[Any], bool]
RUNNING = ('STARTING', 'PREPARING', 'TRAINING', 'STOPPING')
ENDED = ('FINISHED', 'FAILED', 'STOPPED')
REQUESTS = ("QUEUED", "RUN", "PAUSE", "STOP")
EXISTING = ("", "--resume", "--overwrite")
LARGEST_FILE = 1 << 20
"""Bytes of the largest job or status file that is read."""
LATEST = 1e12
"""Seconds of the epoch that no clock shows."""


@dataclass
class Job:
    """A training run that the user started or put into the queue.

    id        the name of its files; created: when, in seconds of the epoch
    out       folder of the run; capture: what it is trained on; options: further arguments of `fastgs train`
    python    the training Python
    request   what the user asked for last: QUEUED, RUN, PAUSE or STOP
    scene     about the scene that it belongs to, for the finished model: start_frame, world (name of an object), blend, process, import,
              hide (the objects that were filmed)
    existing  what the first start does with a run that is in the folder already: "" (refuses), --resume or --overwrite
    begun     whether an earlier process of it has begun its run, which is then continued
    started   when its process was started last, in seconds of the epoch
    console   length of console.log when that process began
    problem   why it could not be started, "" where it could
    reported  whether the user has been told of its end
    """

    id: str
    out: str
    capture: str
    python: str
    options: list[str] = field(default_factory=list)
    request: str = "QUEUED"
    scene: dict = field(default_factory=dict)
    created: float = 0.0
    existing: str = ""
    begun: bool = False
    started: float = 0.0
    console: int = 0
    problem: str = ""
    reported: bool = False

    @property
    def name(self) -> str:
        """The folder's name, for messages."""
        return printable(Path(self.out).name)


@dataclass(frozen=True)
class State:
    """The state of a job.

    kind   QUEUED; STARTING, PREPARING, TRAINING, STOPPING: its process lives; PAUSED, STOPPED, FAILED, FINISHED
    text   one sentence for the user
    values of status.json that are what they should be, {} before there are any
    """

    kind: str
    text: str
    values: dict = field(default_factory=dict)

    @property
    def running(self) -> bool:
        return self.kind in RUNNING

    @property
    def seconds_left(self) -> float | None:
        """Estimated seconds of training that are left, None while there is no estimate; the first steps tell too little."""
        return self.values.get("seconds_left") if self.share > 0.02 or not self.share else None

    @property
    def share(self) -> float:
        """The share of the run that is done, 0..1."""
        whole = self.values.get("iterations") or 0
        return min((self.values.get("iteration") or 0) / whole, 1.0) if whole else 0.0


def read_job(path: Path) -> Job:
    """The job in a file; raises FastGSError where the file cannot be read, or holds anything but a job."""
    values = read_json(path, LARGEST_FILE)
    if not isinstance(values, dict):
        raise FastGSError(f"{path}: this is no training job.")
    known = {f.name for f in fields(Job)}
    try:
        job = Job(**{key: value for key, value in values.items() if key in known})
    except TypeError as error:
        raise FastGSError(f"{path}: this is no training job ({error}).") from error
    wrong = next((name for name, good in _CHECKS.items() if not good(getattr(job, name))), None)
    if wrong is None and job.id != path.stem:
        wrong = "id"  # its other files are found by it
    if wrong is not None:
        raise FastGSError(f"{path}: this is no training job (its {wrong} is not valid).")
    job.scene = {key: value for key, value in job.scene.items() if key in _SCENE and _SCENE[key](value)}
    return job


def read_status(path: Path) -> dict:
    """The values of a run's status.json, {} where there is none.  Values of a wrong type or out of range are left out."""
    try:
        values = read_json(path, LARGEST_FILE)
    except FastGSError:
        return {}
    if not isinstance(values, dict):
        return {}
    found = {name: values[name] for name, good in _STATUS.items() if name in values and good(values[name])}
    return {name: printable(value) if isinstance(value, str) else value for name, value in found.items()}


def _text(value: object) -> bool:
    return isinstance(value, str) and "\0" not in value and len(value) < 65_536


def _path(value: object) -> bool:
    return isinstance(value, str) and _text(value) and bool(value) and Path(value).is_absolute()


def _number(low: float, high: float) -> Check:
    return lambda value: isinstance(value, (int, float)) and not isinstance(value, bool) and low <= value <= high  # NaN is neither


def _integer(low: int, high: int) -> Check:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _flag(value: object) -> bool:
    return isinstance(value, bool)


_SCENE = {"start_frame": _integer(-(1 << 20), 1 << 20), "world": _text, "blend": _text, "process": _integer(0, 1 << 62),
          "import": _flag, "hide": _flag}
_CHECKS = {
    "id": lambda value: isinstance(value, str) and re.fullmatch(r"[\w.-]{1,100}", value) is not None,
    "out": _path, "capture": lambda value: _text(value) and bool(value), "python": lambda value: _text(value) and bool(value),
    "options": lambda value: isinstance(value, list) and all(_text(option) for option in value),
    "request": lambda value: isinstance(value, str) and value in REQUESTS,
    "existing": lambda value: isinstance(value, str) and value in EXISTING,
    "scene": lambda value: isinstance(value, dict), "created": _number(0, LATEST), "started": _number(0, LATEST),
    "console": _integer(0, 1 << 62), "problem": _text, "begun": _flag, "reported": _flag,
}
_COUNT = _integer(0, 1 << 53)
_STATUS = {
    "state": lambda value: value in ("preparing", "training", "stopped", "failed", "finished") if isinstance(value, str) else False,
    "process": _integer(1, 1 << 31), "iteration": _COUNT, "iterations": _COUNT, "gaussians": _COUNT, "reason": _text,
    "psnr": _number(-1e4, 1e4), "held_out_psnr": _number(-1e4, 1e4), "loss": _number(-1e30, 1e30),
    "seconds_left": _number(0, LATEST), "elapsed_seconds": _number(0, LATEST), "stage": _text, "stage_share": _number(0, 1),
}
