# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds all models that viewports show in two textures, so that one draw call blends them together, in one order.

Python cannot write into a part of a texture.  So a new model is uploaded into a texture of its own, and the GPU copies that to the model's
rows of the large one: for a new frame of a sequence, only the Gaussians of that sequence are uploaded.
"""
import gpu
import numpy as np

from ...fastgs_blender.kernels.gl import model_texels
from ...fastgs_blender.kernels.gl.model_texels import WIDTH, Place
from ...fastgs_blender.model.gaussians import GaussianModel
from . import shaders
from .textures import FORMATS, ROWS, rows_of, upload

KINDS = ("geometry", "colour")
HALF = {"geometry": False, "colour": True}
SPARE = 4
"""Where room had to be made before, one row in so many is left free for frames that are a little larger."""
WASTE = 4
"""Textures of which less than one row in so many is used are made anew."""


MOST_BYTES = ROWS * WIDTH * (16 + 8)
"""The largest that both textures together become."""


class TooLarge(Exception):
    """The models do not fit into textures."""


class _Rows:
    """The rows of a texture, and which models have them: {id: (first row, rows)}."""

    def __init__(self, rows: int, half: bool):
        self.rows, self.half, self.taken = rows, half, {}
        self.texture = gpu.types.GPUTexture((WIDTH, rows), format='RGBA16F' if half else FORMATS[4])
        self._target = gpu.types.GPUFrameBuffer(color_slots=(self.texture,))

    @property
    def nbytes(self) -> int:
        """Bytes of the texture."""
        return self.rows * WIDTH * (8 if self.half else 16)

    def room(self, wanted: list[int]) -> list[int] | None:
        """The first row of a free run of rows for each number of rows in `wanted`; None where not all of them fit."""
        found, taken = [], sorted(self.taken.values())
        for rows in wanted:
            at = 0
            for begin, length in taken:
                if begin - at >= rows:
                    break
                at = begin + length
            if at + rows > self.rows:
                return None
            found.append(at)
            taken = sorted([*taken, (at, rows)])
        return found

    def put(self, key: int, first: int, texels: np.ndarray) -> None:
        """Send a model's texels [rows, WIDTH, 4] to its rows."""
        self.taken[key] = first, len(texels)
        sent = upload(texels, half=self.half)
        with self._target.bind(), shaders.drawing('NONE'):
            whole = gpu.state.viewport_get()
            gpu.state.viewport_set(0, first, WIDTH, len(texels))
            shaders.fill(*shaders.show(False), {"t_shown": sent})
            gpu.state.viewport_set(*whole)


class Atlas:
    """The textures of a set of models; `version` changes with them."""

    def __init__(self):
        self.version = 0
        self.clear()

    def clear(self):
        """Free the textures."""
        self.version += 1
        self.models: list[GaussianModel] = []
        self._rows: dict[str, _Rows] = {}
        self._places: dict[int, Place] = {}
        self._packed: dict[int, tuple] = {}

    @property
    def geometry(self):
        """The texture of geometry; None while the atlas holds no model."""
        return self._rows["geometry"].texture if self._rows else None

    @property
    def colour(self):
        """The texture of colours; None while the atlas holds no model."""
        return self._rows["colour"].texture if self._rows else None

    @property
    def nbytes(self) -> int:
        """Bytes of the textures."""
        return sum(rows.nbytes for rows in self._rows.values())

    def has(self, models) -> bool:
        """Whether all of them are on the GPU."""
        return all(id(model) in self._places for model in models)

    def place(self, model: GaussianModel) -> Place:
        """The Place of a model in the textures; raises KeyError where the model is not on the GPU."""
        return self._places[id(model)]

    def pack(self, models) -> None:
        """Compute the texels of models that are not on the GPU yet.  Any thread may call it; upload() is then quicker."""
        known, missing = self._packed, [model for model in models if id(model) not in self._places]
        self._packed = {id(model): known.get(id(model)) or (model, _texels(model)) for model in missing}

    def upload(self, models, keep=()) -> None:
        """Upload the models that are not on the GPU yet.  When something is uploaded, other models stay only where they are in `keep`.

        Raises TooLarge.
        """
        models = list({id(m): m for m in models}.values())
        if self.has(models):
            return
        wanted = list({id(m): m for m in [*models, *(m for m in keep if id(m) in self._places)]}.values())
        needed = {kind: [_row_count(m, kind) for m in wanted] for kind in KINDS}
        if max(map(sum, needed.values())) > ROWS:
            raise TooLarge
        self._forget_all_but(wanted)
        coming = [m for m in wanted if id(m) not in self._places]
        first = self._room(coming) if all(sum(needed[kind]) * WASTE >= rows.rows for kind, rows in self._rows.items()) else None
        if first is None:
            spare, packed = (1 / SPARE if self._rows else 0), self._packed
            self.clear()  # before room is made
            self._packed = packed
            self._rows = {kind: _Rows(min(ROWS, int(sum(rows) * (1 + spare))), HALF[kind]) for kind, rows in needed.items()}
            coming, first = wanted, self._room(wanted)
        for number, model in enumerate(coming):
            texels = self._packed.pop(id(model), (model, None))[1] or _texels(model)
            for kind in KINDS:
                self._rows[kind].put(id(model), first[kind][number], texels[kind])
            self._places[id(model)] = Place(*(WIDTH * first[kind][number] for kind in KINDS), model_texels.layout_of(model))
        self.models = wanted
        self.version += 1

    def _forget_all_but(self, models) -> None:
        keep = {id(model) for model in models}
        for key in [key for key in self._places if key not in keep]:
            del self._places[key]
            for rows in self._rows.values():
                del rows.taken[key]

    def _room(self, models) -> dict[str, list[int]] | None:
        """The first row of each model in each texture; None where they do not fit."""
        found = {kind: rows.room([_row_count(m, kind) for m in models]) for kind, rows in self._rows.items()}
        return None if not found or None in found.values() else found


def _row_count(model: GaussianModel, kind: str) -> int:
    return rows_of(len(model) * getattr(model_texels.layout_of(model), kind))


def _texels(model: GaussianModel) -> dict[str, np.ndarray]:
    """Whole rows of each texture, [rows, WIDTH, 4]."""
    layout, out = model_texels.layout_of(model), {}
    for kind, write in (("geometry", model_texels.write_geometry), ("colour", model_texels.write_colour)):
        size = getattr(layout, kind)
        texels = np.zeros((_row_count(model, kind) * WIDTH, 4), np.float32)
        write(model, texels[:len(model) * size].reshape(len(model), size, 4))
        out[kind] = texels.reshape(-1, WIDTH, 4)
    return out
