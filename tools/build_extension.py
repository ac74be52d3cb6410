# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zips, one for each platform and Python: the code, and the wheels of what Blender's Python lacks.

    python tools/build_extension.py [--platform linux-x64 ...] [--python 3.13 ...] [--no-wheels] [--website URL] [--out dist]

It also writes an index: with it the folder is an extension repository for Blender, on any web server or disk.  The build works on a copy of
the files; the manifest in the source tree names no wheels, so that it is valid there.  Blender's own tool, which comes with the bpy wheel,
builds, validates and indexes.
"""
from __future__ import annotations

import argparse
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import html_pages
import wheels

ROOT = Path(__file__).resolve().parents[1]
CONTENT = ("__init__.py", "blender_manifest.toml", "LICENSE", "examples", "fastgs_blender", "scene", "engine",
           "operators", "ui")
NOTICES = "THIRD-PARTY.md"


def main(argv=None) -> list[Path]:
    """Builds, validates and prints the zips, and indexes them; returns their paths.  Ends with 1 if one cannot be built."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--platform", action="append", choices=tuple(wheels.PYTHONS), help="default: all of them")
    parser.add_argument("--python", action="append", choices=sorted({python for all_ in wheels.PYTHONS.values() for python in all_}),
                        help="default: all that Blenders for the platform have")
    parser.add_argument("--website", help="the address that Blender's Visit Website opens: where this build is published")
    parser.add_argument("--no-wheels", action="store_true", help="for a Blender whose Python has numba and safetensors already")
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    args = parser.parse_args(argv)
    if args.no_wheels:
        return [build("", [], args.out, args.website)]
    built, missing = [], []
    for platform in dict.fromkeys(args.platform or wheels.PYTHONS):
        for python in (python for python in wheels.PYTHONS[platform] if python in (args.python or wheels.PYTHONS[platform])):
            try:
                bundled = wheels.download(platform, python, ROOT / "build" / "wheels" / f"{platform}-{python}")
                built.append(build(platform, bundled, args.out, args.website, python))
            except wheels.Missing as reason:
                missing.append(str(reason))
    if built:
        index(built, args.out)
    if missing:
        sys.exit("\n".join(missing))
    return built


def build(platform: str, bundled: list[Path], out: Path, website: str | None = None, python: str = "") -> Path:
    """One validated zip in out, for a platform and a Python or ("") for any; ends the program where the wheels do not fit together."""
    out.mkdir(parents=True, exist_ok=True)
    if found := wheels.problems(bundled):
        sys.exit("\n".join(found))
    with tempfile.TemporaryDirectory() as temporary:
        stage = Path(temporary) / "extension"
        copy_content(stage)
        manifest = stage / "blender_manifest.toml"
        if platform:
            (stage / "wheels").mkdir()
            for wheel in bundled:
                shutil.copy(wheel, stage / "wheels")
            (stage / NOTICES).write_text(wheels.notices(bundled), "utf-8")
        manifest.write_text(completed(manifest.read_text("utf-8"), platform, bundled, website), "utf-8")
        facts = tomllib.loads(manifest.read_text("utf-8"))
        name = "-".join(part for part in (facts["id"], facts["version"], platform, python and f"python{python}") if part)
        target = out / f"{name}.zip"
        blender_ext("build", "--source-dir", str(stage), "--output-filepath", str(target))
    blender_ext("validate", str(target))
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB")
    for wheel in bundled:
        print(f"    {wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, {wheels.licence(wheel.name.split('-')[0])}")
    return target


def index(built: list[Path], out: Path) -> Path:
    """The index.json of an extension repository that holds these zips and lies beside them."""
    with tempfile.TemporaryDirectory(dir=out) as folder:
        for path in built:  # the folder may hold zips that are no part of this
            shutil.copy(path, folder)
        blender_ext("server-generate", "--repo-dir", folder)
        target = (Path(folder) / "index.json").replace(out / "index.json")
    print(f"{target}: a repository of {len(built)} zips")
    return target


def copy_content(stage: Path):
    """What the extension consists of, and nothing that lies beside it."""
    stage.mkdir()
    for item in CONTENT:
        if (ROOT / item).is_dir():
            shutil.copytree(ROOT / item, stage / item, ignore=shutil.ignore_patterns("__pycache__", ".*", "py.typed"))
        else:
            shutil.copy(ROOT / item, stage / item)
    copy_pages(stage)


def copy_pages(stage: Path):
    """README, CHANGELOG and docs/ as HTML, with their pictures; a link to what the extension leaves out becomes its words."""
    pages = [Path("README.md"), Path("CHANGELOG.md"), *(page.relative_to(ROOT) for page in (ROOT / "docs").glob("*.md"))]
    (stage / "docs").mkdir()

    def kept(link: re.Match) -> str:
        picture, words, target = link.groups()
        inside = Path(os.path.normpath(page.parent / target.partition("#")[0]))
        if inside.parent.name == "docs" and inside.suffix in (".png", ".webp"):
            shutil.copy(ROOT / inside, stage / inside)
        if "://" in target or target.startswith("#") or inside in pages or (stage / inside).exists():
            return link[0]
        return "" if picture else words

    for page in pages:
        text = re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", kept, (ROOT / page).read_text("utf-8"))
        home = "README.html" if page.parent.name else "docs/README.html"
        (stage / page).with_suffix(".html").write_text(html_pages.page(text, home), "utf-8")


def completed(manifest: str, platform: str, bundled: list[Path], website: str | None = None) -> str:
    """The manifest with the platform, its wheels and the website, before the first table."""
    lines = manifest.splitlines()
    table = next((i for i, line in enumerate(lines) if line.startswith("[")), len(lines))
    added = [f"website = {json.dumps(website)}"] if website else []
    if platform:
        added += [f'platforms = ["{platform}"]', "wheels = [", *(f'  "./wheels/{wheel.name}",' for wheel in bundled), "]", ""]
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
