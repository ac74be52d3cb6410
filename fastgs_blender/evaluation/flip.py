# SPDX-License-Identifier: GPL-3.0-or-later
"""FLIP (Andersson et al. 2020), the perceptual difference of two display pictures, through NVIDIA's package flip-evaluator.

It stands where LPIPS cannot be measured: it needs no weights.
"""
import importlib

import numpy as np

from .perceptual import Unavailable


class Flip:
    """Call it with a picture and the truth, [h, w, 3] in 0..1, and valid [h, w] or None: gives the mean of FLIP, 0 (equal) to 1.

    It assumes the package's usual viewing distance of 67 pixels per degree.  Raises Unavailable where the package is not installed.
    """

    def __init__(self) -> None:
        try:
            self._package = importlib.import_module("flip_evaluator")
        except ImportError as error:
            reason = "the package flip_evaluator is not installed (pip install flip-evaluator)"
            raise Unavailable(f"FLIP is not measured, as {reason}") from error

    def __call__(self, picture: np.ndarray, truth: np.ndarray, valid: np.ndarray | None = None) -> float | None:
        test, reference = (np.ascontiguousarray(np.clip(x, 0, 1), np.float32) for x in (picture, truth))
        error = np.asarray(self._package.evaluate(reference, test, "LDR", applyMagma=False)[0], np.float64).reshape(test.shape[:2] + (-1,))
        error = error[..., 0]
        if valid is not None:
            error = error[np.asarray(valid) > 0]
        return float(error.mean()) if error.size else None
