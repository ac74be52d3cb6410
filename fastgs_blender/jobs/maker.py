# SPDX-License-Identifier: GPL-3.0-or-later
"""Installs a new environment for training, with pip.  The zip for Blender's store goes without this module.  No bpy here."""
import contextlib
import os
import subprocess
import sys
from pathlib import Path

from ..util.errors import FastGSError
from ..util.outputs import appending
from ..util.processes import end, hidden
from ..util.reading import LARGEST_JSON, read_bytes

INSTALLED = ("numpy>=1.26", "numba>=0.62", "safetensors>=0.4.3", "OpenEXR>=3.3", "pillow>=10", "tqdm>=4.60", "zstandard>=0.22",
             "wgpu>=0.32,<0.40", "av>=14", "pycolmap>=4.2")
"""What an environment gets, in the versions of pyproject.toml, which no extension brings along; a test compares them."""
SIZE = "about half a gigabyte"
TORCH, TORCH_SIZE = "torch>=2.4", "about a gigabyte more"
TORCH_INDEX = "https://download.pytorch.org/whl/cpu"
"""Has PyTorch's builds for processors, which are a tenth of those with CUDA; pip prefers them to others of the same version."""


class Maker:
    """A process that makes an environment for training: first the environment, then what is installed into it.

    folder  where; log: file for what it says
    index   of another package index than pip's usual one, which is then asked for everything
    torch   whether PyTorch is installed, too: its build for processors, where an index offers that
    """

    def __init__(self, folder: str | Path, log: str | Path, index: str = "", torch: bool = False) -> None:
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
