# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Python that trains, lists the packages that it lacks, and installs a new environment.  No bpy here."""
import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Container
from dataclasses import dataclass
from pathlib import Path

from ..util.errors import FastGSError
from ..util.outputs import appending
from ..util.reading import LARGEST_JSON, read_bytes

NEEDED = {"numba": "numba", "safetensors": "safetensors", "PIL": "pillow", "tqdm": "tqdm", "numpy": "numpy"}
"""Modules without which training does not run, and the packages that have them."""
USEFUL = {"av": "films", "pycolmap": "cameras without poses and starting points from pictures", "OpenEXR": "EXR pictures"}
"""Modules, called as their packages are, and what they are for."""
INSTALLED = ("numpy>=1.26", "numba>=0.61", "safetensors>=0.4.3", "OpenEXR>=3.3", "pillow>=10", "tqdm>=4.60", "zstandard>=0.22",
             "wgpu>=0.32,<0.40", "av>=14", "pycolmap>=4.2")
"""What an environment gets, in the versions of pyproject.toml, which no extension brings along; a test compares them."""
SIZE = "about half a gigabyte"
TORCH, TORCH_SIZE = "torch>=2.4", "about a gigabyte more"
TORCH_INDEX = "https://download.pytorch.org/whl/cpu"
"""Has PyTorch's builds for processors, which are a tenth of those with CUDA; pip prefers them to others of the same version."""
TIMEOUT = 300

_ASK = """
import importlib, json, sys
found, missing = {}, {}
for name in sys.argv[1:]:
    try:
        found[name] = str(getattr(importlib.import_module(name), "__version__", ""))
    except Exception as error:
        missing[name] = f"{type(error).__name__}: {error}"
print(json.dumps({"version": sys.version.split()[0], "found": found, "missing": missing}))
"""


@dataclass(frozen=True)
class Report:
    """What a Python has: versions by module, and why others cannot be imported."""

    python: str
    version: str
    found: dict[str, str]
    missing: dict[str, str]

    @property
    def ready(self) -> bool:
        return not set(NEEDED) & set(self.missing)

    @property
    def sentence(self) -> str:
        """What is missing, or that nothing is."""
        head = f"{self.python} (Python {self.version})"
        lacks = [NEEDED[name] for name in NEEDED if name in self.missing]
        if lacks:
            broken = next((f" ({self.missing[name][:160]})" for name in NEEDED if name in self.missing
                           and "No module named" not in self.missing[name]), "")
            return (f"{head} lacks {', '.join(lacks)}{broken}; install that there, choose another Python, or let one be made in the "
                    "preferences.")
        return f"{head} can train{f'; {lesser}' if (lesser := purposes(self.missing)) else ''}."


def purposes(missing: Container[str]) -> str:
    """A clause on what the missing modules of USEFUL are for; "" where none is missing."""
    needs = [f"{purpose} need {name}" for name, purpose in USEFUL.items() if name in missing]
    return f"{', '.join(needs)}, which it lacks" if needs else ""


def inspect(python: str) -> Report:
    """Try all imports in that Python, in a process of its own; raises FastGSError where it does not run."""
    command = [python, "-c", _ASK, *NEEDED, *USEFUL]
    try:
        done = subprocess.run(command, env=environment(python), stdin=subprocess.DEVNULL, capture_output=True, timeout=TIMEOUT, check=False,
                              **hidden())
        values = json.loads(done.stdout.decode(errors="replace").strip().splitlines()[-1])
        return Report(python, values["version"], values["found"], values["missing"])
    except subprocess.TimeoutExpired as error:
        raise FastGSError(f"{python}: the training Python does not answer within {TIMEOUT} seconds; choose another.") from error
    except OSError as error:
        raise FastGSError(f"{python}: the training Python does not start ({error.strerror}); choose another.") from error
    except (ValueError, KeyError, IndexError) as error:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
        raise FastGSError(f"{python}: this is no Python that works ({last[:200]}); choose another.") from error


def environment(python: str) -> dict[str, str]:
    """The environment variables of a process of that Python: Blender's own finds what Blender finds, another one only its own.

    The width of the terminal that Blender was started in is not among them: what the process says is read line by line.
    """
    values = {key: value for key, value in os.environ.items() if key not in {"PYTHONHOME", "PYTHONSTARTUP", "COLUMNS"}}
    if same_file(python, sys.executable):
        values["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    values["PYTHONUNBUFFERED"], values["PYTHONIOENCODING"] = "1", "utf-8"
    return values


def same_file(one: str, other: str) -> bool:
    """Whether two paths are the same program, as its environment sees it: links are not followed, a venv's python is one."""
    return os.path.normcase(os.path.abspath(one)) == os.path.normcase(os.path.abspath(other))


def python_in(place: str) -> str | None:
    """The Python that a path means: a program, or the folder of an environment; None where there is none."""
    path = Path(place)
    if path.is_file():
        return str(path)
    names = ("Scripts/python.exe", "python.exe") if sys.platform == "win32" else ("bin/python", "bin/python3")
    return next((str(path / name) for name in names if (path / name).is_file()), None)


class Maker:
    """A process that makes an environment for training: first the environment, then what is installed into it.

    folder  where; log: file for what it says
    index   of another package index than pip's usual one, which is then asked for everything
    torch   whether PyTorch is installed, too: its build for processors, where an index offers that
    """

    def __init__(self, folder: str | Path, log: str | Path, index: str = "", torch: bool = False):
        self.folder, self.log = Path(folder), Path(log)
        source = ["--index-url", index] if index else []
        python = self.folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
        install = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--no-input", *source]
        self._steps = [[sys.executable, "-m", "venv", "--clear", str(self.folder)], [*install, *INSTALLED]]
        if torch:
            self._steps.append([*install, *([] if index else ["--extra-index-url", TORCH_INDEX]), TORCH])
        self._process: subprocess.Popen | None = None
        self.failed = False

    def poll(self) -> bool:
        """Whether it is still at work; goes on to the next step where one has ended."""
        if self._process is not None:
            if self._process.poll() is None:
                return True
            self.failed = self._process.returncode != 0
            if self.failed:
                return False
        if not self._steps:
            return False
        command = self._steps.pop(0)
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with appending(self.log) as out:
            out.write(f"$ {' '.join(command)}\n".encode())
            out.flush()
            try:
                self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
                                                 env={k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}, **hidden())
            except OSError as error:
                out.write(f"{error}\n".encode())
                self.failed = True
                return False
        return True

    def wait(self, seconds: float) -> None:
        """Wait for the step under way, so long at most."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            if self._process is not None:
                self._process.wait(seconds)

    @property
    def last_line(self) -> str:
        """The last line of the process' output."""
        try:
            lines = read_bytes(self.log, LARGEST_JSON).decode("utf-8", "replace").strip().splitlines()
        except FastGSError:
            return ""
        errors = [line for line in lines if line.lower().startswith("error")] if self.failed else []
        return (errors or lines or [""])[-1][:200]

    def stop(self) -> None:
        """End it."""
        self._steps.clear()
        if self._process is not None:
            end(self._process)


def end(process: subprocess.Popen, patience: float = 2.0) -> None:
    """End a process: it may clear up for so many seconds, and is then killed."""
    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def hidden() -> dict:
    """Arguments for Popen with which a process opens no window of its own."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW}
    return {}
