# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates of the cameras that training sharpens while it runs, and the queue of the statistics that they are updated from.

A GPU takes several steps before the values of the first arrive (TrainingBackend.begin_step).  Estimates are updated from a step so long
after it that its statistics are there in any case.  So every run updates at the same steps, a resumed one too.
"""
from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...captures.capture import Capture
from ...training.core.settings import Settings
from ...util.errors import FastGSError
from . import camera_response, camera_turns
from .camera_response import APART, CameraResponse
from .camera_turns import CameraTurns
from .start import Start

Sums = dict[str, np.ndarray]
"""Statistics of one step, float64 by name, with a row for each camera."""
SUMS = {name: shape for shapes in (camera_response.SHAPES, camera_turns.SHAPES) for name, shape in shapes.items() if name.endswith("_sums")}
KEPT = 16
"""Steps of which statistics are kept: more than a backend is ahead."""


@dataclass(frozen=True, eq=False)
class CameraEstimates:
    """Exposures, clocks and turns of the cameras trained on; `iterations` of the run."""

    response: CameraResponse
    turns: CameraTurns
    iterations: int

    @classmethod
    def initial(cls, capture: Capture, settings: Settings, start: Start | None = None) -> CameraEstimates:
        """The estimates at the first step, with the priors of a start, if given."""
        priors = (None, None, None) if start is None else (start.gains, start.fades, start.clocks)
        response = CameraResponse.initial(capture.training_views, capture.clip.frame_count, settings, *priors)
        turns = CameraTurns.initial(capture.training, settings.poses, {} if start is None else start.unsure)
        return cls(response, turns, settings.iterations)

    def measure(self, backend: Any, iteration: int, views: list, splat: Callable[..., Any]) -> list:
        """Arrays of the backend from which accumulate() makes the step's statistics; splat(view, later) renders a view so much later."""
        arrays = []
        if self.response.is_due(iteration, self.iterations):
            apart = APART * self.response.frame
            for view in views:
                clock = self.response.are_clocks_due(iteration, self.iterations, (view.shot.view,))
                sides = [splat(view, side) for side in (apart, -apart)] if clock else None
                arrays.append(self.response.measure(backend, view.shot, view.picture, view.rgb, view.weight, view.least,
                                                    view.target.background, sides))
        if self.turns.is_due(iteration, self.iterations):
            arrays += [array for view in views for array in backend.over(view.picture, view.target.background)]
        return arrays

    def accumulate(self, iteration: int, views: list, values: list[np.ndarray]) -> Sums:
        """A step's statistics from the values of what measure() gave; empty where nothing was due."""
        if not values:
            return {}
        shots, count = [view.shot for view in views], len(views)
        measured = values[:count] if self.response.is_due(iteration, self.iterations) else []
        pictures = values[len(measured):]  # of each view its picture and alpha
        turned = [self.turns.measure(view.shot, view.target, *pair) for view, *pair in zip(views, pictures[::2], pictures[1::2])]
        return self.response.accumulate(zip(shots, measured)) | self.turns.accumulate(zip(shots, turned))

    def updated(self, sums: Sums) -> CameraEstimates:
        """The estimates after a step's statistics."""
        new = deepcopy(self)
        new.response.update(sums["colour_sums"], sums["clock_sums"])
        new.turns.update(sums["turn_sums"])
        return new

    def facts(self) -> dict:
        """JSON values of what was found, empty where cameras are alike and right."""
        return self.response.facts() | self.turns.facts()

    def state(self) -> dict[str, np.ndarray]:
        """The arrays that a checkpoint holds."""
        return {name: getattr(part, name) for part, shapes in self._parts() for name in shapes}

    def restored(self, arrays: dict[str, np.ndarray]) -> CameraEstimates:
        """The estimates with the arrays of state(); raises FastGSError for other cameras."""
        count = len(arrays["turns"])
        if count != len(self.turns.views):
            raise FastGSError(f"the checkpoint is of a run with {count} cameras, not {len(self.turns.views)}; delete it to train from the "
                              "beginning.")
        response, turns = (replace(part, **{name: np.array(arrays[name]) for name in shapes}) for part, shapes in self._parts())
        return replace(self, response=response, turns=turns)

    def _parts(self) -> tuple:
        return (self.response, camera_response.SHAPES), (self.turns, camera_turns.SHAPES)


@dataclass(eq=False)
class DelayedStatistics:
    """The queue between the steps and the estimates.

    estimates  as they are now; each update makes other ones
    updated    the last step that they were updated from
    arrived    the statistics of the latest steps by their numbers, used or not: a step that is taken again updates again
    """

    estimates: CameraEstimates
    updated: int = -1
    arrived: dict[int, Sums] = field(default_factory=dict)

    def arrive(self, step: int, sums: Sums) -> None:
        """Queue a step's statistics."""
        if sums:
            self.arrived[step] = sums

    def update(self, last: int) -> None:
        """Update the estimates from the queued steps up to this one."""
        for step in sorted(step for step in self.arrived if self.updated < step <= last):
            self.estimates = self.estimates.updated(self.arrived[step])
        self.updated = max(self.updated, last)
        self.arrived = {step: sums for step, sums in self.arrived.items() if step > last - KEPT}

    def state(self) -> dict[str, np.ndarray]:
        """The arrays that a checkpoint holds: the estimates, and the queue with its steps."""
        steps = sorted(step for step in self.arrived if step > self.updated)
        count = len(self.estimates.turns.views)
        queue = {f"delayed.{name}": np.array([self.arrived[step][name] for step in steps], np.float64).reshape(len(steps), count, *shape)
                 for name, shape in SUMS.items()}
        return self.estimates.state() | queue | {"delayed.steps": np.array(steps, np.int64)}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the arrays of state(); raises FastGSError for other cameras."""
        self.estimates, self.updated = self.estimates.restored(arrays), -1
        self.arrived = {int(step): {name: arrays[f"delayed.{name}"][k] for name in SUMS} for k, step in enumerate(arrays["delayed.steps"])}
