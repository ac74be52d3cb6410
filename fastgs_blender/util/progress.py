# SPDX-License-Identifier: GPL-3.0-or-later
"""Shows a command's progress: as a bar on a terminal, as a plain line now and then in a file or a log, or not at all."""
from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from .screen import tell

SECONDS = 20.0
"""Seconds between two plain lines."""
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
    """A line on standard error every SECONDS, and at the end: no escapes, no carriage returns."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.begun = self.since = self.shown = self.clock()
        self.first = self.last = self.n
        self.going = False

    def to(self, done: int, total: int | None = None) -> None:
        super().to(done, total)
        now = self.clock()
        if not self.going:  # what comes before the first piece says nothing of how long pieces take
            self.going, self.since, self.first = done > self.first, now, max(done, self.first)
        if now - self.shown >= SECONDS:
            self._show()

    def close(self) -> None:
        if self.last != self.n:
            self._show()

    def _show(self) -> None:
        self.shown, self.last = self.clock(), self.n
        spent = self.shown - self.begun
        rate = self.rate() if self.rate else (self.n - self.first) / max(self.shown - self.since, 1e-9)
        left = f", {clock_text((self.total - self.n) / rate)} left" if rate > 0 and self.n < self.total else ""
        note = f", {self.text}" if self.text else ""
        share = f"{100 * self.n // max(self.total, 1)} %"
        self.say(f"{self.what}: {self.n}/{self.total} {self.unit}s ({share}), {clock_text(spent)} so far{left}{note}")


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
