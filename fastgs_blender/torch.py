# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that torch can differentiate, for research with torch: a backend's forward and backward passes as an autograd function.

    from fastgs_blender.torch import render, tensors
    parameters = tensors(model)
    picture = render(parameters, model, camera, t=0.25)
    loss = (picture.rgb - target).abs().mean()
    loss.backward()

Nothing else in the library imports this module; training does without torch.  docs/torch.md has an example.
"""
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any

import numpy as np
import torch

from .cameras.camera import Camera
from .kernels.parameters import DECODER
from .kernels.protocol import DeviceError, ScreenStatistics
from .model.appearance import RGB, SH_C0, Features, momentary
from .model.gaussians import GaussianModel
from .model.slicing import quaternions_at, slice_model
from .rendering.instances import AS_TRAINED, Instance
from .rendering.oracle import colours, decode_features
from .util import rotations
from .util.backends import load_backend
from .util.errors import FastGSError

NUDGE = 1e-4
"""Radians, and shares of the distance to the model, by which a camera is moved to see how colours depend on where it stands."""


@dataclass(frozen=True, eq=False)
class Rendered:
    """A differentiable picture: rgb [h, w, 3] premultiplied, alpha [h, w], depth [h, w] premultiplied (sum of w z) or None."""

    rgb: torch.Tensor
    alpha: torch.Tensor
    depth: torch.Tensor | None


def tensors(model: GaussianModel) -> dict[str, torch.Tensor]:
    """A model's arrays as render() takes them, its decoder's among them: float32 tensors that require gradients, and are copies."""
    arrays = model.arrays | {name: getattr(model.appearance, name) for name in DECODER if isinstance(model.appearance, Features)}
    return {name: torch.tensor(np.asarray(array, np.float32)).requires_grad_() for name, array in arrays.items()}


def render(parameters: dict[str, torch.Tensor], template: GaussianModel, camera: Camera, t: float, depth: bool = False,
           pose: torch.Tensor | None = None, statistics: ScreenStatistics | None = None, detach_time: bool = False, band: float = 0.0,
           backend: str = "cpu") -> Rendered:
    """What training sees of a model: fastgs_blender.render()'s picture, but for the fading of what is seen from far off, differentiable by
    the parameters and by the pose.

    parameters   float32 tensors: all of GaussianModel.arrays, and w1 [6, 12], w2 [3, 6] of a decoder; see tensors().  On the CPU their
                 memory is read in place and must not change before the backward pass
    template     a model of the same kinds; its arrays are ignored
    pose         [6], a small motion after camera.world_to_camera: a rotation vector in radians about the camera's axes, and a shift along
                 them in units of the world; None: none.  world_to_camera [3, 4] must be a rotation and a shift
    statistics   filled by the backward pass (training.core.statistics.Statistics)
    detach_time  mu_tau's gradient comes through the temporal opacity alone, as STG trains
    band         alpha fades in over this width above the cut: for checks of the gradients
    backend      "cpu", "gpu" or "gpu:PART-OF-A-NAME"

    Raises FastGSError where the backend's device fails.
    """
    call = template, camera, float(t), depth, float(band), backend
    rgb, alpha, deep = _Picture.apply(tuple(parameters), call, statistics, detach_time, pose, *parameters.values())
    return Rendered(rgb, alpha, deep if depth else None)


def moved(camera: Camera, pose: np.ndarray | torch.Tensor) -> Camera:
    """The camera after a pose of render()."""
    twist = np.asarray(pose.detach().cpu().numpy() if isinstance(pose, torch.Tensor) else pose, np.float64)
    motion = rotations.transform(rotations.to_matrices(rotations.exp(twist[:3] / 2)), twist[3:])
    return replace(camera, world_to_camera=motion @ camera.world_to_camera)


class _Picture(torch.autograd.Function):
    """The pose [6] and the parameters -> rgb [h, w, 3], alpha [h, w], depth [h, w] (or empty)."""

    @staticmethod
    def forward(ctx: Any, names: Sequence[str], call: Any, statistics: Any, detach_time: bool, pose: Any, *values: Any) -> tuple[Any, ...]:
        template, camera, t, depth, band, name = call
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*values)
        ctx.backend, ctx.names, ctx.statistics, ctx.detach_time, ctx.pose = load_backend(name), names, statistics, detach_time, pose
        ctx.view = template, camera if pose is None else moved(camera, pose), t
        with _device_errors():
            parameters = {name: ctx.backend.array(value.detach().cpu().numpy()) for name, value in zip(names, values)}
            ctx.picture = ctx.backend.forward(parameters, *ctx.view, depth, band)
            made = [ctx.picture.rgb, ctx.picture.alpha, *([] if ctx.picture.depth is None else [ctx.picture.depth])]
            found = [np.array(ctx.backend.numpy(array)) for array in made]
        found += [np.empty(0, np.float32)] * (3 - len(found))
        return tuple(torch.from_numpy(array).to(values[0].device) for array in found)

    @staticmethod
    def backward(ctx: Any, rgb: Any, alpha: Any, depth: Any) -> tuple[Any, ...]:
        values = ctx.saved_tensors  # raises where a parameter was changed since
        slopes = [None if grad is None else np.ascontiguousarray(grad.detach().cpu().numpy(), np.float32) for grad in (rgb, alpha, depth)]
        if ctx.picture.depth is None:
            slopes[2] = None
        with _device_errors():
            by = ctx.backend.backward(ctx.picture, *(None if each is None else ctx.backend.array(each) for each in slopes),
                                      statistics=ctx.statistics, detach_time=ctx.detach_time)
            found = {name: np.array(ctx.backend.numpy(by[name])) for name in ctx.names}
        by_pose = None
        if ctx.needs_input_grad[4]:
            slope = pose_slope(ctx, dict(zip(ctx.names, values)), found, slopes[0])
            by_pose = torch.from_numpy(slope).to(ctx.pose)
        return None, None, None, None, by_pose, *(torch.from_numpy(found[name]).to(value.device) if needed else None for name, value, needed
                                                  in zip(ctx.names, values, ctx.needs_input_grad[5:]))


def pose_slope(ctx: Any, values: dict[str, torch.Tensor], by: dict[str, np.ndarray], by_rgb: np.ndarray | None) -> np.ndarray:
    """d loss / d pose [6] float64.

    To move the camera is to move all Gaussians the other way, so the gradients of their positions and rotations say how the loss changes;
    only the colours then have to be looked at from where the camera really stands, by central differences.
    by      gradients of the parameters
    by_rgb  d loss / d rgb
    """
    template, camera, t = ctx.view
    arrays = {name: value.detach().cpu().numpy() for name, value in values.items()}
    appearance = template.appearance
    if isinstance(appearance, Features):
        appearance = replace(appearance, **{name: arrays[name] for name in DECODER})
    model = replace(template, appearance=appearance, **{name: arrays[name] for name in template.arrays})
    now = slice_model(model, t, cull=False)
    quaternions = quaternions_at(model, t)
    to_world = camera.world_to_camera[:3, :3].T
    shift = ctx.pose.detach().cpu().numpy().astype(np.float64)[3:]
    pivot = to_world @ (shift - camera.world_to_camera[:3, 3])  # the point about which the rotation vector turns
    g_position, g_rotation = by["position"].astype(np.float64), by["rotation"].astype(np.float64)
    slope, steps = np.zeros(6), np.eye(6)
    for k in range(6):
        axis, along = to_world @ steps[k, :3], to_world @ steps[k, 3:]
        steady = np.cross(axis, now.position - pivot) + along
        spin = 0.5 * rotations.multiply(np.broadcast_to([0.0, *axis], quaternions.shape), quaternions)
        slope[k] = (g_position * steady).sum() + (g_rotation * spin).sum()

        def colour(step: float, k: int = k, steady: Any = steady) -> float:
            eye = replace(camera, world_to_camera=_left(step * steps[k], shift) @ camera.world_to_camera)
            instance = Instance(model, np.eye(4), t, AS_TRAINED).viewed(eye)
            if isinstance(appearance, Features):
                weight = np.asarray(ctx.backend.numpy(ctx.picture.alpha), np.float64)
                features = np.asarray(ctx.backend.numpy(ctx.picture.features), np.float64)
                return (decode_features(features, weight, instance, eye, appearance.decode) * by_rgb).sum()
            seen = colours(replace(now, position=now.position - step * steady), instance, eye)
            return (seen * by["features"][:, :3].astype(np.float64) / SH_C0).sum()

        if by_rgb is not None and not isinstance(momentary(appearance), RGB):
            reach = NUDGE * (1.0 if k < 3 else max(float(np.abs(now.position - pivot).mean()), 1e-6))
            slope[k] += (colour(reach) - colour(-reach)) / (2 * reach)
    slope[:3] = slope[:3] @ _left_jacobian(ctx.pose.detach().cpu().numpy().astype(np.float64)[:3])
    return slope


def _left(twist: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    """The motion [4, 4] that turns about a point of the camera's space, and shifts."""
    turn = rotations.to_matrices(rotations.exp(twist[:3] / 2))
    return rotations.transform(turn, twist[3:] + pivot - turn @ pivot)


def _left_jacobian(vector: np.ndarray) -> np.ndarray:
    """The left Jacobian [3, 3] of SO(3): to add d to a rotation vector is to turn by J d after it."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if angle < 1e-4:
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross


class _device_errors:
    """Context manager in which a device's failure becomes a FastGSError."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if isinstance(error, DeviceError):
            raise FastGSError(f"the GPU fails ({error}); use the backend cpu, or a smaller picture.") from error
