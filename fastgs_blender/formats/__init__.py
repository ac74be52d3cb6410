# SPDX-License-Identifier: GPL-3.0-or-later
"""File formats: load() and save().  A file is known by its content; the name's extension chooses what is written.

A new format is one module with a Format, listed in FORMATS.
"""
import hashlib
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..model.chapters import Chapters
from ..model.gaussians import GaussianModel, unchanging
from ..model.sequence import Source
from ..util.errors import FastGSError, LossWarning, printable
from ..util.outputs import replacing
from ..util.reading import open_file, reading
from .base import Format, usable
from .compressed_ply import CompressedPly
from .deformed import DeformableGaussians, HexPlaneGaussians
from .dynamic3d import Dynamic3DGaussians
from .ex4dgs import Ex4DGS
from .foreign import explain
from .fourdgs import FourDGS
from .freetime import FreeTimeArrays, FreeTimeCheckpoint
from .ftgs import FreeTimePly
from .gltf import Gltf
from .gsd import Gsd
from .inria import Inria
from .katsumata import Katsumata
from .ksplat import Ksplat
from .mediastorm import MediastormPly
from .native import Native
from .rate import Loss
from .realtime4dgs import Realtime4DGS
from .rotor import RotorGaussians
from .sequences import NumberedFiles, SequenceFormat, ZippedFiles, numbered_files, place_of, resolved, stands_for_many
from .sog import Sog
from .sog4d import Sog4d
from .sog4d_frames import Sog4dFrames
from .splat import Splat
from .splat4d import Splat4d
from .splat_checkpoints import GsplatCheckpoint, NerfstudioCheckpoint
from .splats4d import Splats4D
from .splatv import Splatv
from .spz import Spz
from .stg import SpacetimeGaussians
from .streamed_sog import StreamedSog
from .supersplat_ply import SuperSplatPly
from .trainer_cameras import with_cameras
from .tsog import Tsog
from .usd import Usd
from .web import WebPage

DYNAMIC: tuple[Format, ...] = (FreeTimePly(), MediastormPly(), FreeTimeCheckpoint(), FreeTimeArrays(), Dynamic3DGaussians(), FourDGS(),
                               Realtime4DGS(), RotorGaussians(), Katsumata(), Ex4DGS(), DeformableGaussians(), HexPlaneGaussians(), Tsog(),
                               Sog4d(), SuperSplatPly(), Splat4d())
STATIC: tuple[Format, ...] = (CompressedPly(), Spz(), Ksplat(), StreamedSog(), Sog(), GsplatCheckpoint(), NerfstudioCheckpoint(), Gltf(),
                              Usd(), Splat())
SEQUENCES: tuple[Format, ...] = (Gsd(), Splats4D(), Sog4dFrames(), ZippedFiles())
FORMATS: tuple[Format, ...] = (Native(), SpacetimeGaussians(), *DYNAMIC, Inria(), Splatv(), *SEQUENCES, *STATIC)
"""Asked in this order to read.  Splat comes last: its files have no mark to know them by."""
FILES, STREAMED = NumberedFiles(), StreamedSog()
"""What a path that is no file may be."""
HEAD = 512
"""Bytes that formats are first asked about."""
WRITERS: tuple[Format, ...] = (Native(), Inria(), SpacetimeGaussians(), FreeTimePly(), FourDGS(), Splatv(), *STATIC, Usd(".usda"),
                               WebPage())
"""Asked in this order to write, among those that share an extension."""


def readable() -> tuple[str, ...]:
    """What a file dialog offers: extensions with the dot, and whole names of files, each once."""
    return tuple(dict.fromkeys(name for known in FORMATS for name in known.reads))


def writable() -> tuple[str, ...]:
    """The extensions that save() knows, with the dot, each once."""
    return tuple(dict.fromkeys(extension for known in WRITERS for extension in known.extensions))


