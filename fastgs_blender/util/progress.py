# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows a command's progress: as a bar on a terminal, as a plain line now and then in a file or a log, or not at all."""
from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

from .screen import tell

SOON, SECONDS = 3.0, 20.0
"""Seconds until the first plain line, and between two of them."""
LONG = 60.0
"""Seconds of work that is announced."""


class Progress:
    """Counts pieces of work and shows nothing.

    n, total   pieces done, and of all
    rate       pieces a second, a function; None: measured since the beginning
    clock      gives seconds
    """

    def __init__(self, total: int, unit: str, what: str, done: int = 0, rate: Callable[[], float] | None = None,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.n, self.total, self.unit, self.what, self.rate, self.clock, self.text = done, total, unit, what, rate, clock, ""

    def to(self, done: int, total: int | None = None) -> None:
        """So many pieces are done, of so many."""
        self.n, self.total = done, self.total if total is None else total

    def note(self, text: str) -> None:
        """What stands behind the count from now on."""
        self.text = text

    def say(self, line: str) -> None:
        """Print a line on standard error without spoiling what is shown."""
        tell(line, sys.stderr)

    def close(self) -> None:
        """Nothing more comes."""

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Lines(Progress):
    """A line on standard error SOON after the beginning, then every SECONDS, and at the end: no escapes, no carriage returns.

    A thread writes it where no piece ends for so long.  Of several that are open, only the one that was opened last does so.
    """

    opened: ClassVar[list[Lines]] = []

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.begun = self.since = self.shown = self.came = self.clock()
        self.first = self.last = self.n
        self.told = self.going = False
        self.closed, self.lock = threading.Event(), threading.Lock()
        self.opened.append(self)
        threading.Thread(target=self._watch, name="FAST-GS progress", daemon=True).start()

    def to(self, done: int, total: int | None = None) -> None:
        self.came = self.clock() if done > self.n else self.came
        super().to(done, total)
        if not self.going:  # what comes before the first piece says nothing of how long pieces take
            self.going, self.since, self.first = done > self.first, self.clock(), max(done, self.first)
        self._show_if_due()

    def close(self) -> None:
        if not self.closed.is_set():
            self.closed.set()
            self.opened.remove(self)
            if self.last != self.n:
                self._show()

    def _watch(self) -> None:
        while not self.closed.wait(1.0):
            if self.opened[-1:] == [self]:
                self._show_if_due()

    def _show_if_due(self) -> None:
        with self.lock:
            if self.clock() - self.shown >= (SECONDS if self.told else SOON):
                self._show()

    def _show(self) -> None:
        self.shown, self.last, self.told = self.clock(), self.n, True
        spent = self.shown - self.begun
        rate = self.rate() if self.rate else (self.n - self.first) / max(self.shown - self.since, 1e-9)
        even = rate > 0 and self.shown - self.came < max(SECONDS, 3 / rate)  # else this piece is longer than those before it
        left = f", {clock_text((self.total - self.n) / rate)} left" if even and self.n < self.total else ""
        note = f", {self.text}" if self.text else ""
        pieces = f"{self.n}/{self.total} {self.unit}s ({100 * self.n // max(self.total, 1)} %), " if self.n else ""
        self.say(f"{self.what}: {pieces}{clock_text(spent)} so far{left}{note}")


class Bar(Progress):
    """tqdm's bar on standard error."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        from tqdm import tqdm

        progress = self

        class Shown(tqdm):
            @property
            def format_dict(self) -> dict[str, Any]:
                return super().format_dict | ({} if progress.rate is None else {"rate": progress.rate()})

        self.bar = Shown(total=self.total, initial=self.n, unit=self.unit, desc=self.what, mininterval=0.5, dynamic_ncols=True,
                         bar_format="{desc} {percentage:3.0f}%|{bar}| {n}/{total} [{elapsed}<{remaining}{postfix}]")

    def to(self, done: int, total: int | None = None) -> None:
        super().to(done, total)
        self.bar.total = self.total
        self.bar.update(done - self.bar.n)

    def note(self, text: str) -> None:
        super().note(text)
        self.bar.set_postfix_str(text, refresh=False)

    def say(self, line: str) -> None:
        self.bar.clear()
        super().say(line)
        self.bar.refresh()

    def close(self) -> None:
        self.bar.close()


def progress(total: int, unit: str, what: str, *, quiet: bool = False, done: int = 0, rate: Callable[[], float] | None = None,
             clock: Callable[[], float] = time.monotonic) -> Progress:
    """Shows how far some work is; nothing where there is none to do, or `quiet`.

    unit, what  such as "frame" and "rendering"; done: pieces that were done before; rate, clock: see Progress
    """
    if quiet or total <= done:
        kind: type[Progress] = Progress
    else:
        kind = Bar if sys.stderr is not None and sys.stderr.isatty() else Lines
    return kind(total, unit, what, done, rate, clock)


@contextmanager
def estimated(what: str, seconds: float, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> Iterator[None]:
    """Say how long work of a minute or more will take and, when it has ended, how right that was."""
    begun = clock()
    if seconds >= LONG:
        say(f"{what} will take about {clock_text(seconds)} on this machine, by a rough estimate.")
    yield
    if seconds >= LONG:
        say(f"{what} took {clock_text(clock() - begun)}, and {clock_text(seconds)} were estimated.")


def clock_text(seconds: float) -> str:
    """Seconds as 1:02 or 1:02:03."""
    minutes, rest = divmod(int(min(seconds, 1e9) + 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def staged(weights: Mapping[str, tuple[float, float]], report: Callable[[str, float], None]) -> Callable[[str, float], None]:
    """A function of (stage, share of it) that calls report(stage, share of the whole), which never falls.

    weights  begin and end of each stage as shares of the whole
    """
    reached = 0.0

    def at(stage: str, share: float) -> None:
        nonlocal reached
        low, high = weights[stage]
        reached = max(reached, low + (high - low) * min(share, 1.0))
        report(stage, reached)

    return at
