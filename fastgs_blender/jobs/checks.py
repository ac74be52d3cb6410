# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks before a run starts: the training Python, the capture, disk and memory; and how long filming will take."""
import os
import shutil
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..captures.layouts import fastgs
from ..training.core.costs import BASE_MEMORY, CORES
from ..util.errors import FastGSError
from ..util.reading import read_json, reading
from . import environment as pythons
from .capture_check import PROBLEMS
from .command import Command

LEAST_DISK = 500 << 20
"""Bytes that a run's folder should have free: a checkpoint, its successor, the model, pictures."""
PICTURE, SAMPLE = 0.5, 1.5e-6
"""Seconds to render a picture of a filmed scene, and more for each pixel and sample, on two cores: of a simple scene in Cycles."""


@dataclass(frozen=True)
class Facts:
    """The contents of a capture, and the problems found in it."""

    capture: str
    views: int = 0
    frames: int = 0
    width: int = 0
    height: int = 0
    layout: str = ""
    posed: bool = True
    problems: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        poses = "" if self.posed else "; training finds the cameras' poses first"
        return f"{self.layout}: {self.views} cameras, {self.frames} frames, {self.width} x {self.height}{poses}"


latest: Facts | None = None
"""The capture that was looked at last, for the panel."""


def inspect(python: str, capture: str) -> Facts:
    """Look at the training Python and, with it, at a capture; raises FastGSError where either cannot be used at all."""
    global latest
    report = pythons.inspect(python)
    if not report.ready:
        raise FastGSError(report.sentence)
    if not capture:
        raise FastGSError("no capture is chosen; choose its folder.")
    looking = Command(python, ["info", capture], "reading the capture", capture, (0, PROBLEMS))
    looking.wait()
    values = looking.result()
    first = next((view for view in values["views"] if view["width"] or view["file_width"]), None) or {}
    latest = Facts(capture, len(values["views"]), values["clip"]["frame_count"], first.get("width") or first.get("file_width") or 0,
                   first.get("height") or first.get("file_height") or 0, values["layout"], values["posed"], values["problems"])
    if not latest.posed and "pycolmap" in report.missing:
        latest.problems.append(f"the capture does not say where its cameras are, and {python} lacks pycolmap, which finds that; make an "
                               "environment for training in the preferences, or choose one that has it.")
    return latest


def picture_size(capture: str) -> tuple[int, int, int]:
    """(pixels of a picture, cameras, frames) of a capture, as far as that is known without its files: looked at before, or of our layout.

    Zeros where it is not.
    """
    if latest and latest.capture == capture:
        return latest.width * latest.height, latest.views, latest.frames
    path = Path(capture)
    with suppress(FastGSError), reading(path):
        values = read_json(path / fastgs.FILE if path.is_dir() else path)
        sizes = [int(camera["width"]) * int(camera["height"]) for camera in values["cameras"]]
        return max(sizes), len(sizes), int(values["frame_count"])
    return 0, 0, 0


def free_bytes(folder: Path) -> int:
    """What is free on the disk of a folder that need not be there yet; raises OSError."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free


def before_start(out: str, memory: float = BASE_MEMORY) -> list[str]:
    """Remarks on disk and memory, for a run that needs so many bytes of memory; raises FastGSError if the disk is too full."""
    try:
        free = free_bytes(Path(out))
    except OSError as error:
        raise FastGSError(f"{out}: this folder cannot be used ({error.strerror}); choose another.") from error
    if free < LEAST_DISK // 10:
        raise FastGSError(f"{out}: only {free / 1e6:.0f} MB are free on this disk; free some space or choose another folder.")
    remarks = []
    if free < LEAST_DISK:
        remarks.append(f"only {free / 1e6:.0f} MB are free for the results in {out}.")
    available = available_memory()
    if available is not None and available < memory:
        remarks.append(f"only {available / 1e9:.1f} GB of memory are free, and training will take about {memory / 1e9:.1f} GB: close other "
                       "programs, or train fewer Gaussians or smaller pictures.")
    return remarks


def available_memory() -> int | None:
    """Bytes of memory that are available now; None where the system does not say."""
    try:
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass
    return None


def filming(work: int, pictures: int) -> float:
    """Seconds that filming a scene will take, very roughly, as scenes differ: pictures of so many pixels times samples."""
    return pictures * (PICTURE + SAMPLE * work * CORES / max(os.cpu_count() or 1, 1))
