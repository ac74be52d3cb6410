# SPDX-License-Identifier: GPL-3.0-or-later
"""Guesses of numbers that only the device knows, so that a training step does not wait for them: how many splats a part of the picture
shows, and how many entries its tile lists have.

The first step of a picture's size reads such a number.  Later ones make room for a quarter more than it has ever been, and the device
checks: what does not fit sets device.spilled, and then this step and those begun after it leave everything as it was and are taken again
(steps.end).
"""
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from .device import Array, Device, TooLarge

HEADROOM = 1.25
"""Room for a guessed number, as a multiple of the largest that it has been."""
LEAST = 4096
"""The least room."""


@dataclass(eq=False)
class Guess:
    """largest: the largest that a number has been; longest: the same on the device, [1], ahead of what the CPU knows."""

    largest: int
    longest: Array


def room_for(device: Device, key: Hashable, most: int, guess: bool, count: Callable[[], int], what: str) -> tuple[int, Guess | None]:
    """Room for a number, and the Guess that the device checks; or the number itself and None, where nothing is known of it yet.

    key    what the number is of: the same for the same part of pictures of one size
    most   the most that there may be room for; raises TooLarge where the number is, or has been, larger
    guess  whether it may be guessed;  count()  waits for the device and gives it;  what  its name in a sentence
    """
    found = device.guesses.get(key) if guess else None
    largest = count() if found is None else found.largest
    if guess and found is None:
        device.guesses[key] = Guess(largest, device.zeros((1,), np.uint32))
    if largest > most:
        raise TooLarge(f"{largest} {what} are more than it holds at once")
    return (largest, None) if found is None else (min(max(int(HEADROOM * largest), LEAST), most), found)
