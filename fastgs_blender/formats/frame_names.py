# SPDX-License-Identifier: GPL-3.0-or-later
"""Which names of files are models, which are frames of one sequence, and which of them a training saved last."""
import os
import re
from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

from ..util.errors import FastGSError
from .pixel_tables import META

EXTENSIONS = (".compressed.ply", ".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb", ".gltf")
"""Of files that are taken for frames."""
ALONE = (".safetensors", ".4dgs", ".splat4d", ".splatv", *EXTENSIONS)
"""Of models in a zip file without a sequence; the first of them is read."""
CHECKPOINTS = (".pt", ".pth", ".ckpt")
"""Of models in a zip file that holds none of ALONE, beside which these are decoders, or the same model before it was exported."""
HIDDEN = re.compile(r"(^|/)(\.(?!\.?/)|__MACOSX/)")
POINTS = ("input.ply", "points3d.ply", "sparse_pc.ply")
"""What trainers call the points that they began with, which lie beside their models."""
SAVED = re.compile(r"(?<![^/])(?:(?:coarse_)?iteration_(\d{1,18})/|ckpt_(\d{1,18})_rank\d+\.pt$|step-(\d{1,18})\.ckpt$"
                   r"|point_cloud_(\d{0,16}99)\.ply$)")
"""One of several states of a training: INRIA's folder, gsplat's and nerfstudio's checkpoints, gsplat's ply/point_cloud_6999.ply, which has
the number of a step less one.  gsplat's ranks are read together."""
FRAMES = re.compile(r"(?<![^/])point_cloud_\d*(?<!99)\.ply$")
"""Beside which point_cloud_99.ply is a frame."""
MOST_FRAMES = 1_000_000
ADVICE = "name them with their frames' numbers, as in frame_0001.ply"


def is_frame(name: str) -> bool:
    return (name.lower().endswith(EXTENSIONS) and not os.path.basename(name).startswith(".") and "__MACOSX" not in name) or (
        "/" in name and os.path.basename(name) == META)


def is_packed_frame(name: str) -> bool:
    """Whether a member of a zip file is a frame: one file, which SOG with its pictures beside it is not, and no trainer's points."""
    return is_frame(name) and os.path.basename(name).lower() not in (META, *POINTS)


def models_among(names: Iterable[str]) -> list[str]:
    """Those of a folder's or a zip file's names that are models, the one to read before others first.  Hidden ones are passed over."""
    names = [name for name in names if not HIDDEN.search(name) and os.path.basename(name).lower() not in (META, *POINTS)]
    order = {extension: i for i, extension in enumerate(ALONE)}
    found = [name for name in names if name.lower().endswith(ALONE)] or [name for name in names if name.lower().endswith(CHECKPOINTS)]
    return sorted(latest(found), key=lambda name: (order.get(os.path.splitext(name.lower())[1], len(order)), name))


def pattern_of(before: str, after: str) -> re.Pattern:
    """The names of a sequence, with the number as their group."""
    return re.compile(re.escape(before) + r"(\d{1,18})" + re.escape(after), re.IGNORECASE)


class Row(NamedTuple):
    """A frame: its number, as a number and as it is written, and its name."""

    number: int
    digits: str
    name: str


def sequences_among(names: Iterable[str], loose: bool = False) -> dict[tuple[str, str], list[Row]]:
    """{(before, after the number): frames, by number} of names that differ in one number, two names at least.

    Where several numbers differ, the last one is the frame's.
    loose  the first one is, and the others may differ as they like: times, say
    """
    alike = defaultdict(list)
    for name in names:
        alike[tuple(re.split(r"\d+", name.lower()))].append(name)
    found: dict[tuple[str, str], list[Row]] = {}
    for group in alike.values():
        digits = [re.findall(r"\d+", name) for name in group]
        differing = [c for c in range(len(digits[0])) if len({row[c] for row in digits}) > 1]
        parts: dict[tuple, list[Row]] = defaultdict(list)
        for name, row in zip(group, digits, strict=True) if differing else ():
            c = differing[0 if loose else -1]
            parts[() if loose else (*row[:c], *row[c + 1:])].append(Row(int(row[c][:18]), row[c], name))
        for rows in parts.values():
            if len(rows) > 1:
                rows.sort()
                texts = re.split(r"\d+", rows[0].name)
                row, c = re.findall(r"\d+", rows[0].name), differing[0 if loose else -1]
                before = "".join(text + number for text, number in zip(texts, row[:c])) + texts[c]
                found[before, rows[0].name[len(before) + len(row[c]):]] = rows
    return found


def state_of(name: str) -> int:
    """The number of the state of a training that a name is of; -1 where it is of none."""
    saved = SAVED.search(name)
    return int(saved[saved.lastindex or 0]) if saved else -1


def latest(names: Iterable[str]) -> list[str]:
    """The names without those of earlier iterations of a training."""
    names = list(names)
    if any(map(FRAMES.search, names)):
        return names
    last: dict[str, tuple[int, str]] = {}
    for name in names:
        key = SAVED.sub("/", name)
        last[key] = max(last.get(key, (-1, "")), (state_of(name), name))
    return [name for _, name in last.values()]


def one_sequence(names: Iterable[str], where: str) -> list[tuple[int, str]]:
    """Numbers and names of the one sequence among names; raises FastGSError."""
    names = latest(name for name in names if is_frame(name))
    found = sequences_among(names) or sequences_among(names, loose=True)
    if not found:
        raise FastGSError(f"{where} holds no numbered model files ({', '.join(EXTENSIONS)}); choose a file, or {ADVICE}.")
    if len(found) > 1:
        patterns = sorted(f"{before}####{after}" for before, after in found)
        unpack = "" if where == "the folder" else "unpack it and "
        raise FastGSError(f"{where} holds {len(found)} sequences ({', '.join(patterns[:4])}); {unpack}choose one of them by its name.")
    return once([(row.number, row.name) for rows in found.values() for row in rows])


def once(found: list) -> list:
    """The same, each number once: 7.ply and 07.ply are one frame."""
    if len(found) > MOST_FRAMES:
        raise FastGSError(f"there are {len(found)} frames; at most {MOST_FRAMES} are read, so choose a part of them.")
    return list({n: (n, name) for n, name in found}.values())
