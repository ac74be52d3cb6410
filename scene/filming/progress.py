# SPDX-License-Identifier: GPL-3.0-or-later
"""The progress of filming the open scene: the share of pictures that are done, and the time for each picture."""
import time
from collections.abc import Callable
from dataclasses import dataclass

import bpy

from ...fastgs_blender.jobs import checks


@dataclass
class Filming:
    """A filming under way.

    name   the capture's folder, for messages
    done   pictures that are there, of `total`
    made   how many of them this filming has made
    doing  what is being done, where it is not filming: done and total are then of that
    clock  gives the time in seconds from any beginning
    """

    name: str
    done: int = 0
    total: int = 0
    made: int = 0
    doing: str = "Filming"
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self):
        self._began = self.clock()

    def step(self, done: int, total: int, doing: str = "Filming") -> None:
        """Record the number of pictures that are done."""
        self.made += doing == "Filming" and done > self.done
        self.done, self.total, self.doing = done, total, doing

    @property
    def share(self) -> float:
        """0..1."""
        return min(self.done / self.total, 1.0) if self.total else 0.0

    @property
    def seconds_each(self) -> float | None:
        """Seconds that a picture takes; None before the first and after the last."""
        return (self.clock() - self._began) / self.made if self.made and self.doing == "Filming" else None

    @property
    def seconds_left(self) -> float | None:
        """Seconds until all pictures are there; None before the first."""
        each = self.seconds_each
        return None if each is None else each * (self.total - self.done)


current: Filming | None = None
"""The filming under way, None where there is none."""
_measured: dict[str, tuple[float, float]] = {}
"""By the scene's name: the work of a picture as work() counts it, and the seconds that it took when the scene was last filmed."""


def work(scene: bpy.types.Scene, options) -> int:
    """Pixels times samples of a picture; options: CaptureOptions."""
    samples = options.samples
    if options.quality == 'SCENE':
        samples = scene.cycles.samples if scene.render.engine == 'CYCLES' else scene.eevee.taa_render_samples
    return options.width * options.height * samples


def measure(scene: bpy.types.Scene, options) -> None:
    """Remember how long the pictures take that are filmed just now."""
    if current is not None and current.seconds_each is not None:
        _measured[scene.name] = work(scene, options), current.seconds_each


def estimate(scene: bpy.types.Scene, options, pictures: int) -> float:
    """Seconds that filming will take: by how long the scene's pictures took before, else very roughly."""
    if scene.name in _measured:
        before, seconds = _measured[scene.name]
        return pictures * seconds * work(scene, options) / max(before, 1)
    return checks.filming(work(scene, options), pictures)
