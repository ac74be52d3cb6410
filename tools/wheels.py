# SPDX-License-Identifier: GPL-3.0-or-later
"""The wheels that the extension's zip contains, for each platform and Python, their licences and whom they belong to.

    python tools/wheels.py

writes tools/wheels.txt anew: the versions that this Python has, with the hash of each wheel that a zip may contain.
"""
from __future__ import annotations

import hashlib
import importlib.metadata
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from email.parser import HeaderParser
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PACKAGES = {
    "numba": ("BSD-2-Clause", "2012-2026 Anaconda, Inc. (numba)"),
    "llvmlite": ("BSD-2-Clause AND Apache-2.0 WITH LLVM-exception", "2014-2026 Anaconda, Inc. (llvmlite)", "2003-2026 LLVM contributors"),
    "safetensors": ("Apache-2.0", "2022-2026 Hugging Face (safetensors)"),
    "OpenEXR": ("BSD-3-Clause", "2002-2026 Contributors to the OpenEXR project"),
    "pillow": ("MIT-CMU", "1997-2011 Secret Labs AB (PIL)", "1995-2011 Fredrik Lundh and contributors (PIL)",
               "2010-2026 Jeffrey A. Clark and contributors (pillow)"),
    "av": ("BSD-3-Clause AND GPL-3.0-or-later", "2007-2026 PyAV contributors", "2000-2026 FFmpeg developers", "2003-2026 x264 project",
           "2013-2026 MulticoreWare, Inc. (x265)"),
    "tqdm": ("MPL-2.0 AND MIT", "2013 Noam Yorav-Raphael (tqdm)", "2015-2026 Casper da Costa-Luis and contributors (tqdm)"),
    "wgpu": ("BSD-2-Clause", "2019-2026 Almar Klein, Korijn van Golen (wgpu)", "2018-2026 The gfx-rs developers (wgpu-native)"),
    "rendercanvas": ("BSD-2-Clause", "2019-2026 rendercanvas developers"),
    "cffi": ("MIT-0", "2012-2026 Armin Rigo, Maciej Fijalkowski and contributors (cffi)"),
    "pycparser": ("BSD-3-Clause", "2008-2026 Eli Bendersky (pycparser)"),
}
"""What Blender's Python lacks: its licence as SPDX writes it, then the copyright holders as Blender's manifest writes them.

Rendering needs the first three.  Captures have films (av, with FFmpeg in it), and pictures without their lenses' distortion (pillow);
training says how far it is (tqdm).  The last four are for GPUs: wgpu, which holds its library, and what it asks for.
"""
OPTIONAL = {"pycolmap": ("BSD-3-Clause", "2018-2026 ETH Zurich and UNC Chapel Hill (COLMAP)")}
"""What is brought along where there is a wheel for a platform and Python, and room: it finds cameras' poses and starting points."""
ROOM = 190_000_000
"""Bytes of wheels in a zip with those of OPTIONAL: a zip is to stay below 200 MB."""
FOR_ONE = {"macos-arm64": {"rubicon-objc": ("BSD-3-Clause", "2011-2026 Phillip Nguyen, Russell Keith-Magee (rubicon-objc)")}}
"""What one platform needs beside: wgpu reaches Metal through Objective-C."""
LOCK = Path(__file__).with_name("wheels.txt")
"""Versions and hashes, as pip reads them.  The environments of make have the same versions, so that the tests ran with these."""

SHIPPED = {
    "autopep8", "cattrs", "certifi", "charset-normalizer", "cython", "fastjsonschema", "idna", "numpy", "pycodestyle", "requests",
    "urllib3", "zstandard",
}
"""What Blender brings along itself, in versions of its own: never a wheel of ours.  No Blender brings OpenEXR's Python module."""

ZIPS = {"linux-x64": ("3.11", "3.13"), "windows-x64": ("3.11", "3.13"), "macos-arm64": ("3.11", "3.13"), "linux-x64-python3.14": ("3.14",)}
"""The zips and the Pythons that each has wheels for.  Blender 4.2 to 5.0 and 5.1 to 5.2 share a zip, as Blender installs only the wheels
that fit its Python.  Linux distributions build Blender for their own Python, of late 3.14; with its wheels, too, the zip for Linux would
have 260 MB."""

NUMPYS = {"3.11": ("1.24.3", "1.26.4"), "3.13": ("2.2.4", "2.5.5"), "3.14": ("2.4.6",)}
"""The oldest and newest numpy of the Blenders with a Python (1.24.3: 4.2 to 4.4; 1.26.4: 4.5 and 5.0)."""

TAGS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64",),
}


class Missing(Exception):
    """Wheels cannot be had; the text is a sentence that says which and why."""


def platform_of(name: str) -> str:
    """The platform of one of ZIPS, as Blender's manifest calls it."""
    return name.partition("-python")[0]


