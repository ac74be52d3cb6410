# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zips, one for each system: the code, and the wheels of what Blender's Pythons lack.

    python tools/build_extension.py [--zip linux-x64 ...] [--store] [--no-wheels] [--website URL] [--out dist]

It also writes an index: with it the folder is an extension repository for Blender, on any web server or disk.  The build works on a copy of
the files that git knows; the manifest in the source tree names no wheels, so that it is valid there.  Blender's own tool, which comes with
the bpy wheel, validates and indexes.  The same commit gives the same bytes.
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
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import html_pages
import sbom
import wheels

ROOT = Path(__file__).resolve().parents[1]
CONTENT = ("__init__.py", "blender_manifest.toml", "LICENSE", "examples", "fastgs_blender", "scene", "engine",
           "operators", "ui")
NOT_IN_STORE = ("operators/make_environment.py", "fastgs_blender/jobs/maker.py")
"""What downloads packages with pip: Blender's store wants all that an extension needs in its zip.  Nothing else imports these modules."""
NOTICES, INSIDE = "THIRD-PARTY.md", "sbom.cdx.json"


def main(argv=None) -> list[Path]:
    """Builds, validates and prints the zips, and indexes them; returns their paths.  Ends with 1 if one cannot be built."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--zip", action="append", choices=tuple(wheels.ZIPS), help="default: all of them")
    parser.add_argument("--store", action="store_true", help="as extensions.blender.org takes them: one a system, without pip")
    parser.add_argument("--website", help="where this build and its site are published: Visit Website, documents and errors lead there")
    parser.add_argument("--no-wheels", action="store_true", help="for a Blender whose Python has numba and safetensors already")
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    args = parser.parse_args(argv)
    if args.no_wheels:
        return [build("", [], args.out, args.website, args.store)]
    built, missing = [], []
    for name in dict.fromkeys(args.zip or wheels.ZIPS):
        if args.store and name != wheels.platform_of(name):
            continue  # the store has a zip for each system, for the Blenders of blender.org
        try:
            built.append(build(name, wheels.download(name, ROOT / "build" / "wheels" / name), args.out, args.website, args.store))
        except wheels.Missing as reason:
            missing.append(str(reason))
    if built:
        index(built, args.out)
    if missing:
        sys.exit("\n".join(missing))
    return built


def build(name: str, bundled: list[Path], out: Path, website: str | None = None, store: bool = False) -> Path:
    """One validated zip in out, one of wheels.ZIPS or ("") for any system; ends the program where the wheels do not fit together."""
    out.mkdir(parents=True, exist_ok=True)
    if found := wheels.problems(bundled):
        sys.exit("\n".join(found))
    with tempfile.TemporaryDirectory() as temporary:
        stage = Path(temporary) / "extension"
        copy_content(stage, store, website)
        manifest = stage / "blender_manifest.toml"
        if name:
            (stage / "wheels").mkdir()
            for wheel in bundled:
                shutil.copy(wheel, stage / "wheels")
            (stage / NOTICES).write_text(wheels.notices(bundled), "utf-8")
        manifest.write_text(completed(manifest.read_text("utf-8"), wheels.platform_of(name), bundled, website, store), "utf-8")
        facts = tomllib.loads(manifest.read_text("utf-8"))
        (stage / INSIDE).write_text(sbom.text(facts, bundled, stage, made()), "utf-8")
        target = out / f"{'-'.join(part for part in (facts['id'], facts['version'], name) if part)}.zip"
        pack(stage, target)
    blender_ext("validate", str(target))
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB")
    for wheel in bundled:
        print(f"    {wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, {wheels.licence(wheel)}")
    return target


def pack(folder: Path, target: Path) -> None:
    """A folder as a zip whose bytes depend on its files alone: sorted, of one time, and stored, as libraries compress differently."""
    when = made().timetuple()[:6]
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as file:
        for path in sorted((path for path in folder.rglob("*") if path.is_file()), key=lambda path: path.relative_to(folder).as_posix()):
            entry = zipfile.ZipInfo(path.relative_to(folder).as_posix(), when)
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            file.writestr(entry, path.read_bytes())


def made() -> datetime:
    """When the commit was made, or what SOURCE_DATE_EPOCH says (reproducible-builds.org)."""
    return datetime.fromtimestamp(int(os.environ.get("SOURCE_DATE_EPOCH") or git("log", "-1", "--format=%ct")), UTC)


def git(*arguments: str) -> str:
    """What git prints about this working copy; ends the program where it is none."""
    result = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
    if result.returncode:
        sys.exit(f"The extension is built from a clone of its repository; git says: {result.stderr.strip()}")
    return result.stdout


def index(built: list[Path], out: Path) -> Path:
    """The index.json of an extension repository that holds these zips and lies beside them."""
    with tempfile.TemporaryDirectory(dir=out) as folder:
        for path in built:  # the folder may hold zips that are no part of this
            shutil.copy(path, folder)
        blender_ext("server-generate", "--repo-dir", folder)
        target = (Path(folder) / "index.json").replace(out / "index.json")
    print(f"{target}: a repository of {len(built)} zips")
    return target


def copy_content(stage: Path, store: bool = False, website: str | None = None):
    """What the extension consists of, and nothing that lies beside it."""
    for name in git("ls-files", "-z", "--", *CONTENT).split("\0"):
        if name and not (store and name in NOT_IN_STORE):
            (stage / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, stage / name)
    if website:
        module = stage / "fastgs_blender" / "util" / "documentation.py"
        module.write_text(module.read_text("utf-8").replace('WEBSITE = ""', f"WEBSITE = {json.dumps(published(website))}", 1), "utf-8")
    copy_pages(stage, website)


def published(website: str, path: Path = Path()) -> str:
    """The address of a file of the repository on the site that tools/website builds."""
    name = "" if path == Path() else re.sub(r"\.md$", ".html", re.sub(r"README\.md$", "index.html", path.as_posix()))
    return f"{website.rstrip('/')}/{name}"


def copy_pages(stage: Path, website: str | None = None):
    """README, CHANGELOG and docs/ as HTML, without pictures; a link to what is left out leads to the website, or becomes its words."""
    pages = [Path("README.md"), Path("CHANGELOG.md"), *(page.relative_to(ROOT) for page in (ROOT / "docs").glob("*.md"))]
    (stage / "docs").mkdir()

    def kept(link: re.Match) -> str:
        picture, words, target = link.groups()
        inside = Path(os.path.normpath(page.parent / target.partition("#")[0]))
        if "://" in target or target.startswith("#") or inside in pages or (stage / inside).exists():
            return link[0]
        if website:
            return f"[{words}]({published(website, inside)}{''.join(target.partition('#')[1:])})"
        return "" if picture else words

    for page in pages:
        text = re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", kept, (ROOT / page).read_text("utf-8"))
        home = "README.html" if page.parent.name else "docs/README.html"
        (stage / page).with_suffix(".html").write_text(html_pages.page(text, home), "utf-8")


def completed(manifest: str, platform: str, bundled: list[Path], website: str | None = None, store: bool = False) -> str:
    """The manifest with the website, the platform, its wheels and whom they belong to, before the first table.

    store  without the permission for the network, as nothing uses it then
    """
    lines = [line for line in manifest.splitlines() if not (store and line.startswith("network ="))]
    table = next((i for i, line in enumerate(lines) if line.startswith("[")), len(lines))
    added = [f"website = {json.dumps(website)}"] if website else []
    if platform:
        added += [f'platforms = ["{platform}"]', "wheels = [", *(f'  "./wheels/{wheel.name}",' for wheel in bundled), "]", ""]
        holders = [*tomllib.loads(manifest)["copyright"], *wheels.holders(bundled)]
        lines = [line if not line.startswith("copyright =") else f"copyright = {json.dumps(holders, ensure_ascii=False)}" for line in lines]
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
