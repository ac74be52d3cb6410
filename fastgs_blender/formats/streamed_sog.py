# SPDX-License-Identifier: GPL-3.0-or-later
"""Streamed SOG of PlayCanvas: one scene in several levels of detail, each cut into chunks that are SOG in folders, or in .sog files.

lod-meta.json has lodLevels, filenames (of the chunks: 0_0/meta.json, or 0_0.sog), tree and, perhaps, environment.  A node of the tree has
children, or lods: {level: {file, offset, count}}, the Gaussians offset .. offset + count - 1 of a chunk.  A level is all Gaussians that
nodes name for it; level 0 is the finest.  The environment is a chunk that is shown with every level, as PlayCanvas' engine shows it.
All lie in a folder, or in a zip file.

A path names the level: scene/lod-meta.json is the finest one, scene/lod-meta[2].json is level 2 of the same file.
"""
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..model.gaussians import GaussianModel
from ..util.errors import FastGSError
from . import pixel_tables as tables
from .description import read_table, whole_number
from .scenes import together
from .sog import decoded
from .static import StaticFormat, read_whole

META = "lod-meta.json"
LEVEL = re.compile(r"(lod-meta)\[(\d{1,4})\](\.json)", re.IGNORECASE)
MAX_META = 1 << 26
"""Bytes of lod-meta.json."""


class StreamedSog(StaticFormat):
    name = "streamed SOG"
    reads = (META,)

    def sniff(self, head: bytes, path: Path) -> bool:
        if parted(path)[1] is not None:
            return True
        meta = tables.meta_of(head, path, META, MAX_META)
        return "lodLevels" in meta and isinstance(meta.get("filenames"), list) and isinstance(meta.get("tree"), dict)

    def load(self, path: Path) -> GaussianModel:
        place, level = parted(path)
        level = level or 0
        with tables.opened(place, META) as files:
            meta = files.meta(MAX_META)
            if meta.get("version", 1) != 1:
                raise FastGSError("it is of a version of streamed SOG that is not known; export it again.")
            levels = whole_number(meta.get("lodLevels"), "the number of levels")
            if level >= levels:
                raise FastGSError(f"it has the levels 0 to {levels - 1}, of which 0 is the finest; choose one of them.")
            parts = [_part(_chunk(files, name), ranges) for name, ranges in _ranges(meta, level).items()]
            if not parts:
                raise FastGSError(f"its level {level} has no Gaussians; choose another one.")
            if meta.get("environment"):
                parts.append(_chunk(files, tables.below(meta["environment"])))
        return together(parts)


def parted(path: Path) -> tuple[Path, int | None]:
    """The file that a path with a level stands for, and the level; any other path as it is, and None."""
    found = LEVEL.fullmatch(path.name)
    return (path.with_name(found[1] + found[3]), int(found[2])) if found and not os.path.lexists(path) else (path, None)


def with_level(path: Path, level: int) -> Path:
    """The path of a level of a lod-meta.json; another path, and the finest level, as they are."""
    if path.name.lower() != META or not level:
        return path
    return path.with_name(f"{path.stem}[{level}]{path.suffix}")


def chunk_folders(path: Path) -> list[Path]:
    """The folders of the chunks that a lod-meta.json names, those that are there.  Raises FastGSError."""
    meta = read_table(read_whole(parted(path)[0], MAX_META))
    names = [*meta.get("filenames", ()), *filter(None, [meta.get("environment")])]
    folders = {path.parent.joinpath(*tables.below(name)[:-1]) for name in names}
    return sorted(folder for folder in folders - {path.parent} if folder.is_dir())


def _chunk(files: Any, name: tuple[str, ...]) -> GaussianModel:
    """The model of a chunk."""
    for folder in name[:-1]:
        files = files.within(folder)
    if not name[-1].lower().endswith(".sog"):
        return decoded(read_table(files.read(name[-1], tables.MAX_META)), files)
    if isinstance(files, tables.Archive):
        raise FastGSError("its chunks are zip files in a zip file; unpack it, and open its lod-meta.json.")
    files.size(name[-1])
    with tables.opened(files.folder / name[-1]) as inner:
        return decoded(inner.meta(), inner)


def _part(chunk: GaussianModel, ranges: list[tuple[int, int]]) -> GaussianModel:
    """The Gaussians of a chunk in ranges of first and last + 1, each once, in the chunk's order."""
    shown = np.zeros(len(chunk), bool)
    for first, end in ranges:
        if end > len(chunk):
            raise FastGSError("its tree names more Gaussians than a chunk has; export it again.")
        shown[first:end] = True
    return chunk if shown.all() else chunk.take(shown)


def _ranges(meta: dict, level: int) -> dict[tuple[str, ...], list[tuple[int, int]]]:
    """{a chunk's name: ranges of first and last + 1 of its Gaussians} of a level, in the order of the chunks.  Raises FastGSError."""
    names = meta["filenames"]
    found: dict[int, list[tuple[int, int]]] = {}
    for lods in _leaves(meta.get("tree")):
        place = lods.get(str(level))
        if place is None:
            continue
        number, first, count = (whole_number(place.get(key, 0), f"the {key} of a chunk") for key in ("file", "offset", "count"))
        if count:
            found.setdefault(number, []).append((first, first + count))
    chunks: dict[tuple[str, ...], list[tuple[int, int]]] = {}
    for number in sorted(found):  # one file may be listed under two numbers
        chunks.setdefault(tables.below(names[number]), []).extend(found[number])
    return chunks


def _leaves(tree: Any) -> Iterator[dict]:
    """The lods of all leaves: nodes that have them, as the engine takes them."""
    stack = [tree]
    while stack:
        node = stack.pop()
        if isinstance(node.get("lods"), dict):
            yield node["lods"]
        else:
            stack += reversed(node.get("children", []))
