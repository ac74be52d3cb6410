# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages that play a scene: one HTML file, which asks for nothing else.

page_of() makes the page of a model, save_page() writes any page.  `fg.save(model, "page.html")` does both.
"""
from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...cameras.opening import opening, up_of
from ...model.chapters import Chapters
from ...model.gaussians import GaussianModel
from ...util.errors import FastGSError, LossWarning
from ...util.outputs import replacing
from ...util.reading import read_bytes
from ...util.tensor_files import open_tensors
from ..base import Format
from ..native import KEY, Native
from ..rate import LEVELS, Loss
from .library import cannot_play
from .long import clip_page
from .page import Page, PageObject, Sound, page_text
from .poster import poster

FINE = Loss(LEVELS["fine"])
LARGE = 32.0
"""MB beyond which phones and mail programs may refuse a page."""
SMALLER = "compress it more (small), prune or crop the model, or show fewer frames of it"
LARGEST_SOUND = 1 << 28
"""Bytes of a sound file."""
SOUNDS = {".mp3": "audio/mpeg", ".m4a": "audio/mp4", ".aac": "audio/aac", ".ogg": "audio/ogg", ".oga": "audio/ogg", ".opus": "audio/ogg",
          ".wav": "audio/wav", ".flac": "audio/flac", ".webm": "audio/webm"}
"""Extension -> MIME type of the sound files that browsers play."""


@dataclass(frozen=True)
class WebPage(Format):
    """A web page; it is written and not read.

    loss      how much the pictures may lose, as in Native
    progress  called with 0..1 while the model is compressed
    """

    loss: Loss = FINE
    progress: Callable[[float], None] | None = None

    name = "a web page"
    extensions = (".html",)
    keeps_cameras = keeps_parts = True

    def fit(self, model: GaussianModel) -> tuple[GaussianModel, list[str]]:
        return Native(self.loss).fit(model)

    def write(self, model: GaussianModel, targets: list[Path]) -> None:
        text = finished(page_of(model), self.loss, self.progress)
        targets[-1].write_text(text, "utf-8", newline="\n")

    def write_chapters(self, source: Chapters, target: Path) -> list[str]:
        """Write the page of a long clip; returns what is lost, one clause each."""
        with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
            path = Path(folder) / "clip.safetensors"
            lost = Native(self.loss, self.progress).write_chapters(source, path)
            page, packed = clip_page(path)
            target.write_text(finished(page, self.loss, None, packed), "utf-8", newline="\n")
        return lost


def page_of(model: GaussianModel, **options: Any) -> Page:
    """The page that plays a model's whole clip from its opening view; options: those of Page."""
    camera, pivot = opening(model)
    given: dict[str, Any] = {"cameras": [camera], "pivot": pivot, "frames": model.clip.frame_count, "fps": model.clip.fps}
    return Page([PageObject(model)], up=up_of(model).tolist(), **given | options)


def save_page(page: Page, path: Path, loss: Loss = FINE, limit: float | None = None,
              progress: Callable[[float], None] | None = None, packed: dict[GaussianModel, bytes] | None = None) -> int:
    """Write a page as one HTML file; returns its bytes.

    loss    how much the pictures may lose
    limit   MB that the file may have
    packed  compressed files of models, which are taken as they are
    What progress() raises cancels it, and nothing is written.  Raises FastGSError; a LossWarning says so where the page is large.
    """
    data = finished(page, loss, progress, packed).encode()
    if limit is not None and len(data) > limit * 1e6:
        raise FastGSError(f"{path} would have {len(data) / 1e6:.1f} MB, and its limit is {limit:g} MB; {SMALLER}, or raise the limit.")
    with replacing([path]) as (target,):
        target.write_bytes(data)
    return len(data)


def finished(page: Page, loss: Loss, progress: Callable[[float], None] | None = None,
             packed: dict[GaussianModel, bytes] | None = None) -> str:
    """The text of a page, with its poster and its compressed models; a LossWarning says so where it is large."""
    for model in page.models.values():
        if reason := cannot_play(model):
            raise FastGSError(reason)
    if page.poster is None:
        page = replace(page, poster=poster(page))
    files = [(packed or {}).get(model) for model in page.models.values()]
    left = [i for i, data in enumerate(files) if data is None]
    for done, i in enumerate(left):
        def part(share: float, done: int = done) -> None:
            if progress:
                progress((done + share) / len(left))

        files[i] = compressed_file(list(page.models.values())[i], loss, part)
    text = page_text(page, [data for data in files if data is not None])
    if len(text) > LARGE * 1e6:
        warnings.warn(LossWarning(f"the page has {len(text) / 1e6:.1f} MB, and phones may not open one beyond {LARGE:g} MB; {SMALLER}."),
                      stacklevel=2)
    return text


def compressed_file(model: GaussianModel, loss: Loss, progress: Callable[[float], None] | None = None) -> bytes:
    """The bytes of a model's compressed .safetensors file."""
    writer = Native(loss, progress)
    with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        target = Path(folder) / "model.safetensors"
        writer.write(writer.fit(model)[0], [target])
        return target.read_bytes()


def kept_file(path: Path) -> bytes | None:
    """The bytes of a file of ours that is compressed already, and loses nothing more in a page; None of another file."""
    with path.open("rb") as stream:
        if not Native().sniff(stream.read(9), path):
            return None
    with open_tensors(path) as file:
        compressed = '"compressed"' in file.metadata.get(KEY, "")
    return path.read_bytes() if compressed else None


def sound_of(path: str | Path, start: float = 0.0) -> Sound:
    """A sound file for a page; raises FastGSError where it cannot be read, or browsers do not play its kind."""
    kind = SOUNDS.get(Path(path).suffix.lower())
    if kind is None:
        raise FastGSError(f"{path}: browsers do not play this kind of sound; save it as .m4a, .mp3, .ogg or .wav.")
    return Sound(read_bytes(path, LARGEST_SOUND), kind, start)
