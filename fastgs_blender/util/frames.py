# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame ranges as people write them: A, A:B or A:B:S, both ends included as in Blender, fractions allowed.

Decimal numbers, so that 0:1:0.1 has eleven frames and each is where it says.
"""
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from .errors import FastGSError

MOST = 1_000_000
DECIMALS = 6


@dataclass(frozen=True)
class Frames:
    """Frame numbers, counted from 0, and how many decimals their names have."""

    numbers: tuple[Decimal, ...]
    decimals: int = 0

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[Decimal]:
        return iter(self.numbers)

    def label(self, frame: Decimal, digits: int = 4) -> str:
        """The frame's number in file names: all of a range have the same decimals, so that names sort by time."""
        sign = "-" if frame < 0 else ""
        whole = digits + (self.decimals + 1 if self.decimals else 0)
        return f"{sign}{abs(frame):0{whole}.{self.decimals}f}"


def parse_frames(text: str) -> Frames:
    """The frames that "A", "A:B" or "A:B:S" means; raises FastGSError with the rule if it means none."""
    rule = f"frames are written A, A:B or A:B:S (both ends included, S above 0), not {text!r}."
    try:
        parts = [Decimal(part) for part in text.split(":")]
    except InvalidOperation as error:
        raise FastGSError(rule) from error
    if len(parts) > 3 or not all(part.is_finite() and abs(part) < 10**9 for part in parts):
        raise FastGSError(rule)
    start, stop, step = parts[0], parts[-1] if len(parts) == 1 else parts[1], parts[2] if len(parts) == 3 else Decimal(1)
    if step <= 0 or stop < start:
        raise FastGSError(rule)
    if any(part != round(part, DECIMALS) for part in parts):
        raise FastGSError(f"frame numbers have at most {DECIMALS} decimals, unlike those of {text!r}.")
    decimals = max(0, *(-int(round(part, DECIMALS).normalize().as_tuple().exponent) for part in (start, step)))
    if (stop - start) / step >= MOST:
        raise FastGSError(f"the range {text!r} has more than {MOST} frames; give a shorter one.")
    count = int((stop - start) / step) + 1
    return Frames(tuple(start + i * step for i in range(count)), decimals)
