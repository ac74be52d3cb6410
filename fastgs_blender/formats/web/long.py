# SPDX-License-Identifier: GPL-3.0-or-later
"""Long clips in pages: each piece of a clip in chapters is a file and an object of its own, which the player reads when it is shown.

A page is made with one object for each clip, whose model stands for it and has no Gaussians.  in_pieces() puts the pieces in its place.
"""
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...cameras.opening import opening, up_of
from ...model.chapters import Chapters, Piece
from ...model.gaussians import GaussianModel
from ...model.sequence import ENDS
from ...rendering.instances import Instance, ObjectSettings
from ...util.errors import FastGSError
from ...util.tensor_files import open_tensors, write_tensors
from ..base import generator
from ..chaptered import PIECE
from ..description import describe, read_json
from ..native import COMPRESSED, KEY, VERSION, Native
from ..native_arrays import COMPRESSED as ENTRY
from ..native_arrays import decoder_of
from ..rate import Loss
from .library import MOST_GAUSSIANS, cannot_play
from .page import Page, PageObject, PagePiece
from .poster import Draw, linear, poster

Files = dict[GaussianModel, Callable[[], bytes]]
"""What gives the file of each of a page's models."""


def clip_page(path: Path, **options: Any) -> tuple[Page, Files]:
    """The page that plays the clip of a compressed file from its opening view, and the files of its objects' models.

    options  those of Page.  Raises FastGSError.
    """
    clip = opened(path)
    stands, model = stands_for(clip), clip.moment(0.0)[0]
    camera, pivot = opening(model)
    given: dict[str, Any] = {"cameras": [camera], "pivot": pivot, "frames": clip.clip.frame_count, "fps": clip.clip.fps}
    return in_pieces(Page([PageObject(stands)], up=up_of(model).tolist(), **given | options), {stands: path})


def stands_for(clip: Chapters) -> GaussianModel:
    """A model without Gaussians that stands for a clip in a page; another one with each call.  Raises FastGSError."""
    most = sum(piece.size for piece in clip.pieces)
    if most > MOST_GAUSSIANS:
        raise FastGSError(f"a web page plays at most {MOST_GAUSSIANS} Gaussians, not {most} in all chapters; thin the clip out, or cut it.")
    for reason in {cannot_play(chapter.template) for chapter in clip.chapters} - {None}:
        raise FastGSError(reason)
    return replace(clip.chapters[0].template)


def opened(path: Path) -> Chapters:
    """The clip in a file of ours."""
    clip = Native().open(path, _load)
    assert isinstance(clip, Chapters)
    return clip


def _load(path: Path) -> GaussianModel:
    raise FastGSError(f"{path} holds no clip in chapters.")


def compressed_clips(page: Page, clips: Mapping[GaussianModel, Chapters], kept: Mapping[GaussianModel, Path], loss: Loss, folder: Path,
                     progress: Callable[[float], None]) -> tuple[Page, dict[GaussianModel, Path]]:
    """A page for in_pieces(), of one whose objects stand for clips, and the compressed files of these, written where there is none.

    clips     by the models that stand for them;  kept: their compressed files, where they have one and it may be taken
    folder    for files;  progress: called with 0..1
    What filters and density hide of a clip is left out of its file, so its objects have none.
    """
    hiding = {each.key for each in page.objects if each.model in clips and (_shows_part(each.settings[0]) or each.model not in kept)}
    made: dict[tuple, GaussianModel] = {}
    files, objects = dict(kept), []
    for each in page.objects:
        if each.key in hiding:
            if each.key not in made:
                path, done = folder / f"{len(made)}.safetensors", len(made)
                Native(loss, lambda share, done=done: progress((done + share) / len(hiding))).write_chapters(  # type: ignore[misc]
                    _without_hidden(clips[each.model], each.settings[0]), path)
                made[each.key] = stands = replace(each.model)
                files[stands] = path
            plain: dict[str, Any] = {"filters": (), "mask": ObjectSettings.mask, "density": 1.0}
            each = replace(each, model=made[each.key], settings=[replace(shown, **plain) for shown in each.settings])
        objects.append(each)
    return replace(page, objects=objects), files


