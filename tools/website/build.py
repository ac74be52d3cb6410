# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the site, from README and docs/ as they are.

    python tools/website/build.py [--website URL] [--out dist]

The site works from a folder, by a double click on its index.html.  If --out holds the zips of `make extension`, their index lies beside it,
and the first page offers them.  The models of `gallery.py --models` play on pages of their own.
"""
from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONFIG = Path(__file__).with_name("mkdocs.yml")
sys.path.insert(0, str(Path(__file__).parent))

import gallery  # noqa: E402

WORK = ROOT / "build" / "website"


def main(argv=None) -> Path:
    """Builds the site and copies it to --out; returns its first page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument("--website", default="", help="the address where it is published, if it is known")
    args = parser.parse_args(argv)
    stage(WORK / "pages")
    for name in gallery.ENTRIES:
        if gallery.model_of(name).exists():
            gallery.play(name, WORK / "pages" / "play" / f"{name}.html")
    generate(WORK / "pages", WORK / "site", args.out, args.website)
    return publish(WORK / "site", args.out)


def pages() -> list[Path]:
    """The pages of the repository, relative to it."""
    return [Path(name) for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(
        page.relative_to(ROOT) for page in (ROOT / "docs").rglob("*.md"))


def stage(folder: Path) -> None:
    """The pages, the files that they link to and the gallery's pictures, in the folders where they lie in the repository."""
    shutil.rmtree(folder, ignore_errors=True)
    for page in pages():
        linked = re.findall(r"\]\(([^)#\s]+)", (ROOT / page).read_text("utf-8"))
        inside = {Path(os.path.normpath(page.parent / target)) for target in linked if "://" not in target}
        for file in {page, *(path for path in inside if (ROOT / path).is_file())}:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / file, folder / file)
    shutil.copytree(ROOT / "docs" / "gallery", folder / "docs" / "gallery")


def generate(staged: Path, site: Path, out: Path, website: str = "") -> None:
    """The site of staged pages, for a folder that may hold a repository's index.  A link that leads nowhere ends the program."""
    words = {"SITE_PAGES": str(staged), "SITE_URL": website, "SITE_OUT": str(out.resolve()), "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run([sys.executable, "-m", "mkdocs", "build", "--config-file", str(CONFIG), "--site-dir", str(site)],
                           env=os.environ | words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if built.returncode:
        sys.exit(f"{built.stdout}The site was not built.")


def publish(site: Path, out: Path) -> Path:
    """The site in out, in the place of an earlier one and beside all else that lies there."""
    out.mkdir(parents=True, exist_ok=True)
    for part in site.iterdir():
        if part.is_dir():
            shutil.rmtree(out / part.name, ignore_errors=True)
            shutil.copytree(part, out / part.name)
        else:
            shutil.copy(part, out)
    print(f"{out / 'index.html'}: {sum(path.stat().st_size for path in site.rglob('*') if path.is_file()) / 1e6:.1f} MB")
    return out / "index.html"


if __name__ == "__main__":
    main()
