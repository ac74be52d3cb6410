# SPDX-License-Identifier: GPL-3.0-or-later
"""Web pages that play a scene: one HTML file, which asks for nothing else.

page_of() makes the page of a model, save_page() writes any page.  `fg.save(model, "page.html")` does both.
"""
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
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
from .long import clip_page as clip_page
from .page import Page, PageObject, Sound, write_page
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
Packed = Mapping[GaussianModel, bytes | Callable[[], bytes]]


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
        _write(targets[-1], page_of(model), self.loss, self.progress, {})

    def write_chapters(self, source: Chapters, target: Path) -> list[str]:
        """Write the page of a long clip; returns what is lost, one clause each."""
        with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
            path = Path(folder) / "clip.safetensors"
            lost = Native(self.loss, self.progress).write_chapters(source, path)
            page, packed = clip_page(path)
            _write(target, page, self.loss, None, packed)
        return lost


def page_of(model: GaussianModel, **options: Any) -> Page:
    """The page that plays a model's whole clip from its opening view; options: those of Page."""
    camera, pivot = opening(model)
    given: dict[str, Any] = {"cameras": [camera], "pivot": pivot, "frames": model.clip.frame_count, "fps": model.clip.fps}
    return Page([PageObject(model)], up=up_of(model).tolist(), **given | options)


def save_page(page: Page, path: Path, loss: Loss = FINE, limit: float | None = None,
              progress: Callable[[float], None] | None = None, packed: Packed | None = None) -> int:
    """Write a page as one HTML file; returns its bytes.

    loss    how much the pictures may lose
    limit   MB that the file may have
    packed  compressed files of models, or what gives them, which are taken as they are
    What progress() raises cancels it, and nothing is written.  Raises FastGSError; a LossWarning says so where the page is large.
    """
    with replacing([path]) as (target,):
        size = _write(target, page, loss, progress, packed or {})
        if limit is not None and size > limit * 1e6:
            raise FastGSError(f"{path} would have {size / 1e6:.1f} MB, and its limit is {limit:g} MB; {SMALLER}, or raise the limit.")
    return size


def _write(target: Path, page: Page, loss: Loss, progress: Callable[[float], None] | None, packed: Packed) -> int:
    """Write a page with its poster and its compressed models, one after the other; returns its bytes.

    A LossWarning says where it is large.
    """
    for model in page.models.values():
        if reason := cannot_play(model):
            raise FastGSError(reason)
    if page.poster is None:
        page = replace(page, poster=poster(page))
    models = list(page.models.values())

    def files() -> Iterator[bytes]:
        for done, model in enumerate(models):
            data = packed.get(model)
            yield compressed_file(model, loss, partial(part, done)) if data is None else data if isinstance(data, bytes) else data()
            part(done, 1.0)

    def part(done: int, share: float) -> None:
        if progress:
            progress((done + share) / len(models))

    with target.open("w", encoding="utf-8", newline="\n") as stream:
        write_page(stream, page, files())
    size = target.stat().st_size
    if size > LARGE * 1e6:
        warnings.warn(LossWarning(f"the page has {size / 1e6:.1f} MB, and phones may not open one beyond {LARGE:g} MB; {SMALLER}."),
                      stacklevel=2)
    return size


def compressed_file(model: GaussianModel, loss: Loss, progress: Callable[[float], None] | None = None) -> bytes:
    """The bytes of a model's compressed .safetensors file."""
    writer = Native(loss, progress)
    with tempfile.TemporaryDirectory(prefix="fastgs-") as folder:
        target = Path(folder) / "model.safetensors"
        writer.write(writer.fit(model)[0], [target])
        return target.read_bytes()


def kept_file(path: Path) -> bytes | None:
    """The bytes of a file of ours that is compressed already, and loses nothing more in a page; None of another file."""
    return path.read_bytes() if is_compressed(path) else None


def is_compressed(path: Path) -> bool:
    """Whether a file is one of ours that is compressed already."""
    with path.open("rb") as stream:
        if not Native().sniff(stream.read(9), path):
            return False
    with open_tensors(path) as file:
        return '"compressed"' in file.metadata.get(KEY, "")


def sound_of(path: str | Path, start: float = 0.0) -> Sound:
    """A sound file for a page; raises FastGSError where it cannot be read, or browsers do not play its kind."""
    kind = SOUNDS.get(Path(path).suffix.lower())
    if kind is None:
        raise FastGSError(f"{path}: browsers do not play this kind of sound; save it as .m4a, .mp3, .ogg or .wav.")
    return Sound(read_bytes(path, LARGEST_SOUND), kind, start)
