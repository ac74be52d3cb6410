# SPDX-License-Identifier: GPL-3.0-or-later
"""fastgs_blender.torch: gradients of arrays and of a camera's pose by torch's own check, and poses that are found."""
from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from random_cameras import random_pose
from random_models import random_model

import fastgs_blender as fg
import fastgs_blender.torch as ours
from fastgs_blender.kernels.cpu.backend import CPU
from fastgs_blender.kernels.protocol import DeviceError
from fastgs_blender.rendering.instances import AS_TRAINED, Instance
from fastgs_blender.rendering.layout import Layout
from fastgs_blender.rendering.oracle import BACKEND as ORACLE
from fastgs_blender.util import backends

T, BAND = 0.37, 0.02


def model_and_camera(seed: int, appearance: str, orthographic: bool = False):
    """A few large, overlapping, moving and turning Gaussians before a small camera."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, 6, "cubic", "line", "radial", appearance, extent=0.6, size=0.5, opacity=rng.uniform(-0.5, 1.0, 6),
                         mu_tau=T + rng.uniform(-0.3, 0.3, 6))
    focal = (8.0, 7.0) if orthographic else (20.0, 22.0)
    return model, fg.Camera(22, 18, *focal, 10.3, 9.6, random_pose(rng, 2.5), orthographic=orthographic)


def loss_of(weights):
    """A random linear function of a picture's colour [h, w, 3] and alpha."""
    return lambda rgb, alpha: (rgb * weights[..., :3]).sum() + (alpha * weights[..., 3]).sum()


@pytest.mark.parametrize(("appearance", "orthographic", "begin"), [
    ("rgb", False, 0.0), ("sh2", False, 0.0), ("sh1", True, 0.0), ("sigmoid", False, 0.0), ("sigmoid", False, 0.3)])
def test_the_gradient_of_the_pose_is_the_oracles(appearance, orthographic, begin):
    """Against differences of the reference in float64; from a pose that turns by `begin` radians, too."""
    model, camera = model_and_camera(3, appearance, orthographic)
    weights = np.random.default_rng(1).normal(size=(18, 22, 4))
    loss, at = loss_of(weights), np.array([begin, -0.5 * begin, 0.2 * begin, 0.1, 0.05, -0.1])

    def value(pose):
        eye = ours.moved(camera, pose)
        instance = Instance(model, np.eye(4), T, AS_TRAINED).viewed(eye)
        layout = Layout([instance], False)
        out = ORACLE.draw([instance], eye, layout, (), lambda fraction: None, band=BAND)
        return loss(ORACLE.colour(out, layout, eye), out.alpha)

    wanted = np.array([(value(at + 1e-6 * step) - value(at - 1e-6 * step)) / 2e-6 for step in np.eye(6)])
    pose = torch.tensor(at, requires_grad=True)
    picture = ours.render(ours.tensors(model), model, camera, T, pose=pose, band=BAND)
    loss_of(torch.from_numpy(weights))(picture.rgb.double(), picture.alpha.double()).backward()
    assert (np.abs(wanted[:5]) > 1e-3).all()  # an orthographic camera may be moved along its axis
    np.testing.assert_allclose(pose.grad.numpy(), wanted, rtol=1e-3, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.parametrize("appearance", ["rgb", "sigmoid"])
def test_the_gradient_of_the_pose_passes_gradcheck(appearance):
    """Of one number of the picture, since single pixels' differences leave too few digits in float32."""
    model, camera = model_and_camera(3, appearance)
    parameters = {name: tensor.detach() for name, tensor in ours.tensors(model).items()}
    loss = loss_of(torch.from_numpy(np.random.default_rng(1).normal(size=(18, 22, 4))))

    def value(pose):
        picture = ours.render(parameters, model, camera, T, pose=pose, band=BAND)
        return loss(picture.rgb.double(), picture.alpha.double())

    pose = torch.tensor([0.02, -0.01, 0.03, 0.1, 0.05, -0.1], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(value, (pose,), eps=1e-3, atol=5e-2, rtol=1e-2)


def test_the_gradients_of_arrays_pass_gradcheck():
    model, camera = model_and_camera(5, "rgb")
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=(18, 22, 3)))
    rest = {name: tensor.detach() for name, tensor in ours.tensors(model).items()}

    def value(position, opacity):
        chosen = {"position": position.float(), "opacity": opacity.float()}
        return (ours.render(rest | chosen, model, camera, T, band=BAND).rgb.double() * weights).sum()

    inputs = tuple(rest[name].double().requires_grad_() for name in ("position", "opacity"))
    assert torch.autograd.gradcheck(value, inputs, eps=1e-3, atol=5e-2, rtol=1e-2)


def test_a_pose_is_found():
    model, camera = model_and_camera(7, "sh1")
    parameters = {name: tensor.detach() for name, tensor in ours.tensors(model).items()}
    target = ours.render(parameters, model, camera, T).rgb
    start = ours.moved(camera, [0.05, -0.04, 0.06, 0.05, -0.06, 0.08])
    pose = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([pose], lr=1e-2)
    losses = []
    for step in range(120):
        optimiser.param_groups[0]["lr"] = 1e-2 * 0.97**step
        optimiser.zero_grad()
        loss = (ours.render(parameters, model, start, T, pose=pose).rgb - target).square().mean()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    off = np.abs(ours.moved(start, pose).world_to_camera - camera.world_to_camera).max()
    assert losses[-1] < 1e-2 * losses[0] and off < 0.03, (losses[0], losses[-1], off)


def test_a_device_that_fails_is_a_sentence(monkeypatch):
    model, camera = model_and_camera(3, "rgb")

    class Lost(CPU):
        def forward(self, *given):
            raise DeviceError("it is lost")

    monkeypatch.setitem(backends.loaded, "lost", Lost())
    with pytest.raises(fg.FastGSError, match="GPU.*it is lost.*cpu"):
        ours.render(ours.tensors(model), model, camera, T, backend="lost")


def test_a_pose_of_zeros_changes_nothing():
    model, camera = model_and_camera(3, "rgb")
    parameters = {name: tensor.detach() for name, tensor in ours.tensors(model).items()}
    plain, posed = (ours.render(parameters, model, camera, T, pose=pose).rgb for pose in (None, torch.zeros(6)))
    assert torch.equal(plain, posed)
    turned = ours.moved(camera, [0, 0, 0.2, 0, 0, 0])
    assert np.abs(replace(turned, world_to_camera=camera.world_to_camera).world_to_camera - turned.world_to_camera).max() > 0.05


def test_our_module_hides_not_the_package():
    assert sys.modules["torch"] is torch is not ours and Path(torch.__file__).name == "__init__.py"
