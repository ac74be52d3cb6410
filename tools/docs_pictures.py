# SPDX-License-Identifier: GPL-3.0-or-later
"""Take the screenshots of the last `make test-blender` over into docs/, small enough for a repository."""
from __future__ import annotations

import io
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("first-solid", "solid", "rendered", "f12", "crop", "overlays", "cameras", "training", "trained", "baked",
         "ordinary-joined", "first-preferences", "sequence-panel")
LIMIT = 400_000
"""Bytes of a picture."""
PAGES = {"page-dialog": (249, 28, 1280, 778), "page-desktop": None, "page-phone": (0, 96, 390, 844)}
"""Pictures of web pages and of the dialog that makes them, alike in all Blenders; and the part (left, top, right, bottom) to take."""
PAGE_LIMIT = 60_000


def packed(path: Path) -> bytes:
    """The picture as PNG; where it would be too large, without its lowest bits.  A palette would show in soft splats."""
    image = Image.open(path).convert("RGB")
    for step in (1, 2, 4, 8):
        buffer = io.BytesIO()
        image.point(lambda value, step=step: min((value + step // 2) // step * step, 255)).save(buffer, "PNG", optimize=True)
        if buffer.tell() < LIMIT:
            return buffer.getvalue()
    sys.exit(f"{path} does not fit into {LIMIT} bytes.")


def main():
    """For each Blender that was tested: docs/blender-VERSION-NAME.png, where a page names it; docs/NAME.webp of web pages."""
    pages = "".join(page.read_text("utf-8") for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
    tested = sorted({path.parent for name in (*NAMES, *PAGES) for path in (ROOT / "build" / "blender").glob(f"*/{name}.png")})
    if not tested:
        sys.exit("There are no screenshots; make test-blender takes them.")
    for folder in tested:
        version = next(folder.glob("home/.config/blender/[0-9]*.[0-9]*")).name
        for name in NAMES:
            picture, target = folder / f"{name}.png", ROOT / "docs" / f"blender-{version}-{name}.png"
            if picture.exists() and target.name in pages:
                target.write_bytes(packed(picture))
                print(f"{target.relative_to(ROOT)}: {target.stat().st_size / 1000:.0f} kB")
    for name, part in PAGES.items():
        for picture in sorted((ROOT / "build" / "blender").glob(f"*/{name}.png"))[:1]:
            target = ROOT / "docs" / f"{name}.webp"
            for quality in (80, 65, 50):
                Image.open(picture).convert("RGB").crop(part).save(target, quality=quality, method=6)
                if target.stat().st_size < PAGE_LIMIT:
                    break
            print(f"{target.relative_to(ROOT)}: {target.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
