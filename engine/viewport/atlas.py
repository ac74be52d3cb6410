# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds all models that viewports show in two textures, so that one draw call blends them together, in one order."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fastgs_blender.model.gaussians import GaussianModel
from . import model_texels
from .textures import ROWS, WIDTH, rows_of, upload


class TooLarge(Exception):
    """The models do not fit into textures."""


@dataclass(frozen=True)
class Place:
    """Where a model's texels begin in each texture, and how they are laid out."""

    geometry: int
    colour: int
    layout: model_texels.TexelLayout


class Atlas:
    """The textures of a set of models; `version` changes with them.

    They are made anew where a model is missing, because textures cannot be written in part.
    """

    def __init__(self):
        self.version = 0
        self.clear()

    def clear(self):
        """Free the textures."""
        self.version += 1
        self.models: list[GaussianModel] = []
        self.geometry = self.colour = None
        self._places: dict[int, Place] = {}
        self._packed: dict[int, tuple] = {}
        self.nbytes = 0

    def has(self, models) -> bool:
        """Whether all of them are on the GPU."""
        return all(id(model) in self._places for model in models)

    def place(self, model: GaussianModel) -> Place:
        """Where a model lies; KeyError where it is not there."""
        return self._places[id(model)]

    def pack(self, models) -> None:
        """Make the texels of models that are not on the GPU yet; from any thread, so that hold() has less to do."""
        for model in models:
            if id(model) not in self._places and id(model) not in self._packed:
                self._packed[id(model)] = model, _texels(model)

    def hold(self, models, keep=()) -> None:
        """Make sure that the models are on the GPU; of the others only those in `keep` stay when that needs new textures.

        Raises TooLarge.
        """
        models = list({id(m): m for m in models}.values())
        if self.has(models):
            return
        wanted = list({id(m): m for m in [*models, *(m for m in keep if id(m) in self._places)]}.values())
        layouts = [model_texels.layout_of(m) for m in wanted]
        starts = {kind: np.cumsum([0] + [len(m) * getattr(layout, kind) for m, layout in zip(wanted, layouts)])
                  for kind in ("geometry", "colour")}
        if max(rows_of(int(s[-1])) for s in starts.values()) > ROWS:
            raise TooLarge
        packed = [self._packed[id(m)][1] if id(m) in self._packed else _texels(m) for m in wanted]
        self.clear()
        for kind in ("geometry", "colour"):
            start = starts[kind]
            texels = np.zeros((rows_of(int(start[-1])) * WIDTH, 4), np.float32)
            for parts, first, end in zip(packed, start, start[1:]):
                texels[first:end] = parts[kind].reshape(-1, 4)
            setattr(self, kind, upload(texels.reshape(-1, WIDTH, 4), half=kind == "colour"))
            self.nbytes += len(texels) * (8 if kind == "colour" else 16)
        self.models = wanted
        self._places = {id(m): Place(int(g), int(c), layout)
                        for m, layout, g, c in zip(wanted, layouts, starts["geometry"], starts["colour"])}


def _texels(model: GaussianModel) -> dict[str, np.ndarray]:
    layout = model_texels.layout_of(model)
    texels = {kind: np.empty((len(model), getattr(layout, kind), 4), np.float32) for kind in ("geometry", "colour")}
    model_texels.write_geometry(model, texels["geometry"])
    model_texels.write_colour(model, texels["colour"])
    return texels
