# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache folder of compiled kernels: its place, its size, and whether all kernels are in it.  Does not import numba."""
from __future__ import annotations

import hashlib
import os
import shutil
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

COMPLETE = "complete"
"""Name of the file that says that a compilation ahead came to its end."""
FIRST = "first"
"""Name of the file that says that a compilation ahead has what a first picture needs."""
_chosen: Path | None = None


def use_folder(path) -> None:
    """Keep compiled kernels under this folder; to be called before the kernels are imported, else it holds from the next start."""
    global _chosen
    _chosen = Path(path)


def base_folder() -> Path:
    """$FASTGS_CACHE_DIR, else what use_folder() said, else the system's place for caches."""
    return _chosen if _chosen and not os.environ.get("FASTGS_CACHE_DIR") else user_folder()


def user_folder() -> Path:
    """$FASTGS_CACHE_DIR, else the system's place for caches: what all of a user's programs share, Blender among them."""
    if os.environ.get("FASTGS_CACHE_DIR"):
        return Path(os.environ["FASTGS_CACHE_DIR"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "fastgs-blender"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "fastgs-blender"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fastgs-blender"


@cache
def _digest() -> str:
    sources = sorted(Path(__file__).parent.glob("*.py"))
    # compiled code refers to its modules by name, and Blender has names of its own; each Python compiles for itself
    names = f"{__package__} {sys.implementation.cache_tag}".encode()
    return hashlib.sha256(b"".join([names, *(p.read_bytes() for p in sources)])).hexdigest()[:12]


def folder() -> Path:
    """The folder of this version's kernels: under a digest of their sources, so that an update never runs old code."""
    return base_folder() / f"kernels-{_digest()}"


def is_filled() -> bool:
    """Whether all kernels that warm.py compiles have been compiled, by this version."""
    return (folder() / COMPLETE).is_file()


def is_begun() -> bool:
    """Whether any kernel of this version has been compiled."""
    return any(folder().rglob("*.nbi"))


def has_first() -> bool:
    """Whether the kernels of a plain picture, and of a viewport's order, have been compiled, by this version."""
    return (folder() / FIRST).is_file()


def mark(name: str) -> None:
    """Note how far warm.py has come: FIRST or COMPLETE; where the folder cannot be written, nothing is noted."""
    with suppress(OSError):
        folder().mkdir(parents=True, exist_ok=True)
        (folder() / name).touch()


def size() -> int:
    """Bytes of all compiled kernels, of older versions too."""
    return sum(p.stat().st_size for p in base_folder().glob("kernels-*/**/*") if p.is_file())


def clear() -> None:
    """Delete all compiled kernels; they are compiled again when they are needed."""
    for path in base_folder().glob("kernels-*"):
        shutil.rmtree(path, ignore_errors=True)
