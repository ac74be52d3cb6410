# SPDX-License-Identifier: GPL-3.0-or-later
"""Static Gaussians that a network moves: Deformable-3DGS and 4DGaussians (HexPlane), evaluated here at any time, in NumPy.

Both keep the static Gaussians as an INRIA PLY, point_cloud/iteration_<n>/point_cloud.ply, and the network's weights as a PyTorch file:
deform/iteration_<n>/deform.pth, and deformation.pth beside the PLY.  The PLY is opened; the weights are read by torch_zip.py.  t is
their own normalised time, 0 to 1; how many frames the capture has they do not say.
"""
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.gaussians import Clip, GaussianModel
from ..model.sequence import Computed, Source
from ..util import rotations
from ..util.errors import FastGSError, LossWarning
from ..util.identity import status_of
from ..util.reading import reading
from . import cfg_args, ellipsoids, ply, torch_zip
from .base import Loader, require_sound, usable
from .foreign import GAUSSIAN
from .inria import Inria
from .sequences import SequenceFormat
from .trainer_cameras import with_cameras

CLIP = Clip(300, 30.0)
PLANES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
"""The axes x, y, z, t that each plane of a HexPlane spans."""
HEADS = (("no_dx", "pos_deform", "position"), ("no_ds", "scales_deform", "scale"), ("no_dr", "rotations_deform", "rotation"),
         ("no_do", "opacity_deform", "opacity"), ("no_dshs", "shs_deform", "features"))
"""Of 4DGaussians: the setting that switches a head off, the head, and what it changes."""
COARSE = "coarse_iteration_"
"""Of 4DGaussians: folders of its first stage, which is drawn without its network."""
ROWS = 1 << 15
"""Gaussians that go through a network at once."""
Weights = dict[str, np.ndarray]
Move = Callable[[GaussianModel, float], GaussianModel]


class DeformedFormat(SequenceFormat):
    """A PLY of static Gaussians with a network.

    weights_of  weights_of(path of the PLY) -> where the weights lie
    network     network(weights, settings) -> a function (model, t) -> model
    """

    reads = (".ply",)

    @staticmethod
    def weights_of(path: Path) -> Path:
        raise NotImplementedError

    @staticmethod
    def network(weights: Weights, settings: dict) -> Move:
        raise NotImplementedError

    def sniff(self, head: bytes, path: Path) -> bool:
        return head.startswith(b"ply") and self.weights_of(path).is_file() and ply.read_header(path).names.issuperset(GAUSSIAN)

    def load(self, path: Path) -> GaussianModel:
        raise FastGSError("its Gaussians are moved by a network, which is computed for each time; open it with open_source(), or turn it "
                          "into one model with fastgs convert.")

    def open(self, path: Path, load: Loader) -> Source:
        file = self.weights_of(path)
        still = with_cameras(usable(Inria().load(path), path), path)
        settings = cfg_args.find(path)
        if settings is None:
            warnings.warn(LossWarning(f"{path}: its cfg_args are missing, so the network is taken to be of the usual kind."), stacklevel=3)
        try:
            with np.errstate(all="ignore"):
                move = self.network(_weights(file), cfg_args.read(settings) if settings else {})
        except (KeyError, ValueError, IndexError) as error:
            raise FastGSError(f"{file}: the weights of its network do not fit together ({error}); save it again.") from error

        def compute(t: float) -> GaussianModel:
            with reading(file), np.errstate(all="ignore"):  # what is not finite is found afterwards
                model = move(still, t)
            require_sound(model.arrays, file)
            return model

        return Computed(CLIP, compute, lambda: (status_of(str(path)), status_of(str(file))), str(path))


class DeformableGaussians(DeformedFormat):
    """Deformable-3DGS (ingra14m): eight layers of 256 see the encoded place and time, and say how each Gaussian changes.

    What is added to the unit quaternion leaves it any length, and its rasteriser takes it so: the Gaussians are sheared.
    """

    name = "Deformable-3DGS"

    @staticmethod
    def weights_of(path: Path) -> Path:
        iteration = path.absolute().parent
        return iteration.parent.parent / "deform" / iteration.name / "deform.pth"

    @staticmethod
    def network(weights: Weights, settings: dict) -> Move:
        def move(model: GaussianModel, t: float) -> GaussianModel:
            parts = [_deform(weights, model.position[at:at + ROWS], t) for at in range(0, len(model), ROWS)]
            place, turn, size = (np.concatenate(each) for each in zip(*parts)) if parts else (model.position, 0, 0)
            scale, rotation = ellipsoids.of_raw_quaternions(rotations.unit(model.rotation.astype(np.float64)) + turn,
                                                            np.exp(model.scale.astype(np.float64)) + size)
            return replace(model, position=place, rotation=rotation, scale=scale)

        _deform(weights, np.zeros((1, 3), np.float32), 0.0)  # says now what does not fit
        return move


