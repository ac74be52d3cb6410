# SPDX-License-Identifier: GPL-3.0-or-later
"""Long clips in pages: each piece of a clip in chapters is a file and an object of its own, which the player reads when it is shown."""
from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...cameras.opening import opening, up_of
from ...model.chapters import Chapters, Piece
from ...model.gaussians import GaussianModel
from ...model.sequence import ENDS
from ...util.errors import FastGSError
from ...util.tensor_files import open_tensors, write_tensors
from ..base import generator
from ..chaptered import PIECE
from ..description import describe, read_json
from ..native import COMPRESSED, KEY, VERSION, Native
from ..native_arrays import COMPRESSED as ENTRY
from ..native_arrays import decoder_of
from .library import MOST_GAUSSIANS
from .page import Page, PageObject, PagePiece
from .poster import poster


def clip_page(path: Path, **options: Any) -> tuple[Page, dict[GaussianModel, bytes]]:
    """The page that plays the clip of a file from its opening view, and the files of its objects' models.

    options  those of Page.  Raises FastGSError.
    """
    clip = Native().open(path, _load)
    assert isinstance(clip, Chapters)
    most = sum(piece.size for piece in clip.pieces)
    if most > MOST_GAUSSIANS:
        raise FastGSError(f"a web page plays at most {MOST_GAUSSIANS} Gaussians, not {most} in all chapters; thin the clip out, or cut it.")
    model, t = clip.moment(0.0)
    camera, pivot = opening(model)
    given: dict[str, Any] = {"cameras": [camera], "pivot": pivot, "frames": clip.clip.frame_count, "fps": clip.clip.fps}
    opens = Page([PageObject(model, times=(t,))], up=up_of(model).tolist(), **given | options)
    objects, packed = [], {}
    for piece, data in zip(clip.pieces, _files(path, clip)):
        stands = replace(clip.chapters[piece.first].kinds)  # another object for each
        objects.append(PageObject(stands, piece=PagePiece(piece.size, _shown(clip, piece), clip.chapters[piece.first].time)))
        packed[stands] = data
    return replace(opens, objects=objects, poster=poster(opens)), packed


def _load(path: Path) -> GaussianModel:
    raise FastGSError(f"{path} holds no clip in chapters.")


def _shown(clip: Chapters, piece: Piece) -> tuple[float, float]:
    """From when until when a piece is shown, in the clip's t; those of the first and the last chapter without an end."""
    after = piece.first + piece.count
    low, high = (clip.clip.t_of_frame(clip.chapters[i].begin - ENDS) if 0 < i < len(clip.chapters) else None for i in (piece.first, after))
    return -1e9 if low is None else low, 1e9 if high is None else high


def _files(path: Path, clip: Chapters) -> Iterator[bytes]:
    """Each piece as a file of one model, with the numbers that it has."""
    with open_tensors(path) as file, tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        listed, target = read_json(file.metadata[KEY])["pieces"], Path(folder) / "piece.safetensors"
        for k, (piece, values) in enumerate(zip(clip.pieces, listed)):
            own, kinds = file.below(PIECE.format(k)), clip.chapters[piece.first].kinds
            model = describe(kinds) | values.get("model", {})
            entries = {ENTRY: values[ENTRY]} if ENTRY in values else {}
            about = {"version": COMPRESSED if entries else VERSION, "generator": generator(), "model": model, **entries}
            write_tensors(target, {name: own.read(name) for name in own.entries} | decoder_of(kinds), {KEY: json.dumps(about)})
            yield target.read_bytes()
