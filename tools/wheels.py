# SPDX-License-Identifier: GPL-3.0-or-later
"""The wheels that the extension's zip contains, for each platform and Python, and their licences."""
from __future__ import annotations

import importlib.metadata
import shutil
import subprocess
import sys
import zipfile
from email.parser import HeaderParser
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PACKAGES = {
    "numba": "BSD-2-Clause",
    "llvmlite": "BSD-2-Clause AND Apache-2.0 WITH LLVM-exception",
    "safetensors": "Apache-2.0",
    "OpenEXR": "BSD-3-Clause",
    "pillow": "MIT-CMU",
    "av": "BSD-3-Clause AND GPL-3.0-or-later",
    "tqdm": "MPL-2.0 AND MIT",
    "wgpu": "BSD-2-Clause",
    "rendercanvas": "BSD-2-Clause",
    "cffi": "MIT-0",
    "pycparser": "BSD-3-Clause",
}
"""What Blender's Python lacks, with its licence as SPDX writes it.  In the versions that the tests ran with.

Rendering needs the first three.  Captures have films (av, with FFmpeg in it), and pictures without their lenses' distortion (pillow);
training says how far it is (tqdm).  The last four are for GPUs: wgpu, which holds its library, and what it asks for.
"""
OPTIONAL = {"pycolmap": "BSD-3-Clause"}
"""What is brought along where there is a wheel for a platform and Python, and room: it finds cameras' poses and starting points."""
ROOM = 120_000_000
"""Bytes of wheels in a zip with those of OPTIONAL: a zip is to stay below 130 MB."""
FOR_ONE = {"macos-arm64": {"rubicon-objc": ("BSD-3-Clause", "0.5.7")}}
"""What one platform needs beside, with its licence and version: wgpu reaches Metal through Objective-C."""

SHIPPED = {
    "autopep8", "cattrs", "certifi", "charset-normalizer", "cython", "fastjsonschema", "idna", "numpy", "pycodestyle", "requests",
    "urllib3", "zstandard",
}
"""What Blender brings along itself, in versions of its own: never a wheel of ours.  No Blender brings OpenEXR's Python module."""

PYTHONS = {"linux-x64": ("3.11", "3.13", "3.14"), "windows-x64": ("3.11", "3.13"), "macos-arm64": ("3.11", "3.13")}
"""Blender 4.2 to 5.0 and 5.1 to 5.2; Linux distributions build Blender for their own Python, of late 3.14.  There is a zip for each:
Blender refuses one whose wheels are for another Python, and takes from a repository the one that fits."""

NUMPYS = {"3.11": ("1.24.3", "1.26.4"), "3.13": ("2.2.4", "2.5.5"), "3.14": ("2.4.6",)}
"""The oldest and newest numpy of the Blenders with a Python (1.24.3: 4.2 to 4.4; 1.26.4: 4.5 and 5.0)."""

TAGS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64",),
}


class Missing(Exception):
    """Wheels cannot be had; the text is a sentence that says which and why."""


def download(platform: str, python: str, folder: Path) -> list[Path]:
    """The wheels for a platform and one of its Pythons, from the package index that pip uses; raises Missing."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    needed = {package: importlib.metadata.version(package) for package in PACKAGES}
    needed |= {package: version for package, (_, version) in FOR_ONE.get(platform, {}).items()}
    for package, version in needed.items():
        _download(f"{package}=={version}", platform, python, folder)
    for package in OPTIONAL:
        try:
            _download(f"{package}=={importlib.metadata.version(package)}", platform, python, folder)
        except Missing:
            print(f"{platform} with Python {python} goes without {package}: pip has no wheel of it.")
        size = sum(wheel.stat().st_size for wheel in folder.glob("*.whl"))
        if size > ROOM:
            print(f"{platform} with Python {python} goes without {package}: the zip would have {size / 1e6:.0f} MB of wheels.")
            for wheel in folder.glob(f"{package}-*.whl"):
                wheel.unlink()
    return sorted(folder.glob("*.whl"), key=lambda path: path.name.lower())


def _download(wanted: str, platform: str, python: str, folder: Path) -> None:
    """One wheel; raises Missing."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:",
               "--implementation=cp", f"--python-version={python}", f"--dest={folder}"]
    command += [*(f"--platform={tag}" for tag in TAGS[platform]), wanted]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        errors = [line for line in result.stderr.splitlines() if line.startswith("ERROR")] or result.stderr.splitlines() or ["?"]
        raise Missing(f"{platform} with Python {python} is left out: pip has no wheel of {wanted} for it ({errors[-1]}).")


def problems(wheels: list[Path]) -> list[str]:
    """Sentences about what would not work in Blender: wheels that it ships, and what neither it nor a wheel provides."""
    found = []
    ours = {canonicalize_name(wheel.name.split("-")[0]): wheel.name.split("-")[1] for wheel in wheels}
    found += [f"{name} is Blender's own." for name in sorted(ours.keys() & SHIPPED)]
    for wheel in wheels:
        for line in _metadata(wheel).get_all("Requires-Dist") or ():
            need = Requirement(line)
            name = canonicalize_name(need.name)
            if need.marker is not None and not need.marker.evaluate({"extra": ""}):
                continue
            if name == "numpy":
                found += [f"{wheel.name} does not go with numpy {numpy} of Blenders with Python {python}." for python in _pythons(wheel)
                          for numpy in NUMPYS[python] if numpy not in need.specifier]
            elif name not in SHIPPED and not (name in ours and need.specifier.contains(ours[name], prereleases=True)):
                found.append(f"{wheel.name} needs {need}, which is not there.")
    return found


def notices(wheels: list[Path]) -> str:
    """Markdown: the wheels' names, versions and licences, and the texts of the licences that they bring along."""
    table, texts, seen = ["| package | version | licence |", "|---|---|---|"], [], set()
    for wheel in wheels:
        facts = _metadata(wheel)
        name, version = facts["Name"], facts["Version"]
        if name.lower() in seen:
            continue
        seen.add(name.lower())
        table.append(f"| {name} | {version} | {licence(name)} |")
        with zipfile.ZipFile(wheel) as file:
            files = (member for member in file.namelist() if not member.endswith("/"))
            members = sorted(member for member in files if ".dist-info/" in member and "/licen" in member.lower())
            if not members:
                raise ValueError(f"{wheel.name} brings no text of its licence.")
            for member in members:
                texts += [f"## {name}: {Path(member).name}", "", file.read(member).decode("utf-8", "replace").strip(), ""]
    head = ["# Software in this extension's wheels folder", "", "Unmodified, as its makers published it on the Python Package Index."]
    return "\n".join([*head, "", *table, "", *texts])


def licence(name: str) -> str:
    """SPDX of one of PACKAGES or FOR_ONE, however its name is written."""
    known = PACKAGES | OPTIONAL | {package: spdx for packages in FOR_ONE.values() for package, (spdx, _) in packages.items()}
    return next(spdx for package, spdx in known.items() if canonicalize_name(package) == canonicalize_name(name))


def _pythons(wheel: Path) -> list[str]:
    """The Pythons, of those in NUMPYS, that a wheel is for."""
    python, abi = wheel.stem.split("-")[2:4]
    return list(NUMPYS) if abi in ("abi3", "none") else [f"3.{python.removeprefix('cp3')}"]


def _metadata(wheel: Path):
    with zipfile.ZipFile(wheel) as file:
        name = next(member for member in file.namelist() if member.endswith(".dist-info/METADATA"))
        return HeaderParser().parsestr(file.read(name).decode("utf-8"))
