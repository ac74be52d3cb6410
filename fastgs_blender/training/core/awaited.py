# SPDX-License-Identifier: GPL-3.0-or-later
"""What the pictures of steps said of exposures and clocks, or of poses, on its way to the Evening, or the Poses.

A GPU takes several steps before the values of the first are asked for (TrainingBackend.begin_step).  What learns from a step does so that
long after it that the step's values are there whatever waits for them, so every run takes the same steps, a resumed one too.
"""
from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from .camera_response import AWAITED, Evening
from .camera_turns import Poses

Learner = TypeVar("Learner", Evening, Poses)
"""What it is estimated in: said() makes sums of what steps found, learn() takes them, and SUMS are the names of its own such sums."""


@dataclass(eq=False)
class Awaited(Generic[Learner]):
    """An evening or poses, and what they have not learnt yet.

    known    as it has learnt so far; each learning makes another one
    lead     the steps that a backend is ahead; 0: it learns from each step at once
    learnt   the last step that it has learnt from
    said     said() of the latest steps by their numbers, learnt or not: a step that is taken again learns again
    """

    known: Learner
    lead: int = 0
    learnt: int = -1
    said: dict[int, tuple[np.ndarray, ...]] = field(default_factory=dict)

    def listening(self, i: int, ending: Callable[[], list | None], shots: list, total: Callable[[list], None]) -> Callable[[], list | None]:
        """The end of step i, of which the last arrays are compared() of these shots: it keeps what they said.  total() sums arrays
        over all processes."""
        known = self.known

        def end() -> list | None:
            values = ending()
            if values is None or not shots:
                return values
            said = known.said(zip(shots, values[-len(shots):], strict=True))
            total(list(said))
            self.said[i] = said
            return values[:-len(shots)]

        if self.lead:
            return end
        values = end()
        return lambda: values

    def learn(self, i: int) -> None:
        """Learn from what is due after step i has begun."""
        last = i - self.lead - 1 if self.lead else i
        for step in sorted(step for step in self.said if self.learnt < step <= last):
            self.known = deepcopy(self.known)
            self.known.learn(*self.said[step])
        self.learnt = max(self.learnt, last)
        self.said = {step: said for step, said in self.said.items() if step > last - AWAITED}

    def state(self, iteration: int) -> dict[str, np.ndarray]:
        """The arrays that a checkpoint after so many steps holds: what is known, and what is not learnt yet, the latest step first."""
        found = self.known.state()
        for k, name in enumerate(self._names()):
            found[name] = np.zeros((AWAITED, *getattr(self.known, self.known.SUMS[k]).shape))
            for step, said in self.said.items():
                if step > self.learnt:
                    found[name][iteration - 1 - step] = said[k]
        return found

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Restore the arrays of state(); a checkpoint of an earlier version lacks some.  Raises FastGSError for other cameras."""
        self.known.restore({name: array for name, array in arrays.items() if name not in self._names()})
        waiting = enumerate(zip(*(arrays.get(name, ()) for name in self._names())))
        self.said = {iteration - 1 - place: said for place, said in waiting if any(sums.any() for sums in said)}
        self.learnt = iteration - 1 - AWAITED

    def _names(self) -> list[str]:
        """Names of the arrays of what is not learnt yet."""
        return [f"awaited_{name}" for name in self.known.SUMS]
