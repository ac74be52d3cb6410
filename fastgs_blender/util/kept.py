# SPDX-License-Identifier: GPL-3.0-or-later
"""Results that are kept while the object lives that they are about."""
import threading
from collections.abc import Callable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

About = TypeVar("About")
Result = TypeVar("Result")


def kept(function: Callable[[About], Result]) -> Callable[[About], Result]:
    """The function, whose result for an object is kept while that lives.  Two threads may both compute it; the later one is kept."""
    known: WeakKeyDictionary[About, Result] = WeakKeyDictionary()
    lock = threading.Lock()

    @wraps(function)
    def asked(about: About) -> Result:
        with lock:
            if about in known:
                return known[about]
        result = function(about)
        with lock:
            known[about] = result
        return result

    return asked