def download(name: str, folder: Path) -> list[Path]:
    """The wheels of one of ZIPS, as LOCK has them, from the package index that pip uses; raises Missing."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    platform, pythons, locked = platform_of(name), ZIPS[name], locks()
    for python in pythons:
        _download([locked[package] for package in (*PACKAGES, *FOR_ONE.get(platform, ()))], platform, python, folder)
    for package in OPTIONAL:
        try:
            for python in pythons:
                _download([locked[package]], platform, python, folder)
        except Missing:
            print(f"{name} goes without {package}: pip has no wheel of it.")
            _remove(package, folder)
        size = sum(wheel.stat().st_size for wheel in folder.glob("*.whl"))
        if size > ROOM:
            print(f"{name} goes without {package}: the zip would have {size / 1e6:.0f} MB of wheels.")
            _remove(package, folder)
    return sorted(folder.glob("*.whl"), key=lambda path: path.name.lower())


def locks() -> dict[str, str]:
    """Package -> its version and hashes, a requirement as pip reads it."""
    lines = LOCK.read_text("utf-8").replace("\\\n", "").splitlines()
    return {line.partition("==")[0]: line for line in lines if "==" in line}


def lock() -> None:
    """Write LOCK: the versions of this Python's packages, and of FOR_ONE as it was, with the hashes of all wheels."""
    found: dict[str, set[str]] = {}
    kept = {package: re.split(r"==|\s", line)[1] for package, line in locks().items()}
    with tempfile.TemporaryDirectory() as temporary:
        for name, pythons in ZIPS.items():
            platform = platform_of(name)
            packages = [*PACKAGES, *OPTIONAL, *FOR_ONE.get(platform, ())]
            versions = {package: kept[package] if platform in FOR_ONE and package in FOR_ONE[platform]
                        else importlib.metadata.version(package) for package in packages}
            for python in pythons:
                _download([f"{package}=={version}" for package, version in versions.items()], platform, python, Path(temporary))
            for package, version in versions.items():
                found.setdefault(f"{package}=={version}", set())
        for wheel in Path(temporary).glob("*.whl"):
            line = next(line for line in found if canonicalize_name(line.partition("==")[0]) == _package(wheel))
            found[line].add(digest(wheel))
    head = "# The wheels in the extension's zips, written by tools/wheels.py.  The environments of make have the same versions."
    lines = [" \\\n    ".join([line, *(f"--hash=sha256:{each}" for each in sorted(found[line]))]) for line in sorted(found, key=str.lower)]
    LOCK.write_text("\n".join([head, *lines, ""]), "utf-8")


def digest(file: Path) -> str:
    """The SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _download(wanted: list[str], platform: str, python: str, folder: Path) -> None:
    """The wheels of requirements; raises Missing.  Where these have hashes, pip takes no other file."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:",
               "--implementation=cp", f"--python-version={python}", f"--dest={folder}", *(f"--platform={tag}" for tag in TAGS[platform])]
    with tempfile.TemporaryDirectory() as temporary:
        (requirements := Path(temporary, "requirements.txt")).write_text("\n".join([*wanted, ""]), "utf-8")
        result = subprocess.run([*command, "-r", str(requirements)], capture_output=True, text=True, check=False)
    if result.returncode:
        errors = [line for line in result.stderr.splitlines() if line.startswith("ERROR")] or result.stderr.splitlines() or ["?"]
        raise Missing(f"{platform} with Python {python} is left out: pip does not have all its wheels ({errors[-1]}).")


def _remove(package: str, folder: Path) -> None:
    for wheel in folder.glob(f"{package}-*.whl"):
        wheel.unlink()


def problems(wheels: list[Path]) -> list[str]:
    """Sentences about what would not work in Blender: wheels that it ships, and what neither it nor a wheel provides."""
    found = []
    ours = {_package(wheel): wheel.name.split("-")[1] for wheel in wheels}
    found += [f"{name} is Blender's own." for name in sorted(ours.keys() & SHIPPED)]
    for wheel in wheels:
        for line in metadata(wheel).get_all("Requires-Dist") or ():
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
        facts = metadata(wheel)
        name, version = facts["Name"], facts["Version"]
        if name.lower() in seen:
            continue
        seen.add(name.lower())
        table.append(f"| {name} | {version} | {licence(wheel)} |")
        with zipfile.ZipFile(wheel) as file:
            files = (member for member in file.namelist() if not member.endswith("/"))
            members = sorted(member for member in files if ".dist-info/" in member and "/licen" in member.lower())
            if not members:
                raise ValueError(f"{wheel.name} brings no text of its licence.")
            for member in members:
                texts += [f"## {name}: {Path(member).name}", "", file.read(member).decode("utf-8", "replace").strip(), ""]
    head = ["# Software in this extension's wheels folder", "", "Unmodified, as its makers published it on the Python Package Index."]
    return "\n".join([*head, "", *table, "", *texts])


def licence(wheel: Path) -> str:
    """SPDX of a wheel's package."""
    return _known(wheel)[0]


def holders(wheels: list[Path]) -> list[str]:
    """Whom the wheels belong to, each once, as Blender's manifest writes it: years and a name."""
    return list(dict.fromkeys(holder for wheel in wheels for holder in _known(wheel)[1:]))


def _known(wheel: Path) -> tuple[str, ...]:
    """What PACKAGES, OPTIONAL or FOR_ONE says of a wheel, however its name is written."""
    known = PACKAGES | OPTIONAL | {package: facts for packages in FOR_ONE.values() for package, facts in packages.items()}
    return next(facts for package, facts in known.items() if canonicalize_name(package) == _package(wheel))


def _package(wheel: Path) -> str:
    return canonicalize_name(wheel.name.split("-")[0])


def _pythons(wheel: Path) -> list[str]:
    """The Pythons, of those in NUMPYS, that a wheel is for."""
    python, abi = wheel.stem.split("-")[2:4]
    return list(NUMPYS) if abi in ("abi3", "none") else [f"3.{python.removeprefix('cp3')}"]


def metadata(wheel: Path):
    """What a wheel says of itself."""
    with zipfile.ZipFile(wheel) as file:
        name = next(member for member in file.namelist() if member.endswith(".dist-info/METADATA"))
        return HeaderParser().parsestr(file.read(name).decode("utf-8"))


if __name__ == "__main__":
    lock()
