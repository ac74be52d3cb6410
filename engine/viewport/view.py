# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of one viewport: it asks the thread to sort what is to be shown, and draws with the last order until that has arrived.

Only Blender's GPU module is used here, so that tests draw without a window.
"""
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ... import fastgs_blender as fg
from ...fastgs_blender.kernels.gl.frame_table import Depths
from ...scene import objects
from ...scene.snapshot import Snapshot
from . import fallback, sorting, timing
from .atlas import Atlas, TooLarge
from .picture import Order, Picture, SceneDepth
from .worker import Worker

log = logging.getLogger(__name__)

RESTING = 0.25
"""Seconds without a change after which a view counts as still."""
FADE = 0.25
"""Seconds in which the picture of a moving view becomes that of a still one."""


@dataclass(frozen=True)
class Display:
    """How a picture is put into its window; the members are the parameters of Picture.resolve()."""

    working: np.ndarray
    background: tuple | None = None
    border: tuple = (0.0, 0.0, 1.0, 1.0)
    opacity: float = 1.0
    frame: tuple = (0.0, 0.0, 1.0, 1.0)
    outside: float = 1.0


@dataclass(frozen=True, eq=False)
class Around:
    """The other contents of the window that hide splats: meshes and whatever else Blender draws with depth.

    depths    how the window's depth follows from the distance along the view
    state     equal as long as none of it has changed
    surfaces  whether there are surfaces among it, which may stand within the cloud: then each splat is tested by itself as soon
              as the view rests, for which the depth is read; until then, and otherwise, the GPU tests the whole picture's depth
    read      () -> SceneDepth; None where nothing is there, or it cannot be read
    moving    whether read() is called while the view moves, too: there is nothing in the window that the GPU could test
    """

    depths: Depths
    state: tuple
    surfaces: bool
    read: Callable[[], SceneDepth | None]
    moving: bool = False


class View:
    """State of one region.

    others    returns the models that all views show
    trouble   a sentence that says why splats are missing or are not drawn by the GPU; None where all is well
    """

    def __init__(self, atlas: Atlas, worker: Worker, others=list):
        self.atlas, self.worker, self.others = atlas, worker, others
        self.picture, self.fallback = Picture(), fallback.Image()
        self.trouble: str | None = None
        self._answer: sorting.Sorted | None = None
        self._order: tuple[sorting.Sorted, Order] | None = None
        self._asked = self._seen = None
        self._standing: dict = {}
        self._depth: tuple[tuple, SceneDepth | None] | None = None
        self._last: tuple[Snapshot, fg.Camera] | None = None
        self._moved = 0.0
        self._density, self._rough = 1.0, False
        self._whole: tuple[tuple, bool] | None = None
        self._fading: float | None = None
        self._data: fallback.DataPass | None = None

    @property
    def as_final(self) -> bool:
        """Whether it shows pictures that are rendered as final ones are, and not by Blender's shaders."""
        return self.fallback.needed or self._data is not None

    @property
    def stale(self) -> bool:
        """Whether a newer order, or the CPU's picture, waits to be drawn."""
        if self.as_final:
            return self.fallback.fresh
        return self._answer is not None and (self._order is None or self._order[0] is not self._answer)

    @property
    def waiting(self) -> bool:
        """Whether the thread works for it."""
        return self.worker.busy(self)

    @property
    def coarse(self) -> bool:
        """Whether the picture is one for a moving view: it has fewer splats, is hidden pixel by pixel, or fades out."""
        return self._density < 1.0 or self._rough or self._fading is not None

    @property
    def shows(self) -> bool:
        """Whether splats have been drawn."""
        return self.fallback.there if self.as_final else self._order is not None

    @property
    def resting(self) -> bool:
        """Whether the view has been still for a while."""
        return time.monotonic() - self._moved > RESTING

    @property
    def models(self) -> list[fg.GaussianModel]:
        """The models that the view shows."""
        return [] if self._answer is None else [instance.model for instance in self._answer.instances]

    def done(self, answer) -> None:
        """Take over the result of the work; called by the thread."""
        if isinstance(answer, sorting.Sorted):
            self._answer = answer
        else:
            self.fallback.done(answer)

    def failed(self, error: Exception) -> None:
        """Take over the error of the work; called by the thread."""
        self.trouble = f"the viewport could not be drawn ({type(error).__name__}: {error}); the log holds the details."

    def draw(self, snapshot: Snapshot, camera: fg.Camera, display: Display, density: float = 1.0, playing: bool = False,
             around: Around | None = None, wait: bool = False, deep: bool = False, data: fallback.DataPass | None = None) -> None:
        """Draw a snapshot into the active framebuffer, with the order that is known by now, and ask the thread for what is missing.

        density   share of the splats to draw while the view moves, the time changes or the animation plays
        around    what hides splats; None: nothing does
        wait      sort first, on this thread
        deep      whether cover() will be called
        data      the pass to show in place of the picture: it is rendered as a final one, coarsely while the view moves
        """
        seen = _signature(camera)
        if (data and data.name) != (self._data and self._data.name):
            self.fallback.forget()
        self._data = data
        state = seen, snapshot.state, around and around.state, data and (data.name, data.state)
        if self._seen is not None and state != self._seen:
            self._moved = time.monotonic()
        self._seen, self._last = state, (snapshot, camera)
        still = self.resting and not playing
        self._density = 1.0 if still else density
        if self.as_final:
            self._rough = data is not None and not still
        key = snapshot.state, seen, self._density, self.fallback.needed, objects.reloads(), data and (data.name, data.state, still)
        if wait:
            self._ask(snapshot, camera, display, key, wait)
        if self.as_final:
            self.fallback.draw()
        elif self._answer is not None:
            try:
                self._draw(snapshot, camera, display, around, still, deep, wait)
            except TooLarge:
                self._fall_back("the models do not fit into the GPU's textures")
            except Exception as error:  # what a driver says about a shader comes as a bare Exception
                log.exception("the viewport's GPU path")
                self._fall_back(f"the GPU path is not available ({type(error).__name__})")
        if not wait:  # only now, so that the thread does not take Python's lock from what is drawn
            self._ask(snapshot, camera, display, key, wait)

    def cover(self, depths: Depths, window: tuple[int, int], floor: bool, marks) -> None:
        """Take overlays away where the splats that were drawn last lie before them, see Picture.cover()."""
        if not self.as_final and self._order is not None:
            self.picture.cover(depths, window, floor, marks)

    def timed(self) -> tuple[fg.Camera, int, dict[str, float]] | None:
        """(camera, splats in order, milliseconds of each stage, see timing.measure) of what was drawn last; None where nothing was."""
        if self._last is None or self._order is None or self.as_final:
            return None
        return self._last[1], self._order[1].count, timing.measure(*self._last)

    def free(self) -> None:
        """Free what is on the GPU."""
        self.worker.forget(self)
        self.picture.free()
        self.fallback.free()
        self._standing = {}
        self._answer = self._order = self._asked = self._depth = self._last = self._whole = self._fading = self._data = None

    def _ask(self, snapshot, camera, display, key, wait):
        if key == self._asked:
            return
        self._asked = key
        density, data = self._density, self._data
        if self.as_final:
            eye = fallback.coarse(camera) if self._rough else camera
            work = lambda: fallback.render(snapshot, eye, display.working, display.background, data)  # noqa: E731
        else:
            work = lambda: sorting.sort(snapshot, camera, density, self.atlas, self._standing)  # noqa: E731
        if wait:
            self.done(work())
        else:
            self.worker.ask(self, work)

    def _draw(self, snapshot, camera, display, around, still, deep, at_once):
        answer = self._answer
        self.trouble = next((f'"{name}": {text}' for name, text in answer.left_out), None)
        fine = still and answer.share >= 1  # all that a still picture has more than a moving one comes at once, and fades in
        each = bool(around and around.surfaces and (fine or around.moving))
        depth = self._depth_of(around) if each else None
        self._rough = bool(around and around.surfaces and not each)
        share = self._share(answer.share >= 1 and not self._rough, at_once)
        if self._order is None or self._order[0] is not answer:
            self._order = answer, Order(answer.order, answer.count)
        pairs, missing = snapshot.pairs(_known(answer.models), read=False)
        instances, gone = _as_sorted(pairs, {name for name, _ in missing}, answer)
        if instances:
            self.atlas.upload([instance.model for instance in instances], self.others())
        elif not snapshot.instances and self.atlas.nbytes and not self.others():
            self.atlas.clear()  # the last object is gone or hidden
        self.picture.draw(camera, [instance.viewed(camera) for instance in instances], self.atlas, self._order[1], depth,
                          deep or around is not None, gone)
        self.picture.resolve(**vars(display), depths=around.depths if around and depth is None and not around.moving else None, share=share)

    def _share(self, whole: bool, at_once: bool) -> float:
        """The weight of the new picture while it fades in over that of a moving view at the same moment; 1 otherwise."""
        now, before = time.monotonic(), self._whole
        self._whole = self._seen, whole
        if before is None or before[0] != self._seen or not whole or at_once:
            self._fading = None
        elif not before[1]:
            self._fading = now
            self.picture.keep()
        if self._fading is None:
            return 1.0
        share = (now - self._fading) / FADE
        if share >= 1:
            self._fading = None
        return min(share, 1.0)

    def _depth_of(self, around):
        """The depth of what is in the window, read once for each of its states."""
        state = self._seen
        if self._depth is None or self._depth[0] != state:
            self._depth = state, around.read()
        return self._depth[1]

    def _fall_back(self, why):
        self.trouble = f"{why}: the CPU draws the viewport, slowly."
        log.warning(self.trouble)
        self.fallback.needed = True
        self._asked = None


