# SPDX-License-Identifier: GPL-3.0-or-later
"""One viewport: what it shows, what it has asked the thread for, and the picture that it draws meanwhile.

Nothing here asks Blender for anything but the GPU, so that tests draw without a window.
"""
from __future__ import annotations

import logging
import time
from dataclasses import dataclass

import numpy as np

from ... import fastgs_blender as fg
from ...scene import objects
from ...scene.snapshot import Contents
from . import fallback, sorting
from .atlas import Atlas, TooLarge
from .picture import Order, Picture, SceneDepth
from .worker import Worker

log = logging.getLogger(__name__)

RESTING = 0.25
"""Seconds without a change after which a view counts as still."""


@dataclass(frozen=True)
class Look:
    """How a picture is put into its window: see Picture.resolve."""

    working: np.ndarray
    background: tuple | None = None
    border: tuple = (0.0, 0.0, 1.0, 1.0)
    opacity: float = 1.0
    frame: tuple = (0.0, 0.0, 1.0, 1.0)
    outside: float = 1.0


class View:
    """State of one region.

    others    gives the models that other views show
    trouble   why splats cannot be drawn by the GPU, or are missing: a sentence, or None
    """

    def __init__(self, atlas: Atlas, worker: Worker, others=list):
        self.atlas, self.worker, self.others = atlas, worker, others
        self.picture, self.fallback = Picture(), fallback.Image()
        self.trouble: str | None = None
        self._answer: sorting.Sorted | None = None
        self._order: tuple[sorting.Sorted, Order] | None = None
        self._asked = self._seen = None
        self._moved = 0.0
        self._density = 1.0

    @property
    def stale(self) -> bool:
        """Whether a newer order, or the CPU's picture, waits to be drawn."""
        return self.fallback.fresh or (self._answer is not None and (self._order is None or self._order[0] is not self._answer))

    @property
    def waiting(self) -> bool:
        """Whether the thread works for it."""
        return self.worker.busy(self)

    @property
    def coarse(self) -> bool:
        """Whether fewer splats are drawn than there are, because the view moves."""
        return self._density < 1.0

    @property
    def shows(self) -> bool:
        """Whether splats have been drawn."""
        return self._order is not None or (self.fallback.needed and self.fallback.there)

    @property
    def resting(self) -> bool:
        """Whether the view has been still for a while."""
        return time.monotonic() - self._moved > RESTING

    @property
    def models(self) -> list[fg.GaussianModel]:
        """The models that the view shows."""
        return [] if self._answer is None else [part.model for part in self._answer.parts]

    def done(self, answer) -> None:
        """From the thread: what was asked for."""
        if isinstance(answer, sorting.Sorted):
            self._answer = answer
        else:
            self.fallback.done(answer)

    def failed(self, error: Exception) -> None:
        """From the thread: it could not be done."""
        self.trouble = f"the viewport could not be drawn ({type(error).__name__}: {error}); the log holds the details."

    def draw(self, contents: Contents, camera: fg.Camera, look: Look, density: float = 1.0, playing: bool = False,
             depth: SceneDepth | None = None, wait: bool = False) -> None:
        """Draw into the active framebuffer what is known by now, and ask for what is missing.

        density   share of the splats to draw while the view moves or plays
        depth     of what else is in the window
        wait      sort first, on this thread
        """
        seen = _signature(camera)
        if self._seen is not None and seen != self._seen:
            self._moved = time.monotonic()
        self._seen = seen
        self._density = density if playing or not self.resting else 1.0
        key = _signature(contents), seen, self._density, self.fallback.needed, objects.reloads()
        if wait:
            self._ask(contents, camera, look, key, wait)
        if self.fallback.needed:
            self.fallback.draw(look)
        elif self._answer is not None:
            try:
                self._draw(contents, camera, look, depth)
            except TooLarge:
                self._fall_back("the models do not fit into the GPU's textures")
            except Exception as error:  # what a driver says about a shader comes as a bare Exception
                log.exception("the viewport's GPU path")
                self._fall_back(f"the GPU path is not available ({type(error).__name__})")
        if not wait:  # only now, so that the thread does not take Python's lock from what is drawn
            self._ask(contents, camera, look, key, wait)

    def free(self) -> None:
        """Free what is on the GPU."""
        self.worker.forget(self)
        self.picture.free()
        self.fallback.free()
        self._answer = self._order = self._asked = None

    def _ask(self, contents, camera, look, key, wait):
        if key == self._asked:
            return
        self._asked = key
        density = self._density
        if self.fallback.needed:
            work = lambda: fallback.render(contents, camera, look.working, look.background)  # noqa: E731
        else:
            work = lambda: sorting.sort(contents, camera, density, self.atlas)  # noqa: E731
        if wait:
            self.done(work())
        else:
            self.worker.ask(self, work)

    def _draw(self, contents, camera, look, depth):
        answer = self._answer
        self.trouble = next((f"{name}: {text}" for name, text in answer.failed.items()), None)
        if self._order is None or self._order[0] is not answer:
            self._order = answer, Order(answer.order)
        parts, _ = contents.parts(_known(answer.models))
        if [id(p.model) for p in parts] != [id(p.model) for p in answer.parts]:
            parts = answer.parts  # what came or went since is drawn when it has been sorted
        clouds = [part.viewed(camera) for part in parts]
        if clouds:
            self.atlas.hold([part.model for part in clouds], self.others())
        elif not contents.shown and self.atlas.nbytes and not self.others():
            self.atlas.clear()  # the last object is gone or hidden
        self.picture.draw(camera, clouds, self.atlas, self._order[1], depth)
        self.picture.resolve(**vars(look))

    def _fall_back(self, why):
        self.trouble = f"{why}: the CPU draws the viewport, slowly."
        log.warning(self.trouble)
        self.fallback.needed = True
        self._asked = None


def _known(models):
    def load(path):
        if path not in models:
            raise fg.FastGSError(f"{path}: not read yet.")
        return models[path]

    return load


def _signature(x):
    if isinstance(x, fg.Camera):
        return (x.width, x.height, x.fx, x.fy, x.cx, x.cy, x.world_to_camera.tobytes(), x.orthographic, x.near, x.tangent_limits())
    return x.frame, x.fps, tuple((item.path, item.placement.tobytes(), item.retime, _boxes(item)) for item in x.shown)


def _boxes(item):
    return tuple((crop.matrix.tobytes(), crop.remove) for crop in item.crops)
