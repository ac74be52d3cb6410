# SPDX-License-Identifier: GPL-3.0-or-later
"""Says what of a picture a GPU's backend leaves to the processor, so that nobody wonders why the GPU idles."""
from __future__ import annotations

import logging
from typing import Any

from .exposure import Exposure
from .passes import PassSettings

_told: set[str] = set()


def left_to_processor(backend: Any, exposure: Exposure | None, holdout: Any, settings: PassSettings) -> str:
    """A sentence that names what of a picture with these options of render() a backend leaves to the processor; "" for nothing.

    What a backend leaves stands in its `leaves` (protocol.PictureBackend).
    """
    asked = {
        "motion blur": exposure is not None and exposure.moves,
        "depth of field": exposure is not None and exposure.aperture is not None,
        "meshes that hide splats": holdout is not None,
        "shadows on meshes": settings.shadow is not None,
        "sorting by pixel": settings.by_pixel,
    }
    left = [name for name, on in asked.items() if on and name in getattr(backend, "leaves", ())]
    return f"The GPU does not compute {', '.join(left)}: the processor draws this picture." if left else ""


def tell_once(sentence: str) -> None:
    """Log a sentence, once in a program: an animation has many pictures."""
    if sentence and sentence not in _told:
        _told.add(sentence)
        logging.getLogger(__name__).warning(sentence)
