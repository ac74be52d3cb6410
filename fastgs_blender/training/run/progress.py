# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports a run's progress: a bar, a log of JSON lines, TensorBoard, a status file for other programs, preview pictures, a plot.

It has no influence on the result and never stops a run: a file that cannot be written gives one warning and is left out.
"""
import contextlib
import importlib.util
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...captures.capture import Shot
from ...util.errors import FastGSError
from ...util.outputs import appending, writing
from ...util.progress import clock_text, progress
from ...util.reading import parse_json, read_bytes
from . import checkpoint
from .files import BOARD, LOG, PLOT, PREVIEWS, STATUS
from .plot import write_plot

SMOOTHING = 0.98
STATUS_SECONDS = 1.0
LOG_EVERY = 20
"""Steps between two lines of the log."""
LARGEST_LOG = 2**30
"""Bytes of the log of an earlier part of the run."""
UNTIMED_STEPS = 2
"""A process' first steps compile kernels, which takes many times as long as a step does: the time left is not estimated from them."""


class Reporter:
    """Reports to the terminal and to the run's folder.

    folder      where the files go
    iterations  of the whole run; begin: those already done, elapsed: the seconds that they took
    forecast    seconds that the whole run is expected to take, by which the time left is told before steps are timed; 0: unknown
    quiet       neither progress nor remarks; what goes wrong is told
    clock       gives the time in seconds from any beginning
    device      what trains, for people
    """

    device = ""

    def __init__(self, folder: Path, iterations: int, begin: int = 0, elapsed: float = 0.0, quiet: bool = False,
                 clock: Callable[[], float] = time.monotonic, forecast: float = 0.0) -> None:
        self.folder, self.iterations, self.forecast = Path(folder), iterations, forecast
        self.clock = clock
        self.before, self.started, self.begin = elapsed, clock(), begin
        self.timed: tuple[int, float] | None = None
        self.smooth: dict[str, float] = {}
        self.last: dict = {"iteration": begin} if begin else {}
        self.unwritable, self.state, self.status_time = set[str](), "", 0.0
        self.quiet = quiet
        self.bar = progress(iterations, "step", "training", quiet=quiet, done=begin, rate=lambda: self.speed, clock=clock)
        self._drop_log_after(begin)
        self.log = self._safely("the log", lambda: appending(self.folder / LOG, "a", encoding="utf-8", buffering=1))
        self.board = self._board()

    @property
    def elapsed(self) -> float:
        """Seconds of training, those before the last resumption included."""
        return self.before + self.clock() - self.started

    @property
    def speed(self) -> float:
        """Steps a second since the first few, 0 while only those are done."""
        if self.timed is None:
            return 0.0
        iteration, begun = self.timed
        return (self.last["iteration"] - iteration) / max(self.clock() - begun, 1e-9)

    @property
    def left(self) -> float | None:
        """Seconds until the last step: by the pace of steps or, before the first one, by the forecast; None where neither is known."""
        done = self.last.get("iteration", self.begin)
        if self.speed > 0:
            return (self.iterations - done) / self.speed
        return max(self.forecast - self.elapsed, 0.0) or None if done == self.begin else None

    def say(self, text: str) -> None:
        """A remark; not shown where the run is quiet."""
        if not self.quiet:
            self.warn(text)

    def warn(self, text: str) -> None:
        """Something that went wrong, and did not end the run; always shown."""
        self.bar.say(f"fastgs: {text}")

    def fill(self, store: Any, shots: Sequence[Shot]) -> None:
        """Decode the pictures that are not in the cache yet, with a bar of their own."""
        if store.missing(shots):
            with self.stage("decoding", "picture") as report:
                store.fill(report, shots)
            if store.beyond:
                self.warn(f"{len(store.beyond)} of {len(shots)} pictures find no room in the cache ({store.folder}) and are decoded each "
                          "time, which is slower; FASTGS_CACHE_GB says how many GB it may take.")

    @contextlib.contextmanager
    def stage(self, what: str, unit: str = "moment") -> Iterator[Callable[[int, int], None]]:
        """Something long before the first step: gives report(done, of), which is called as it goes on.

        It has a bar of its own, and is in status.json as `stage` and `stage_share`.  What follows it, such as compiling for a minute, is
        "starting" there.
        """
        with progress(1, unit, what, quiet=self.quiet, clock=self.clock) as bar:

            def report(done: int, of: int) -> None:
                if self.left:
                    bar.note(f"{clock_text(self.left)} until all steps are done")
                bar.to(done, of)
                if done in (0, of) or self.clock() - self.status_time > STATUS_SECONDS:
                    self.status("preparing", stage=what, stage_share=round(done / max(of, 1), 3))

            yield report
        self.status("preparing", stage="starting")

    def step(self, values: dict) -> None:
        """values of one step: iteration, loss, psnr, gaussians and whatever else there is to plot."""
        iteration = values["iteration"]
        self.last = values
        if self.timed is None and iteration >= self.begin + UNTIMED_STEPS:
            self.timed = iteration, self.clock()
        for name in ("loss", "psnr"):
            if name in values:
                old = self.smooth.get(name, values[name])
                self.smooth[name] = old + (1 - min(SMOOTHING, iteration / (iteration + 10))) * (values[name] - old)
        self.bar.note(f"loss {self.smooth['loss']:.4f}, {self.smooth['psnr']:.1f} dB, {values['gaussians']} Gaussians")
        self.bar.to(iteration)
        if iteration % LOG_EVERY == 0 or iteration == self.iterations:
            row = {**values, "smooth_loss": self.smooth["loss"], "smooth_psnr": self.smooth["psnr"], "seconds": round(self.elapsed, 2)}
            self._log(row)
        if self.state != "training" or self.clock() - self.status_time > STATUS_SECONDS:  # the first step of every process is reported
            self.status("training", **values)

    def status(self, state: str, **values: Any) -> None:
        """status.json: state is preparing, training, stopped, failed or finished."""
        self.state, self.status_time = state, self.clock()
        values, left = {**self.last, **values}, self.left
        about = {"state": state, "process": os.getpid(), "device": self.device, "iterations": self.iterations, **values, **self.smooth,
                 "elapsed_seconds": round(self.elapsed, 2), "seconds_left": None if left is None else round(left, 1)}
        self._safely("the status file", lambda: checkpoint.write_json(self.folder / STATUS, finite(about)))

    def preview(self, iteration: int, picture: np.ndarray, values: dict) -> None:
        """A picture [h, w, 3] 0..1 of a view, and what was measured on it; the plot follows."""
        self._safely("a preview picture", lambda: self._write_preview(iteration, picture))
        self._log({"iteration": iteration, **values})
        self._safely("the plot of the loss", lambda: write_plot(self.folder / PLOT, self.folder / LOG))

    def close(self) -> None:
        """The plot of the whole run, and an end to everything open."""
        self.bar.close()
        with contextlib.suppress(OSError):
            if self.log:
                self.log.close()
        if self.board:
            self.board.close()
        self._safely("the plot of the loss", lambda: write_plot(self.folder / PLOT, self.folder / LOG))

    def _write_preview(self, iteration: int, picture: np.ndarray) -> None:
        from PIL import Image

        folder = self.folder / PREVIEWS
        folder.mkdir(exist_ok=True)
        pixels = np.floor(np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
        with writing([folder / f"{iteration:06d}.png"]) as (part,), part.open("wb") as file:
            Image.fromarray(pixels).save(file, format="PNG")

    def _log(self, row: dict) -> None:
        if self.log:
            self._safely("the log", lambda: self.log.write(json.dumps(finite(row)) + "\n"))
        if self.board:
            for name, value in row.items():
                if name not in ("iteration", "seconds") and isinstance(value, (int, float)):
                    self.board.add_scalar(name, value, row["iteration"])

    def _drop_log_after(self, iteration: int) -> None:
        """Remove from the log the lines of steps that will be repeated, and a line that a kill cut short."""
        path = self.folder / LOG
        if not path.exists():
            return

        def write() -> None:
            with writing([path]) as (part,):
                lines = read_bytes(path, LARGEST_LOG).decode("utf-8", "replace").splitlines()
                part.write_text("".join(f"{line}\n" for line in lines if 0 < _iteration(line) <= iteration), "utf-8")

        self._safely("the log", write)

    def _board(self) -> Any:
        if not importlib.util.find_spec("tensorboard"):  # torch is imported for nothing else here
            return None
        try:
            from torch.utils.tensorboard import SummaryWriter
        except (ImportError, AttributeError):  # absent, or too old for this torch
            return None
        return self._safely("TensorBoard's file", lambda: SummaryWriter(str(self.folder / BOARD), purge_step=self.begin + 1))

    def _safely(self, what: str, write: Callable[[], Any]) -> Any:
        try:
            return write()
        except (FastGSError, OSError) as error:
            if what not in self.unwritable:
                self.unwritable.add(what)
                self.warn(f"{what} could not be written ({str(error).rstrip('.')}); training continues.")
            return None


def finite(values: dict) -> dict:
    """The values with None for what JSON cannot say."""
    return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in values.items()}


def _iteration(line: str) -> int:
    try:
        return int(parse_json(line)["iteration"])
    except (ValueError, KeyError, TypeError, OverflowError):
        return -1