def says_antialiased(path: str | os.PathLike) -> bool:
    """Whether a file of static Gaussians with this name, or this extension, can say that it is antialiased."""
    return any(known.antialiased for known in WRITERS if str(path).lower().endswith(known.extensions))


def open_source(path: str | os.PathLike) -> Source:
    """What a path shows, as a source: the model in a file, or a Sequence whose frames are read when they are shown.

    A sequence is a folder or a zip file of numbered model files, a pattern of their names such as frame_####.ply (sequences.py), or a
    file of a format that is one.  A source is there to be shown, and its arrays are not to be changed: a GPU keeps them from one picture
    to the next (load() gives models that may be changed).  Raises FastGSError.

    Example:
        model, t = fg.open_source("examples/fireside.safetensors").moment(0.25)
    """
    path = resolved(Path(path))
    with _reading(path):
        known = _identify(path)
        source = known.open(path, load)
    if not source.provenance:
        source.provenance = {"source": path.name, "format": known.name}
    if isinstance(source, GaussianModel):
        unchanging(source, declared=True)
    return source


def fingerprint(path: str | os.PathLike) -> str:
    """SHA-256 of a file's content; of a sequence, of its files' names and sizes.  Raises FastGSError."""
    path = resolved(Path(path))
    with reading(path):
        if stands_for_many(path):
            listed = "\n".join(f"{file.name} {file.stat().st_size}" for _, file in numbered_files(path))
            return hashlib.sha256(listed.encode("utf-8", "surrogateescape")).hexdigest()
        with open_file(place_of(path)) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]


def identify(path: str | os.PathLike) -> Format:
    """The format of a file, by its content.  Raises FastGSError where it is none of ours."""
    path = resolved(Path(path))
    with _reading(path):
        return _identify(path)


def load(path: str | os.PathLike) -> GaussianModel:
    """The model in a file, whatever its name; every number in it is finite.

    The arrays are read into memory of their own: whatever becomes of the file afterwards, the model stays.  Gaussians that cannot
    be computed with are left out, with a LossWarning.  Raises FastGSError.

    Example:
        model = fg.load("examples/fireside.safetensors")
    """
    path = resolved(Path(path))
    with _reading(path), np.errstate(all="ignore"):  # a file may hold any numbers
        known = _identify(path)
        single = known.single(path, load) if isinstance(known, SequenceFormat) else None
        model = with_cameras(usable(known.load(path), path), path) if single is None else single
    if not model.provenance:
        model.provenance = {"source": path.name, "format": known.name}
    return model


def save(model: GaussianModel | Chapters, path: str | os.PathLike, compress: float | str | None = None,
         progress: Callable[[float], None] | None = None) -> None:
    """Write the model: .safetensors (everything), .ply (INRIA's if nothing moves, else Spacetime Gaussians'), .html (a page that plays it).

    compress  write the compressed variant of .safetensors: "fine" (held-out views lose at most 0.1 dB), "small" (0.3 dB), or another
              number of dB; rate.py says how that is measured.  A page holds such a file: without `compress`, a fine one
    progress  called with 0..1 while a file is compressed; what it raises cancels that, and nothing is written
    A clip in chapters becomes a .safetensors file, one piece after another, or a page.  One LossWarning says what the format cannot hold.
    What was at `path` is replaced only once all is written.
    Raises FastGSError.

    Example:
        fg.save(model, "copy.ply")
    """
    path = Path(path)
    try:
        if not isinstance(model, (GaussianModel, Chapters)):
            raise FastGSError(f"a {type(model).__name__} is no GaussianModel.")
        chosen: dict[str, Any] = {"progress": progress} | ({} if compress is None else {"loss": Loss.of(compress)})
        writer = writer_of_chapters(path) if isinstance(model, Chapters) else writer_of(model, path)
        if isinstance(writer, (Native, WebPage)):
            writer = replace(writer, **chosen)
        elif compress is not None:
            raise FastGSError("only .safetensors files and pages have a compressed variant; choose such a name, or a packed format such as "
                              ".spz.")
        with np.errstate(all="ignore"):  # a model may hold NaN; that is the reader's to say
            if isinstance(model, Chapters) and isinstance(writer, (Native, WebPage)):
                with replacing([path]) as (target,):
                    lost = writer.write_chapters(model, target)
            elif isinstance(model, GaussianModel):
                lost = _written(writer, model, path)
    except InterruptedError:  # an OSError, but the caller's own, from progress()
        raise
    except (FastGSError, OSError, MemoryError) as error:
        raise _named("cannot write", path, error) from error
    if lost:
        warnings.warn(LossWarning(f"{path} cannot hold everything as {writer.name}: {'; '.join(lost)}."), stacklevel=2)


