# SPDX-License-Identifier: GPL-3.0-or-later
"""The optimiser: the trained arrays with Adam's moments, and the changes of rows that density control makes."""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...kernels.parameters import DECODER as SHARED
from ...util.backends import load_backend

PARTS = {"value": "arrays", "mean": "means", "square": "squares", "count": "counts"}


class Rows:
    """The optimiser's arrays as NumPy arrays, for density control: by name, with a row for each Gaussian but for those in SHARED.

    arrays, means, squares  [N, ...] float32    counts [N] int32    moved [N] int64    steps  taken so far
    """

    def __init__(self, arrays: dict[str, np.ndarray], means: dict[str, np.ndarray], squares: dict[str, np.ndarray],
                 counts: dict[str, np.ndarray], moved: np.ndarray, steps: int) -> None:
        self.arrays, self.means, self.squares, self.counts = arrays, means, squares, counts
        self.moved, self.steps = moved, steps

    def __len__(self) -> int:
        """N, the number of Gaussians."""
        return next(len(array) for name, array in self.arrays.items() if name not in SHARED)

    def take(self, index: np.ndarray) -> None:
        """Keep these Gaussians alone, in this order, with their moments."""
        for part in PARTS.values():
            values = getattr(self, part)
            values.update({name: values[name][index] for name in values if name not in SHARED})
        self.moved = self.moved[index]

    def append(self, arrays: dict[str, np.ndarray]) -> None:
        """Add Gaussians; their moments begin at zero.  arrays: all but the shared ones."""
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


class Optimiser:
    """Adam over arrays [N, ...] float32 of a backend, of which a step moves only the rows that it has seen.

    A row that was not seen keeps its moments as they are, and corrects its bias by the steps that it has taken itself.

    arrays   by name, trained in place; density control replaces them by longer or shorter ones
    steps    taken so far
    """

    arrays: dict[str, Any]
    means: dict[str, Any]
    squares: dict[str, Any]
    counts: dict[str, Any]

    def __init__(self, arrays: dict[str, np.ndarray], betas: tuple[float, float] = (0.9, 0.999), backend: Any = None) -> None:
        self.backend = backend or load_backend("cpu")
        self.betas, self.steps = betas, 0
        arrays = {name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()}
        means, squares = ({name: np.zeros_like(array) for name, array in arrays.items()} for _ in range(2))
        counts = {name: np.zeros(len(array), np.int32) for name, array in arrays.items()}
        rows = Rows(arrays, means, squares, counts, np.zeros(0, np.int64), 0)
        rows.moved = np.zeros(len(rows), np.int64)
        self._hand_over(rows)

    def __len__(self) -> int:
        """N, the number of Gaussians."""
        return self._count

    def _hand_over(self, rows: Rows) -> None:
        for part in PARTS.values():
            setattr(self, part, {name: self.backend.array(array) for name, array in getattr(rows, part).items()})
        self.moved, self._count = self.backend.array(rows.moved), len(rows)
        self._sizes = {name: array.size for name, array in rows.arrays.items()}

    @contextmanager
    def on_host(self) -> Iterator[Rows]:
        """Gives the optimiser's Rows to change; at the end they are the backend's again."""
        parts = {part: {name: self.backend.numpy(array) for name, array in getattr(self, part).items()} for part in PARTS.values()}
        rows = Rows(**parts, moved=self.backend.numpy(self.moved), steps=self.steps)
        yield rows
        self._hand_over(rows)

    def steps_since_update(self, rows: Any) -> Any:
        """Number of steps [N], the coming one included, that each row's next move stands for; 0 for the other rows.  Of the backend."""
        return self.backend.steps_since(rows, self.moved, self.steps + 1)

    def step(self, gradients: dict, rows: Any, rates: dict, since: Any = None, floors: dict[str, float] | None = None) -> None:
        """Move the rows (of the backend) and the shared arrays against their gradients, at most by about the rates; rows that were
        seen P steps ago by sqrt(P) of them (kernels.cpu.adam).

        gradients  arrays of the shapes of `arrays`; what is no finite number counts as zero
        rates      for each array a number, or one for each of its columns; arrays without a rate stay as they are
        since      steps_since_update(rows), where it is known
        floors     of some arrays, what is added to the root of the second moment
        """
        self.steps += 1
        tensors = [(self.arrays[name], gradients[name], self.means[name], self.squares[name], self.counts[name], rate,
                    (floors or {}).get(name, 0.0), name in SHARED)
                   for name, rate in rates.items() if self._sizes.get(name)]
        self.backend.adam(rows, tensors, self.betas, self.moved, self.steps, since)

    def state(self) -> dict[str, np.ndarray]:
        """Everything as NumPy arrays; on the CPU these are the optimiser's own, so copy them before further steps."""
        state = {f"{kind}.{name}": self.backend.numpy(array) for kind, part in PARTS.items() for name, array in getattr(self, part).items()}
        return {**state, "moved": self.backend.numpy(self.moved), "steps": np.array([self.steps], np.int64), "betas": np.array(self.betas)}

    @classmethod
    def restored(cls, state: dict[str, np.ndarray], backend: Any = None) -> Optimiser:
        """The optimiser that state() describes."""
        names = [key.removeprefix("value.") for key in state if key.startswith("value.")]
        first, second = (float(b) for b in state["betas"])
        optimiser = cls({name: state[f"value.{name}"] for name in names}, (first, second), backend)
        parts = {part: {name: np.array(state[f"{kind}.{name}"]) for name in names} for kind, part in PARTS.items()}
        optimiser.steps = int(state["steps"][0])
        optimiser._hand_over(Rows(**parts, moved=np.array(state["moved"]), steps=optimiser.steps))
        return optimiser
