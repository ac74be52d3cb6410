# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Python that trains, and lists the packages that it lacks.  No bpy here."""
import json
import os
import subprocess
import sys
from collections.abc import Container
from dataclasses import dataclass
from pathlib import Path

from ..util.errors import FastGSError
from ..util.processes import hidden

NEEDED = {"numba": "numba", "safetensors": "safetensors", "PIL": "pillow", "tqdm": "tqdm", "numpy": "numpy"}
"""Modules without which training does not run, and the packages that have them."""
USEFUL = {"av": "films", "pycolmap": "cameras without poses and starting points from pictures", "OpenEXR": "EXR pictures"}
"""Modules, called as their packages are, and what they are for."""
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
            return f"{head} lacks {', '.join(lacks)}{broken}; install that there, or choose another Python in the preferences."
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