class HexPlaneGaussians(DeformedFormat):
    """4DGaussians (hustvl): six planes over pairs of x, y, z, t give each Gaussian features, and a small network its changes."""

    name = "4DGaussians"

    @staticmethod
    def weights_of(path: Path) -> Path:
        return path.with_name("deformation.pth")

    def sniff(self, head: bytes, path: Path) -> bool:
        return super().sniff(head, path) and not path.absolute().parent.name.startswith(COARSE)

    @staticmethod
    def network(weights: Weights, settings: dict) -> Move:
        weights = {name.removeprefix("deformation_net."): value for name, value in weights.items()}
        usual = {"no_dx": False, "no_ds": False, "no_dr": False, "no_do": True, "no_dshs": True}
        off = {key: bool(settings.get(key, value)) for key, value in usual.items()}
        heads = [(head, name) for flag, head, name in HEADS if not off[flag] and f"{head}.1.weight" in weights]

        def move(model: GaussianModel, t: float) -> GaussianModel:
            parts = [_hexplane(weights, model.position[at:at + ROWS], t) for at in range(0, len(model), ROWS)]
            if not parts:
                return model
            hidden = np.concatenate(parts)
            kept, changed = _kept(weights, hidden, model.position), {}
            for head, name in heads:
                before = getattr(model, name).reshape(len(model), -1)
                change = _head(weights, head, hidden)[:, :before.shape[1]]
                if name != "rotation":
                    after = before * kept + change
                else:
                    after = rotations.multiply(before, change) if settings.get("apply_rotation") else before + change
                changed[name] = after.reshape(getattr(model, name).shape)
            return replace(model, **changed)

        hidden = _hexplane(weights, np.zeros((1, 3), np.float32), 0.0)  # says now what does not fit
        for head, _ in heads:
            _head(weights, head, hidden)
        _kept(weights, hidden, np.zeros((1, 3)))
        return move


def _weights(path: Path) -> Weights:
    """The arrays of a state dict, float32."""
    file = torch_zip.TorchFile(path)
    if not isinstance(file.content, dict):
        raise FastGSError(f"{path}: it is no table of a network's weights; save it again.")
    tensors = {name: value for name, value in file.content.items() if isinstance(name, str) and isinstance(value, torch_zip.Tensor)}
    if sum(math.prod(value.shape) for value in tensors.values()) > file.length:  # four bytes each
        raise FastGSError(f"{path}: its network would be far larger than the file, which holds the same numbers many times; save it again.")
    with np.errstate(over="ignore", invalid="ignore"):
        return {name: value.read().astype(np.float32) for name, value in tensors.items()}


def _linear(weights: Weights, name: str, x: np.ndarray) -> np.ndarray:
    return x @ weights[name + ".weight"].T + weights[name + ".bias"]


def _relu(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0)


def _encoded(x: np.ndarray, octaves: int) -> np.ndarray:
    """x [N, D], then for each octave its sines and its cosines."""
    parts = [x]
    for k in range(octaves):
        parts += [np.sin(x * 2.0**k), np.cos(x * 2.0**k)]
    return np.concatenate(parts, 1).astype(np.float32)


