# SPDX-License-Identifier: GPL-3.0-or-later
"""The optimiser: the arrays that are trained, Adam's moments of them, and the changes of rows that density control asks for."""
from __future__ import annotations

import numpy as np

from ...kernels.cpu import adam
from ...util.threads import ranges, run

SHARED = ("w1", "w2")
"""Arrays of the whole model; the others have a row for each Gaussian."""
ROWS = 16_384
"""Rows in one piece of work."""
PARTS = {"value": "arrays", "mean": "means", "square": "squares", "count": "counts"}


class Optimiser:
    """Adam over arrays [N, ...] float32, of which a step moves only the rows that it has seen.

    A row that was not seen keeps its moments as they are, and corrects its bias by the steps that it has taken itself.

    arrays   by name, trained in place; density control replaces them by longer or shorter ones
    steps    taken so far
    """

    def __init__(self, arrays: dict[str, np.ndarray], betas: tuple[float, float] = (0.9, 0.999)):
        self.arrays = {name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()}
        self.means = {name: np.zeros_like(array) for name, array in self.arrays.items()}
        self.squares = {name: np.zeros_like(array) for name, array in self.arrays.items()}
        self.counts = {name: np.zeros(len(array), np.int32) for name, array in self.arrays.items()}
        self.betas, self.steps = betas, 0
        self.moved = np.zeros(len(self), np.int64)

    def __len__(self) -> int:
        """N, the number of Gaussians."""
        return next(len(array) for name, array in self.arrays.items() if name not in SHARED)

    def waited(self, rows) -> np.ndarray:
        """How many steps, the coming one included, each row's next move stands for [rows] float32: 1 if it moved in the last one."""
        return (self.steps + 1 - self.moved[rows]).astype(np.float32)

    def step(self, gradients: dict[str, np.ndarray], rows: np.ndarray, rates: dict) -> None:
        """Move the rows (distinct indices of Gaussians) and the shared arrays against their gradients, at most by about the rates.

        gradients  arrays of the shapes of `arrays`; what is no finite number counts as zero
        rates      for each array a number, or one for each of its columns; arrays without a rate stay as they are
        """
        rows = np.ascontiguousarray(rows, np.int64)
        table, pieces = adam.corrections(*self.betas), []
        for name, rate in rates.items():
            if name not in self.arrays or not self.arrays[name].size:
                continue
            n = len(self.arrays[name])
            these = np.arange(n) if name in SHARED else rows
            value, gradient, mean, square = (a.reshape(n, -1) for a in (
                self.arrays[name], np.ascontiguousarray(gradients[name], np.float32), self.means[name], self.squares[name]))
            columns = np.broadcast_to(np.asarray(rate, np.float32).reshape(-1), value.shape[1]).copy()
            rest = (these, value, gradient, mean, square, self.counts[name], columns, *self.betas, table)
            pieces += [(*piece, rest) for piece in ranges(len(these), ROWS)]
        run(lambda first, last, rest: adam.adam(first, last, *rest), pieces)
        self.steps += 1
        self.moved[rows] = self.steps

    def take(self, index: np.ndarray) -> None:
        """Keep these Gaussians alone, in this order, with their moments."""
        for part in PARTS.values():
            values = getattr(self, part)
            values.update({name: values[name][index] for name in values if name not in SHARED})
        self.moved = self.moved[index]

    def append(self, arrays: dict[str, np.ndarray]) -> None:
        """Add Gaussians; their moments begin at nothing.  arrays: all but the shared ones."""
        born = 0
        for name, array in arrays.items():
            born = len(array)
            self.arrays[name] = np.concatenate([self.arrays[name], np.asarray(array, np.float32)])
            for part in ("means", "squares", "counts"):
                values = getattr(self, part)
                values[name] = np.concatenate([values[name], np.zeros((born, *values[name].shape[1:]), values[name].dtype)])
        self.moved = np.append(self.moved, np.full(born, self.steps))

    def reset(self, name: str, rows: np.ndarray) -> None:
        """Forget the moments of some rows of an array, as if they had never moved."""
        for part in ("means", "squares", "counts"):
            getattr(self, part)[name][rows] = 0

    def state(self) -> dict[str, np.ndarray]:
        """Everything as plain arrays, the optimiser's own: copy them if it goes on."""
        state = {f"{kind}.{name}": array for kind, part in PARTS.items() for name, array in getattr(self, part).items()}
        return {**state, "moved": self.moved, "steps": np.array([self.steps]), "betas": np.array(self.betas)}

    @classmethod
    def restored(cls, state: dict[str, np.ndarray]) -> Optimiser:
        """The optimiser that state() describes."""
        names = [key.removeprefix("value.") for key in state if key.startswith("value.")]
        optimiser = cls({name: state[f"value.{name}"] for name in names}, tuple(float(b) for b in state["betas"]))
        for kind, part in PARTS.items():
            getattr(optimiser, part).update({name: np.array(state[f"{kind}.{name}"]) for name in names})
        optimiser.moved, optimiser.steps = np.array(state["moved"]), int(state["steps"][0])
        return optimiser
