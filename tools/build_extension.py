# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zip for one platform or for all: the code, and the wheels of what Blender's Python lacks.

    python tools/build_extension.py [--platform linux-x64 ...] [--no-wheels] [--out dist]

Works on a staged copy; the repository's manifest names no wheels, so that it is valid as it stands.  Building and validating is
done by Blender's own tool, which comes with the bpy wheel.
"""
from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import platform
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONTENT = ("__init__.py", "blender_manifest.toml", "LICENSE", "README.md", "fastgs_blender", "engine", "operators", "ui")

PYTHONS = {"linux-x64": ("3.11", "3.13", "3.14"), "windows-x64": ("3.11", "3.13"), "macos-arm64": ("3.11", "3.13")}
"""Blender 4.2 to 5.0 and 5.1 to 5.2; Linux distributions build Blender for their own Python, of late 3.14.  The wheel of a Python
that is not Blender's is ignored at installation, but a Python that no wheel is for is refused."""

WHEELS = ("numba", "llvmlite", "safetensors")
"""In the versions that the tests ran with.  numpy is Blender's own (1.26 to 2.x, all of which numba 0.61 and later accept)."""

PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64",),
}


def main(argv=None) -> list[Path]:
    """Builds, validates and prints the zips; returns their paths."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", action="append", choices=(*PLATFORMS, "all"), help="default: this machine's")
    parser.add_argument("--no-wheels", action="store_true", help="for a Blender whose Python has numba and safetensors already")
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    args = parser.parse_args(argv)
    wanted = args.platform or [this_platform()]
    wanted = list(PLATFORMS) if "all" in wanted else list(dict.fromkeys(wanted))
    return [build(None, [], args.out)] if args.no_wheels else [build(name, download(name), args.out) for name in wanted]


def this_platform() -> str:
    """Blender's name of this machine's platform; ends the program where there is none."""
    system = {"Linux": "linux", "Windows": "windows", "Darwin": "macos"}.get(platform.system())
    machine = {"x86_64": "x64", "amd64": "x64", "arm64": "arm64", "aarch64": "arm64"}.get(platform.machine().lower())
    name = f"{system}-{machine}"
    if name not in PLATFORMS:
        sys.exit(f"There are no wheels for {name}; choose --platform {', '.join(PLATFORMS)}, or --no-wheels.")
    return name


def download(name: str) -> list[Path]:
    """The wheels for a platform, all Pythons, kept in build/wheels."""
    folder = ROOT / "build" / "wheels" / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    packages = [f"{package}=={importlib.metadata.version(package)}" for package in WHEELS]
    for python in PYTHONS[name]:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary=:all:",
                   "--implementation=cp", f"--python-version={python}", f"--dest={folder}"]
        command += [f"--platform={tag}" for tag in PLATFORMS[name]]
        result = subprocess.run([*command, *packages], capture_output=True, text=True, check=False)
        if result.returncode:
            sys.exit(f"{result.stderr}\nThe wheels for {name} and Python {python} could not be downloaded; the reason stands above.")
    return sorted(folder.glob("*.whl"))


def build(name: str | None, wheels: list[Path], out: Path) -> Path:
    """One validated zip in out, for a platform or (None) for any."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        stage = Path(temporary) / "extension"
        copy_content(stage)
        manifest = stage / "blender_manifest.toml"
        if name:
            (stage / "wheels").mkdir()
            for wheel in wheels:
                shutil.copy(wheel, stage / "wheels")
            manifest.write_text(with_wheels(manifest.read_text("utf-8"), name, wheels), "utf-8")
        facts = tomllib.loads(manifest.read_text("utf-8"))
        target = out / f"{facts['id']}-{facts['version']}{f'-{name}' if name else ''}.zip"
        blender_ext("build", "--source-dir", str(stage), "--output-filepath", str(target))
    blender_ext("validate", str(target))
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB")
    for wheel in wheels:
        print(f"    {wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
    return target


def copy_content(stage: Path):
    """What the extension consists of, and nothing that lies beside it."""
    stage.mkdir()
    for item in CONTENT:
        if (ROOT / item).is_dir():
            shutil.copytree(ROOT / item, stage / item, ignore=shutil.ignore_patterns("__pycache__", ".*"))
        else:
            shutil.copy(ROOT / item, stage / item)


def with_wheels(manifest: str, name: str, wheels: list[Path]) -> str:
    """The manifest with the platform and its wheels, before the first table."""
    lines = manifest.splitlines()
    table = next((i for i, line in enumerate(lines) if line.startswith("[")), len(lines))
    added = [f'platforms = ["{name}"]', "wheels = [", *(f'  "./wheels/{wheel.name}",' for wheel in wheels), "]", ""]
    return "\n".join([*lines[:table], *added, *lines[table:], ""])


def blender_ext(*arguments: str):
    """Run Blender's extension tool; ends the program with its words where it objects."""
    spec = importlib.util.find_spec("bpy")
    found = sorted(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")) if spec else []
    if not found:
        sys.exit("Blender's extension tool was not found; it comes with bpy, so run this in .venv (make extension does).")
    result = subprocess.run([sys.executable, str(found[0]), *arguments], capture_output=True, text=True, check=False)
    if result.returncode:
        sys.exit(f"blender_ext {' '.join(arguments)}:\n{result.stdout}{result.stderr}")


if __name__ == "__main__":
    main()