def _deform(weights: Weights, position: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """New positions [N, 3], and what is added to unit quaternions [N, 4] and standard deviations [N, 3]."""
    place = _encoded(position.astype(np.float64), 10)
    if "timenet.0.weight" in weights:
        time = _linear(weights, "timenet.2", _relu(_linear(weights, "timenet.0", _encoded(np.full((1, 1), t), 6))))
    else:
        time = _encoded(np.full((1, 1), t), 10)
    seen = np.concatenate([place, np.broadcast_to(time, (len(place), time.shape[1]))], 1)
    h = seen
    layers = sum(name.startswith("linear.") and name.endswith(".weight") for name in weights)
    for k in range(layers):
        h = _relu(_linear(weights, f"linear.{k}", h))
        if k == layers // 2:
            h = np.concatenate([seen, h], 1)
    turn, size = _linear(weights, "gaussian_rotation", h), _linear(weights, "gaussian_scaling", h)
    if "branch_w.weight" not in weights:
        return position + _linear(weights, "gaussian_warp", h), turn, size
    axis, slide = (_linear(weights, name, h).astype(np.float64) for name in ("branch_w", "branch_v"))
    angle = np.linalg.norm(axis, axis=1, keepdims=True)
    axis, slide = axis / angle + 1e-5, slide / angle + 1e-5
    cross = np.zeros((len(axis), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]], cross[:, [1, 2, 0], [2, 0, 1]] = axis, -axis
    square, angle = cross @ cross, angle[:, :, None]
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * square
    shift = (angle * np.eye(3) + (1 - np.cos(angle)) * cross + (angle - np.sin(angle)) * square) @ slide[:, :, None]
    return (rotation @ position.astype(np.float64)[:, :, None] + shift)[:, :, 0], turn, size


def _hexplane(weights: Weights, position: np.ndarray, t: float) -> np.ndarray:
    """The features [N, W] of places at a time."""
    high, low = weights["grid.aabb"].astype(np.float64)  # in this order
    place = 2 * (position.astype(np.float64) - high) / (low - high) - 1
    place = np.concatenate([place, np.full((len(place), 1), float(t))], 1)
    found, scale = [], 0
    while f"grid.grids.{scale}.0" in weights:
        product: float | np.ndarray = 1.0
        for k, (i, j) in enumerate(PLANES):
            product = product * _sampled(weights[f"grid.grids.{scale}.{k}"], place[:, i], place[:, j])
        found.append(product)
        scale += 1
    h = _linear(weights, "feature_out.0", np.concatenate(found, 1).astype(np.float32))
    layer = 2
    while f"feature_out.{layer}.weight" in weights:
        h = _linear(weights, f"feature_out.{layer}", _relu(h))
        layer += 2
    return h


def _sampled(plane: np.ndarray, across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Values [N, C] of a plane [1, C, H, W] at -1..1 across W and along H: bilinear, the corners at the outermost values, held outside."""
    values = plane[0].transpose(1, 2, 0)
    rows, columns = values.shape[:2]

    def cell(x: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = np.clip(np.nan_to_num((x + 1) / 2 * (count - 1)), 0, count - 1)
        first = np.minimum(x.astype(int), max(count - 2, 0))
        return first, np.minimum(first + 1, count - 1), (x - first)[:, None]

    x0, x1, u = cell(across, columns)
    y0, y1, v = cell(along, rows)
    return (values[y0, x0] * (1 - u) + values[y0, x1] * u) * (1 - v) + (values[y1, x0] * (1 - u) + values[y1, x1] * u) * v


def _kept(weights: Weights, hidden: np.ndarray, position: np.ndarray) -> np.ndarray:
    """The share [N, 1] of a Gaussian's own values to which changes are added: 1, a head's, or that of a grid of voxels."""
    if "static_mlp.1.weight" in weights:
        return _head(weights, "static_mlp", hidden)
    if "empty_voxel.grid" not in weights:
        return np.ones((len(position), 1))
    grid = weights["empty_voxel.grid"][0, 0]
    low, high = (weights[f"empty_voxel.xyz_{end}"].astype(np.float64).reshape(3) for end in ("min", "max"))
    place = np.nan_to_num((position - low) / (high - low), posinf=1e6, neginf=-1e6) * (np.array(grid.shape) - 1)
    place = np.clip(place, -2, np.array(grid.shape) + 1)  # everything out there is 0
    first, out = np.floor(place).astype(int), np.zeros(len(place))
    for corner in np.ndindex(2, 2, 2):
        at = first + corner
        inside = ((at >= 0) & (at < grid.shape)).all(1)
        weight = np.prod(np.where(corner, place - first, 1 - (place - first)), 1)
        out[inside] += weight[inside] * grid[tuple(at[inside].T)]
    return out[:, None]


def _head(weights: Weights, name: str, hidden: np.ndarray) -> np.ndarray:
    return _linear(weights, f"{name}.3", _relu(_linear(weights, f"{name}.1", _relu(hidden))))
