# SPDX-License-Identifier: GPL-3.0-or-later
"""How different two display pictures look: LPIPS with AlexNet (version 0.1) and, where that cannot be measured, FLIP.

LPIPS needs torch, torchvision, lpips (which brings the small linear layers) and AlexNet's own weights in torch's cache: nothing is ever
downloaded.  FLIP (Andersson et al. 2020) needs no weights: it is NVIDIA's package flip-evaluator.
"""
import importlib
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np

ALEXNET = "alexnet-owt-*.pth"
SMALLEST = 64
"""Sides below this leave nothing of the picture in AlexNet's deeper layers."""


class Unavailable(Exception):
    """Why LPIPS cannot be measured here, as a sentence without its full stop."""


class Lpips:
    """Call it with a picture and the truth, [h, w, 3] in 0..1: gives (as 3DGS trainers report it, as its authors define it).

    3DGS and what derives from it feed values of 0..1 where the network was calibrated for -1..1.  Published tables of that
    family hold the first number, which is not comparable with the second.  Raises Unavailable.
    """

    def __init__(self) -> None:
        try:
            self._torch = importlib.import_module("torch")
            importlib.import_module("torchvision")
            package = importlib.import_module("lpips")
        except ImportError as error:
            reason = f"the package {error.name} is not installed (pip install lpips torchvision)"
            raise Unavailable(f"LPIPS is not measured, as {reason}") from error
        linear = Path(str(package.__file__)).parent / "weights" / "v0.1" / "alex.pth"
        folder = Path(self._torch.hub.get_dir()) / "checkpoints"
        trunk = next(iter(sorted(folder.glob(ALEXNET))), None)
        if trunk is None or not linear.is_file():
            missing = f"{folder / 'alexnet-owt-7be5be79.pth'} of torchvision" if linear.is_file() else f"{linear} of lpips"
            raise Unavailable(f"LPIPS is not measured, as its weights are not on this machine ({missing})")
        with warnings.catch_warnings():  # lpips calls torchvision in a way that it no longer likes
            warnings.simplefilter("ignore")
            self._network = package.LPIPS(net="alex", version="0.1", pretrained=False, pnet_rand=True, verbose=False)
        self._load(linear, "", self._network)
        self._load(trunk, "features.", self._network.net)
        self._network.eval()

    def _load(self, path: Path, prefix: str, module: Any) -> None:
        """Copy a state dict's tensors to the parameters whose names end alike; lpips has cut AlexNet's layers into slices."""
        try:
            state = self._torch.load(path, map_location="cpu", weights_only=True)
        except (RuntimeError, OSError, EOFError, pickle.UnpicklingError) as error:
            raise Unavailable(f"LPIPS is not measured, as {path} is damaged") from error
        parameters = {(name.partition(".")[2] if prefix else name): value for name, value in module.named_parameters()}
        for key, value in state.items():
            name = key.removeprefix(prefix)
            if key.startswith(prefix) and name in parameters and parameters[name].shape == value.shape:
                parameters.pop(name).data.copy_(value)
        left = [name for name in parameters if prefix or name.startswith("lin")]
        if left:
            raise Unavailable(f"LPIPS is not measured, as {path} lacks {left[0]}")

    def __call__(self, picture: np.ndarray, truth: np.ndarray, valid: np.ndarray | None = None) -> tuple[float | None, float | None]:
        if valid is not None:  # the network sees neighbourhoods: what is left out is cut away, to the rectangle around what is valid
            rows, columns = np.flatnonzero(np.any(valid, 1)), np.flatnonzero(np.any(valid, 0))
            if not len(rows):
                return None, None
            inside = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            picture, truth = picture[inside], truth[inside]
        if min(np.shape(picture)[:2]) < SMALLEST:
            return None, None
        tensors = [self._tensor(x) for x in (picture, truth)]
        with self._torch.no_grad():
            return float(self._network(*tensors)), float(self._network(*tensors, normalize=True))

    def _tensor(self, picture: np.ndarray) -> Any:
        clipped = np.clip(np.asarray(picture, np.float32), 0, 1)
        return self._torch.from_numpy(np.ascontiguousarray(clipped.transpose(2, 0, 1)[None]))


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