def _written(writer: Format, model: GaussianModel, path: Path) -> list[str]:
    """Write a model; returns what is lost, one clause each."""
    fitted, lost = writer.fit(model)
    with replacing(writer.files(fitted, path)) as targets:
        writer.write(fitted, targets)
    return lost + writer.lost_cameras(model) + writer.lost_parts(model)


def writer_of_chapters(path: Path) -> Native | WebPage:
    """The format that save() writes a clip in chapters in; raises FastGSError for a name of a format that holds none."""
    found = next((known for known in (Native(), WebPage()) if path.suffix.lower() in known.extensions), None)
    if found is None:
        raise FastGSError("only .safetensors files and pages (.html) hold a clip in chapters; choose such a name, or convert a frame of it "
                          "(--at).")
    return found


def written_files(model: GaussianModel, path: str | os.PathLike) -> list[Path]:
    """All files that save() would write: path, and a decoder beside it where the format keeps one there."""
    path = Path(path)
    try:
        return writer_of(model, path).files(model, path)
    except FastGSError as error:
        raise _named("cannot write", path, error) from error


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Whatever fails in the block becomes one FastGSError that begins with "cannot read" and the file's name."""
    try:
        with reading(path):
            yield
    except FastGSError as error:
        reason = str(error).removeprefix(printable(f"{path}: "))
        if reason.startswith("cannot read "):  # a frame of the sequence at path
            raise
        raise FastGSError(f"cannot read {path}: {reason}") from error.__cause__ or error


def _identify(path: Path) -> Format:
    if FILES.sniff(b"", path):
        numbered_files(path)  # says what is wrong with a folder that is no sequence
        return FILES
    if STREAMED.sniff(b"", path):  # a level of it
        return STREAMED
    with open_file(path) as stream:
        head = stream.read(HEAD)
    if not head:
        raise FastGSError("the file is empty; copy or export it again.")
    doubt = None
    for known in FORMATS:
        try:
            with reading(path):
                if known.sniff(head, path):
                    return known
        except FastGSError as error:  # damaged: that counts if the name is of this format, and no other one knows the file
            doubt = doubt or (error if path.name.lower().endswith(known.reads) else None)
    raise doubt or FastGSError(f"{explain(head, path)}.")


def writer_of(model: GaussianModel, path: Path) -> Format:
    """The format that save() would write the model in; raises FastGSError where the name's extension is unknown."""
    name = path.name.lower()
    extension = max((e for e in writable() if name.endswith(e) and name != e), key=len, default=None)
    choices = [known for known in WRITERS if extension in known.extensions]
    if not choices:
        raise FastGSError(f"the extension {path.suffix!r} is unknown; use one of {', '.join(sorted(writable()))}.")
    return next(known for known in choices if known.suits(model))


def _named(action: str, path: Path, error: Exception) -> FastGSError:
    """The error as users see it: one sentence with the file's name in it."""
    if isinstance(error, MemoryError):
        text = "there is too little memory for it; close other programs or use fewer Gaussians."
    elif isinstance(error, OSError):
        text = f"{error.strerror or error}; check the folder, its permissions and the space on its disk."
    else:
        text = str(error)
    return FastGSError(f"{action} {path}: {text}")