def _as_sorted(pairs, missing: set[str], answer: sorting.Sorted):
    """The instances in the order in which they were sorted, and the places of those that have been removed since.  New ones are left out.

    pairs    (FileInstance, Instance) of what is to be shown now
    missing  names of objects whose model is not in memory: they stay as they were, and so do those with another frame's model
    """
    now: dict = {}
    for item, instance in pairs:
        now.setdefault(item.key, []).append(instance)
    instances, gone = [], set()
    for number, (key, old) in enumerate(zip(answer.shown, answer.instances)):
        waiting = now.get(key)
        instance = waiting.pop(0) if waiting else None
        if instance is None and key[0] not in missing and not _stands(old, pairs):
            gone.add(number)
        instances.append(instance if instance is not None and instance.model is old.model else old)
    return instances, frozenset(gone)


def _stands(old, pairs) -> bool:
    """Whether the object of an instance is still where it was: a colour less of it, as when nothing is selected any more, takes nothing
    away."""
    return any(instance.name == old.name and np.array_equal(instance.placement, old.placement) for _, instance in pairs)


def _known(models):
    """A load_model() for Snapshot.load() that reads no file."""
    def load(path):
        if path not in models:
            raise fg.FastGSError(f"{path}: not read yet.")
        return models[path]

    return load


def _signature(c: fg.Camera):
    """A camera as values that can be compared."""
    return c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera.tobytes(), c.orthographic, c.near, c.far, c.tangent_limits()
