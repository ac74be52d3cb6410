# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of a GPU's self-test, as it is stored, listed and handed from one process to another."""
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class Verdict:
    """What the self-test of a GPU has found (kernels/gpu/selftest.py).

    fault        what is wrong with it, as a clause; "": nothing
    frame, step  (the GPU's, the processor's) milliseconds of a small frame and of a small training step; None where they were not taken:
                 of a GPU with a fault, and of software
    """

    fault: str
    frame: tuple[float, float] | None = None
    step: tuple[float, float] | None = None

    @property
    def faster(self) -> bool:
        """Whether it is faster than the processor, in both."""
        return not self.fault and all(pair is not None and pair[0] < pair[1] for pair in (self.frame, self.step))

    @property
    def pace(self) -> str:
        """Both times beside the processor's, as a part of a sentence."""
        found = (("frame", self.frame), ("training step", self.step))
        return ", ".join(f"{name} {pair[0]:.3g} ms, processor {pair[1]:.3g} ms" for name, pair in found if pair)

    def values(self) -> dict:
        """As JSON values."""
        return {"self_test": self.fault, "frame_ms": self.frame, "step_ms": self.step}


def read_verdict(values: dict) -> Verdict | None:
    """What values() gave, or a list of describe_devices(); None where it is none, or of a GPU that has not been tested."""
    fault, *pairs = (values.get(name) for name in ("self_test", "frame_ms", "step_ms"))
    if not isinstance(fault, str):
        return None
    found = [(float(pair[0]), float(pair[1])) for pair in pairs if isinstance(pair, list | tuple) and len(pair) == 2
             and all(isinstance(number, int | float) and 0 < number <= sys.float_info.max for number in pair)]
    return Verdict(fault, *found) if len(found) == 2 else Verdict(fault)
