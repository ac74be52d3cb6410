# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts: named selections of a model's Gaussians, such as the things of a scene, that its file keeps."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..util.errors import FastGSError

MOST, LONGEST = 256, 200
"""Parts of a model, and letters of a name."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Which of N Gaussians belong to each of P parts; a Gaussian may belong to several, or to none.

    names  of the parts, each once
    bits   [N, P] bool

    Raises FastGSError where names and columns do not fit together.

    Example:
        import dataclasses

        bits = np.arange(len(model)) < 100
        model = dataclasses.replace(model, parts=fg.Parts.of({"Hat": bits}))
        hat = model.take(model.parts["Hat"])
    """

    names: tuple[str, ...] = ()
    bits: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))

    def __post_init__(self) -> None:
        names, bits = tuple(self.names), np.asarray(self.bits)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "bits", bits)
        good = all(isinstance(name, str) and 0 < len(name) <= LONGEST for name in names) and len(set(names)) == len(names) <= MOST
        if not good:
            raise FastGSError(f"a model has at most {MOST} parts, each with a name of its own of at most {LONGEST} letters.")
        if bits.ndim != 2 or bits.dtype != bool or bits.shape[1] != len(names):
            raise FastGSError(f"the bits of {len(names)} parts must be bool of the shape (Gaussians, {len(names)}), not {bits.dtype} of "
                              f"{bits.shape}.")

    @classmethod
    def of(cls, chosen: Mapping[str, np.ndarray]) -> Parts:
        """Parts by their names, each with its Gaussians [N] bool."""
        return cls(tuple(chosen), np.stack([np.asarray(bits) for bits in chosen.values()], 1) if chosen else np.zeros((0, 0), bool))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> np.ndarray:
        """Which Gaussians [N] belong to the part of that name; raises FastGSError where there is none."""
        if name not in self.names:
            raise FastGSError(f"the model has no part {name!r}; its parts are {', '.join(self.names) or 'none'}.")
        return self.bits[:, self.names.index(name)]

    def items(self) -> list[tuple[str, np.ndarray]]:
        """(name, Gaussians [N]) of each."""
        return list(zip(self.names, self.bits.T))

    def take(self, index: Any) -> Parts:
        """The parts of some of the Gaussians."""
        return Parts(self.names, self.bits[index]) if self.names else self


def told_apart(named: list[tuple[str, int]]) -> Parts:
    """The parts of a model that holds several objects one after another, each with its name ("": it belongs to no part) and so many
    Gaussians; those of one name become one.  There are none where all have the same name, or more or longer names than a model can have."""
    names = list(dict.fromkeys(name for name, _ in named))
    if len(names) < 2 or len(names) > MOST or max(map(len, names)) > LONGEST:
        return Parts()
    owner = np.repeat([names.index(name) for name, _ in named], [count for _, count in named])
    return Parts.of({name: owner == number for number, name in enumerate(names) if name})


def pieces(parts: Parts, count: int) -> list[tuple[str, np.ndarray]]:
    """(name, indices) of what is left where each of so many Gaussians belongs to the first part that has it; "": to none."""
    owner = np.where(parts.bits.any(1), parts.bits.argmax(1), len(parts)) if parts.names else np.zeros(count, int)
    found = [(name, np.flatnonzero(owner == number)) for number, name in enumerate((*parts.names, ""))]
    return [(name, index) for name, index in found if len(index)] or [("", np.arange(count))]


def parts_together(all_parts: list[tuple[Parts, int]]) -> Parts:
    """The parts of several models, one after another, of so many Gaussians each; those of one name become one."""
    names = tuple(dict.fromkeys(name for parts, _ in all_parts for name in parts.names))
    if not names:
        return Parts()
    bits = [np.stack([parts[name] if name in parts.names else np.zeros(count, bool) for name in names], 1) for parts, count in all_parts]
    return Parts(names, np.concatenate(bits))
