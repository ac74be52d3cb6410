# SPDX-License-Identifier: GPL-3.0-or-later
"""How published work measures on each data set: scenes, views, frames; and what the paper's tables print for them.

The numbers are the paper's (FAST-GS, tables 1 and 2); docs/paper.md says which of them contradict each other.
"""
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..captures.layouts import technicolor
from ..util.errors import FastGSError

Row = Mapping[str, float]
"""Published measures of a scene by their names in MEASURES (evaluate.py), and frames per second, megabytes and minutes of training."""


@dataclass(frozen=True)
class Protocol:
    """A data set's protocol.

    scenes    the published scenes, each a folder
    held_out  views that are kept for evaluation; None: those of the layout
    most      frames of a model at most: longer films are cut into fragments of so many
    views     measure each held-out view in a row of its own
    paper, stg  what the paper prints for itself and for Spacetime Gaussians, by scene, or by "scene view" where views have rows
    """

    layout: str
    scenes: tuple[str, ...]
    held_out: tuple[str, ...] | None = None
    most: int = 300
    views: bool = False
    paper: Mapping[str, Row] = field(default_factory=dict)
    stg: Mapping[str, Row] = field(default_factory=dict)


def _rows(**scenes: tuple[float, ...]) -> dict[str, Row]:
    return {scene: dict(zip(("psnr", "dssim1", "dssim2", "lpips"), values)) for scene, values in scenes.items()}


PROTOCOLS: dict[str, Protocol] = {
    "n3v": Protocol(
        "n3v", ("coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"),
        paper=_rows(sear_steak=(34.65, 0.0298, 0.0022, 0.0306), flame_steak=(33.09, 0.0195, 0.0165, 0.0399),
                    cook_spinach=(33.49, 0.0211, 0.0131, 0.0338), coffee_martini=(29.98, 0.0367, 0.0167, 0.0583)),
        stg=_rows(sear_steak=(33.40, 0.0351, 0.0064, 0.0309), flame_steak=(33.59, 0.0350, 0.0053, 0.0308),
                  cook_spinach=(33.30, 0.0425, 0.0046, 0.0358), coffee_martini=(28.55, 0.0418, 0.0253, 0.0692))),
    "immersive": Protocol(
        "immersive", ("02_Flames",), ("camera_0010", "camera_0037"), views=True,
        paper={"02_Flames camera_0010": {"psnr": 30.56, "fps": 146, "megabytes": 363, "minutes": 40 + 34 / 60},
               "02_Flames camera_0037": {"psnr": 31.54}},
        stg={"02_Flames camera_0010": {"psnr": 27.97, "fps": 154, "megabytes": 248, "minutes": 34 + 11 / 60},
             "02_Flames camera_0037": {"psnr": 27.64}}),
    "technicolor": Protocol("technicolor", tuple(technicolor.PUBLISHED), most=50),
}


@dataclass(frozen=True)
class Part:
    """A scene, or a fragment of one that is longer than a model: its name in tables and files, its folder, its frames (None: all)."""

    name: str
    scene: str
    folder: Path
    frames: slice | None


def scene_folders(protocol: Protocol, folder: Path, scenes: list[str] | None) -> list[Path]:
    """The folders of these scenes, or of all published scenes that are there; raises FastGSError where there is none."""
    wanted = list(protocol.scenes) if scenes is None else scenes
    found = [path for name in wanted for path in _places(folder, name)]
    lacking = [name for name in wanted if not _places(folder, name)]
    if not found or (scenes is not None and lacking):
        raise FastGSError(f"{folder}: it has no folder of {'the scene ' + lacking[0] if scenes else 'a scene, ' + ', '.join(lacking)}; "
                          "give the folder in which the scenes' folders lie, or name scenes with --scenes.")
    return found


def _places(folder: Path, name: str) -> list[Path]:
    """flame_salmon is published as flame_salmon_1 too."""
    return [path for path in (folder / name, folder / f"{name}_1") if path.is_dir()][:1]


def parts(protocol: Protocol, folder: Path, frame_count: int, start_frame: int, frames: slice | None) -> list[Part]:
    """What is trained for a scene: all of it, the published frames, or fragments of protocol.most frames.

    frames  a part of the clip that is used instead
    """
    scene = folder.name.removesuffix("_1")
    if frames is not None:
        return [Part(folder.name, scene, folder, frames)]
    begin = technicolor.PUBLISHED.get(scene) if protocol.layout == "technicolor" else None
    if begin is not None and start_frame <= begin and begin - start_frame + protocol.most <= frame_count:
        return [Part(folder.name, scene, folder, slice(begin - start_frame, begin - start_frame + protocol.most))]
    if frame_count <= protocol.most:
        return [Part(folder.name, scene, folder, None)]
    starts = range(0, frame_count, protocol.most)
    return [Part(f"{folder.name}-{k + 1}of{len(starts)}", scene, folder, slice(first, min(first + protocol.most, frame_count)))
            for k, first in enumerate(starts)]
