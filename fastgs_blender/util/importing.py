# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports modules when they are needed first."""
import gc
import importlib
from types import ModuleType


def import_quickly(name: str, package: str | None = None) -> ModuleType:
    """importlib.import_module() without looking for garbage meanwhile: nearly all that modules make stays, numba's half a million objects
    above all.  Looking through them took a tenth of the time from start to first frame."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(name, package)
    finally:
        if collecting:
            gc.enable()