def _shows_part(settings: ObjectSettings) -> bool:
    return bool(settings.filters or settings.mask or settings.density < 1)


def _without_hidden(clip: Chapters, settings: ObjectSettings) -> Chapters:
    """The clip without the Gaussians that an object's settings hide."""
    def read(piece: Piece) -> GaussianModel:
        model = piece.read()
        hidden = Instance(model, np.eye(4), 0.0, settings).hidden
        return model.take(~hidden) if hidden.any() else model

    if not _shows_part(settings):
        return clip
    return Chapters(clip.clip, clip.chapters, [replace(piece, read=partial(read, piece)) for piece in clip.pieces], about=clip.about)


def in_pieces(page: Page, files: Mapping[GaussianModel, Path], draw: Draw = linear) -> tuple[Page, Files]:
    """The page with the pieces of its long clips, and its poster, and what gives the pieces' files.

    files  compressed files of clips, by the models that stand for them;  draw: for the poster
    """
    clips = {stands: opened(path) for stands, path in files.items() if any(each.model is stands for each in page.objects)}
    objects, pieces = [], {stands: _pieces(files[stands], clip) for stands, clip in clips.items()}
    for each in page.objects:
        if each.model in clips:
            objects += [replace(each, model=model, piece=piece) for model, piece, _ in pieces[each.model]]
        else:
            objects.append(each)
    begins = [_at_first(each, clips[each.model]) if each.model in clips else each for each in page.objects]
    return (replace(page, objects=objects, poster=page.poster or poster(replace(page, objects=begins), draw)),
            {model: data for each in pieces.values() for model, _, data in each})


def _at_first(shown: PageObject, clip: Chapters) -> PageObject:
    """An object of a clip on the first frame."""
    model, t = clip.moment(shown.times[0] if len(shown.times) else 0.0)
    return replace(shown, model=model, times=(t,))


def _pieces(path: Path, clip: Chapters) -> list[tuple[GaussianModel, PagePiece, Callable[[], bytes]]]:
    """For each piece of a clip a model that stands for it, when it is shown, and what gives its file."""
    with open_tensors(path) as file:
        listed = read_json(file.metadata[KEY])["pieces"]
    found: list[tuple[GaussianModel, PagePiece, Callable[[], bytes]]] = []
    for k, (piece, values) in enumerate(zip(clip.pieces, listed)):
        chapter = clip.chapters[piece.first]
        found.append((replace(chapter.template), PagePiece(piece.size, _shown(clip, piece), chapter.time),
                      partial(_file, path, k, values, chapter.template)))
    return found


def _shown(clip: Chapters, piece: Piece) -> tuple[float, float]:
    """From when until when a piece is shown, in the clip's t; those of the first and the last chapter without an end."""
    after = piece.first + piece.count
    low, high = (clip.clip.t_of_frame(clip.chapters[i].begin - ENDS) if 0 < i < len(clip.chapters) else None for i in (piece.first, after))
    return -1e9 if low is None else low, 1e9 if high is None else high


def _file(path: Path, k: int, values: dict, template: GaussianModel) -> bytes:
    """The k-th piece as a file of one model, with the numbers that it has."""
    with open_tensors(path) as file, tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        own, target = file.below(PIECE.format(k)), Path(folder) / "piece.safetensors"
        model = describe(template) | values.get("model", {})
        entries = {ENTRY: values[ENTRY]} if ENTRY in values else {}
        about = {"version": COMPRESSED if entries else VERSION, "generator": generator(), "model": model, **entries}
        write_tensors(target, {name: own.read(name) for name in own.entries} | decoder_of(template), {KEY: json.dumps(about)})
        return target.read_bytes()
