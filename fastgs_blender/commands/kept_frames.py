# SPDX-License-Identifier: GPL-3.0-or-later
"""Decides which rendered frames are kept: a note for each frame, in a hidden folder beside it, says how it was made.

Two frames are the same work if model, camera, time, passes, background, format and backend are the same.  A note is written before
its frame and says so, and again after it: a killed process leaves no frame whose note is that of another work.  Each frame has its own
note, so that many machines can render into one folder.
"""
import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..cameras.camera import Camera
from ..formats.description import describe
from ..model.appearance import Features
from ..model.gaussians import GaussianModel
from ..model.sequence import Sequence
from ..util.errors import FastGSError
from ..util.outputs import replacing
from ..util.reading import read_text
from ..util.version import VERSION

FOLDER = ".fastgs-frames"
LONGEST = 200
"""Bytes of a note."""
UNDER_WAY = " under way"


class KeptFrames:
    """The notes of a folder of frames.

    source  the model or sequence that is rendered
    common  what else all frames of the work have in common, JSON values
    """

    def __init__(self, folder: Path, source: GaussianModel | Sequence, common: dict) -> None:
        self.folder, self.source = folder / FOLDER, source
        self.common = json.dumps({"version": VERSION, **common}, sort_keys=True)
        self._known: tuple[GaussianModel, str] | None = None

    def state(self, file: Path, camera: Camera, t: float) -> str:
        """"absent", "same", "other" or, of a frame whose writing was stopped, "under way"."""
        if not file.exists():
            return "absent"
        try:
            note = read_text(self.folder / file.name, LONGEST)
        except FastGSError:
            return "other"
        work = self._work(camera, t)
        return "same" if note == work else "under way" if note == work + UNDER_WAY else "other"

    @contextmanager
    def written(self, file: Path, camera: Camera, t: float) -> Iterator[None]:
        """The block writes the frame."""
        work = self._work(camera, t)
        self._write(file, work + UNDER_WAY)
        yield
        self._write(file, work)

    def _work(self, camera: Camera, t: float) -> str:
        """What identifies a frame."""
        model = self.source.moment(t)[0]
        if self._known is None or self._known[0] is not model:
            self._known = model, digest(model)
        numbers = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.near, camera.orthographic,
                   *camera.window, *camera.world_to_camera.ravel(), t]
        found = hashlib.blake2b((self.common + self._known[1]).encode(), digest_size=16)
        found.update(np.array(numbers, np.float64).tobytes())
        return found.hexdigest()

    def _write(self, file: Path, text: str) -> None:
        try:
            self.folder.mkdir(exist_ok=True)
            with replacing([self.folder / file.name]) as (part,):
                part.write_text(text, "utf-8")
        except (FastGSError, OSError) as error:
            reason = f"{getattr(error, 'strerror', None) or error}".rstrip(".")
            raise FastGSError(f"{file} could not be written: {reason}; free space on its disk or choose another folder.") from error


def digest(model: GaussianModel) -> str:
    """What tells a model from others: its arrays and kinds, wherever it came from."""
    about = {key: value for key, value in describe(model).items() if key != "provenance"}
    found = hashlib.blake2b(json.dumps(about, sort_keys=True).encode(), digest_size=16)
    appearance = model.appearance
    for array in (*model.arrays.values(), *((appearance.w1, appearance.w2) if isinstance(appearance, Features) else ())):
        found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()
