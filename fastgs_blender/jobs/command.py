# SPDX-License-Identifier: GPL-3.0-or-later
"""A command of `fastgs` in a process of the training Python, watched by a thread: Blender stays usable meanwhile.  No bpy here."""
import json
import subprocess
import tempfile
import threading
from collections.abc import Container, Sequence
from pathlib import Path

from ..util.errors import FastGSError
from ..util.processes import end, hidden
from ..util.reading import read_json
from . import causes
from .environment import environment

LARGEST_STATUS = 1 << 16


def command_line(python: str, arguments: Sequence[str], lock: str = "", stop: str = "") -> list[str]:
    """The command line of a `fastgs` from the extension's folder; lock, stop: files, see child.py."""
    here = Path(__file__).resolve()  # one place for the kernels that numba keeps by path
    return [python, str(here.with_name("child.py")), str(here.parents[2]), lock, stop, *arguments]


class Watched:
    """Work of another process, which a thread of this one watches."""

    _thread: threading.Thread

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for its end, so long at most; returns whether it has ended."""
        self._thread.join(seconds)
        return self.done


class Command(Watched):
    """A command that is running or has ended.

    what, about  what it does, as a noun, and the file or folder that it reads: for sentences; good: exit codes with which it gives values
    line         the last remark that it printed
    values       what --json gives when it has ended well, else None; trouble: why not, in a sentence, or ""
    Raises FastGSError where the Python does not start.
    """

    def __init__(self, python: str, arguments: Sequence[str], what: str, about: str, good: Container[int] = (0,)) -> None:
        self.values: dict | None = None
        self.line = self.trouble = ""
        self._what, self._about, self._good, self._stopped = what, about, good, False
        self._printed = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 (as long as the process)
        line = command_line(python, [*arguments, "--json"])
        try:
            self._process = subprocess.Popen(line, env=environment(python), stdin=subprocess.DEVNULL, stdout=self._printed,
                                             stderr=subprocess.PIPE, encoding="utf-8", errors="replace", **hidden())
        except OSError as error:
            raise FastGSError(f"{python}: the training Python does not start ({error.strerror or error}); choose another.") from error
        self._thread = threading.Thread(target=self._run, name=f"FAST-GS {arguments[0]}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it, if it has not ended."""
        self._stopped = True
        end(self._process)
        self._thread.join()

    def result(self) -> dict:
        """Its values, once it has ended; raises FastGSError with the reason where it has none."""
        if self.values is None:
            raise FastGSError(self.trouble)
        return self.values

    def _run(self) -> None:
        lines: list[str] = []
        with self._process as process, self._printed:
            for line in process.stderr or ():
                lines.append(line)
                self.line = line.strip().removeprefix(causes.PREFIX) or self.line
            code = process.wait()
            self._printed.seek(0)
            try:
                values = json.loads(self._printed.read())
            except ValueError:
                values = None
        if isinstance(values, dict) and code in self._good:
            self.values = values
        elif not self._stopped:
            self.trouble = causes.sentence(None, "".join(lines), code, self._about, self._what)


class StagedCommand(Command):
    """A command of several stages, which writes how far it is into the file that its --status names."""

    def __init__(self, python: str, arguments: Sequence[str], what: str, about: str, good: Container[int] = (0,)) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="fastgs-")
        self._status = Path(self._folder.name) / "status.json"
        super().__init__(python, [*arguments, "--status", str(self._status)], what, about, good)

    @property
    def progress(self) -> tuple[str, float]:
        """What it is doing, and the share of the whole that is done, 0..1."""
        try:
            values = read_json(self._status, LARGEST_STATUS)
            return str(values["stage"]), min(max(float(values["share"]), 0.0), 1.0)
        except (FastGSError, LookupError, TypeError, ValueError, OverflowError):  # not written yet, or just now
            return "starting", 0.0

    def _run(self) -> None:
        super()._run()
        self._folder.cleanup()
