# SPDX-License-Identifier: GPL-3.0-or-later
"""Backward of the rasteriser against a dense float64 compositing differentiated by torch."""
from __future__ import annotations

import numpy as np
import pytest
import torch

import fastgs_blender as fg
from fastgs_blender.kernels.cpu import raster
from fastgs_blender.kernels.cpu import rasterise as cpu
from fastgs_blender.rendering.oracle import T_STOP
from fastgs_blender.util import threads

CUT = 1 / 255
CAMERA = fg.Camera(53, 37, 40, 40, 26, 18, np.eye(4))
WINDOWED = fg.Camera(53, 37, 40, 40, 26, 18, np.eye(4), window=(7, 5, 30, 21))
"""Its window begins and ends within tiles."""


def splats(rng, count, camera=CAMERA, opacity=(0.02, 0.95), size=(1.0, 7.0), channels=3, alpha_max=0.99):
    """Random splats over and around a camera's image, some rows left out of the order: order, geometry, attributes."""
    rows = count + 3
    geometry, attributes = np.full((rows, 5), np.nan), np.full((rows, raster.CHANNEL + channels), np.nan, np.float32)
    order = rng.permutation(rows)[:count].astype(np.int32)
    angle, sizes = rng.uniform(0, np.pi, count), rng.uniform(*size, (count, 2))
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(-1, 2, 2)
    covariance = turn @ (sizes[:, :, None] ** 2 * turn.transpose(0, 2, 1)) + 0.3 * np.eye(2)
    s00, s01, s11 = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    root, det = np.sqrt(s11), s00 * s11 - s01**2
    scale = np.sqrt(0.5 * np.log2(np.e))
    geometry[order] = np.stack([rng.uniform(-4, camera.width + 4, count), rng.uniform(-4, camera.height + 4, count),
                                scale * root / np.sqrt(det), -scale * s01 / (root * np.sqrt(det)), scale / root], 1)
    sigma = rng.uniform(*opacity, count)
    reach = 2 * np.log(np.maximum(sigma / CUT, 1))
    attributes[order] = np.concatenate([
        np.stack([np.log2(sigma), np.full(count, alpha_max), np.full(count, np.log2(CUT)), np.arange(count),
                  np.sqrt(reach * s00) + 1e-3, np.sqrt(reach * s11) + 1e-3], 1), rng.uniform(-0.3, 1, (count, channels))], 1)
    return order, geometry, attributes


def dense(order, geometry, attributes, camera, band):
    """The picture [h, w, C + 1] (alpha last) as a function of float64 tensors, and those: geometry and opacity [M, 6], channels [M, C].

    Plain compositing over all pixels; d mean_x and d mean_y of every splat and pixel come from shifts [M, 2, h, w], all zero.
    """
    x0, y0, width, height = camera.window
    px, py = torch.arange(x0, x0 + width, dtype=torch.float64) + 0.5, (torch.arange(y0, y0 + height, dtype=torch.float64) + 0.5)[:, None]
    attributes = attributes[order].astype(np.float64)
    shape = torch.tensor(np.concatenate([geometry[order], attributes[:, :1]], 1), requires_grad=True)
    channels = torch.tensor(attributes[:, raster.CHANNEL:], requires_grad=True)
    shifts = torch.zeros(len(order), 2, height, width, dtype=torch.float64, requires_grad=True)
    out = torch.zeros(height, width, channels.shape[1] + 1, dtype=torch.float64)
    left, live = torch.ones(height, width, dtype=torch.float64), torch.ones(height, width, dtype=torch.bool)
    for i in range(len(order)):
        mx, my, a, b, c, log2_opacity = shape[i]
        dx, dy = px - mx - shifts[i, 0], py - my - shifts[i, 1]
        alpha = torch.exp2(log2_opacity - (a * dx + b * dy) ** 2 - (c * dy) ** 2)
        cut = 2.0 ** attributes[i, raster.LOG2_CUT]
        drawn = alpha.detach() >= cut * (1 - 1e-7)
        alpha = alpha.clamp(max=attributes[i, raster.ALPHA_MAX])
        if band:
            s = ((alpha - cut) / band).clamp(0, 1)
            alpha = alpha * s * s * (3 - 2 * s)
        alpha = torch.where(drawn, alpha, 0.0)
        after = left * (1 - alpha)
        blended = live & drawn & (after.detach() > T_STOP)
        live = live & (blended | ~drawn)
        weight = torch.where(blended, left * alpha, 0.0)
        out = out + weight[..., None] * torch.cat([channels[i], channels.new_ones(1)])
        left = torch.where(blended, after, left)
    return out, shape, channels, shifts


def both(rng, order, geometry, attributes, camera=CAMERA, band=0.0):
    """Gradients of a random linear function of the picture: [M, 6], [M, C], absolute [M, 2] of the kernels and of torch, in order."""
    buffers, drawn = cpu.rasterise_forward(order, geometry, attributes, attributes.shape[1] - raster.CHANNEL, camera, band)
    out, *tensors = dense(order, geometry, attributes, camera, band)
    grad = rng.normal(size=out.shape)
    assert np.abs(np.concatenate([buffers.channels, buffers.alpha[..., None]], 2) - out.detach().numpy()).max() < 2e-5
    expected = [g.numpy() for g in torch.autograd.grad(out, tensors, torch.tensor(grad))]
    error = rng.uniform(0, 3, out.shape[:2])
    got = cpu.rasterise_backward(drawn, grad[..., :-1], grad[..., -1], error)
    rest = np.setdiff1d(np.arange(len(geometry)), order)
    assert not any(np.any(getattr(got, name)[rest]) for name in ("geometry", "log2_opacity", "channels", "absolute"))
    ours = [np.concatenate([got.geometry, got.log2_opacity[:, None]], 1)[order], got.channels[order], got.absolute[order]]
    return ours, [expected[0], expected[1], (np.abs(expected[2]) * error).sum((2, 3))]


def assert_close(ours, theirs, tolerance=2e-4):
    """Each column to a tolerance relative to its typical size."""
    for a, b in zip(ours, theirs):
        size = np.sqrt((b**2).mean(0)) + np.abs(b) + 1e-9
        assert (np.abs(a - b) / size).max() < tolerance


@pytest.mark.parametrize("camera", [CAMERA, WINDOWED], ids=["whole", "window"])
@pytest.mark.parametrize("channels", [3, 4, 9])
def test_gradients_are_exact(rng, camera, channels):
    assert_close(*both(rng, *splats(rng, 60, channels=channels), camera=camera))


@pytest.mark.parametrize("case", [
    dict(count=70, opacity=(0.6, 0.99), size=(6, 20)),                  # opaque stacks: most splats lie behind the stop
    dict(count=40, opacity=(0.9, 1.0), size=(3, 9), alpha_max=0.7),     # clamped
    dict(count=60, opacity=(0.97, 1.0), size=(4, 12), alpha_max=0.999),
    dict(count=50, size=(0.05, 30)),                                    # needles
    dict(count=50, opacity=(0.003, 0.02)),                              # at the cut
    dict(count=1),
], ids=["opaque", "clamped", "solid", "needles", "faint", "one"])
def test_gradients_of_hard_cases(rng, case):
    assert_close(*both(rng, *splats(rng, **case)), 2e-3)


def test_a_smooth_cut(rng):
    for case in (dict(count=60), dict(count=50, opacity=(0.003, 0.03))):
        assert_close(*both(rng, *splats(rng, **case), band=1e-2))


def gradients(order, geometry, attributes, grad, camera=CAMERA):
    """All gradients as one list of arrays."""
    drawn = cpu.rasterise_forward(order, geometry, attributes, attributes.shape[1] - raster.CHANNEL, camera)[1]
    return list(vars(cpu.rasterise_backward(drawn, grad[..., :-1], grad[..., -1])).values())


def test_the_number_of_threads_changes_no_byte(rng, monkeypatch):
    monkeypatch.setattr(threads, "MOST", 50)
    monkeypatch.setattr(cpu, "TILES", 2)
    scene, grad = splats(rng, 700), rng.normal(size=(37, 53, 4))
    results = []
    try:
        for count in (1, 2, 5):
            threads.set_threads(count)
            results.append([g.tobytes() for g in gradients(*scene, grad)])
    finally:
        threads.set_threads(0)
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("limit", ["ENTRIES", "BACKWARD_BYTES"])
def test_pictures_in_bands(rng, monkeypatch, limit):
    scene, grad = splats(rng, 200), rng.normal(size=(37, 53, 4))
    whole = gradients(*scene, grad)
    monkeypatch.setattr(cpu, limit, 100)
    for a, b in zip(whole, gradients(*scene, grad)):
        assert np.array_equal(a, b)


def test_nothing_to_draw(rng):
    order, geometry, attributes = splats(rng, 5)
    assert not any(g.any() for g in gradients(order[:0], geometry, attributes, rng.normal(size=(37, 53, 4))))
    elsewhere = fg.Camera(53, 37, 40, 40, 26, 18, np.eye(4), window=(0, 0, 1, 1))
    geometry[order, :2] += 500
    assert not any(g.any() for g in gradients(order, geometry, attributes, rng.normal(size=(1, 1, 4)), elsewhere))


def test_a_traced_picture_is_the_picture(rng):
    order, geometry, attributes = splats(rng, 200)
    plain = cpu.rasterise(order, geometry, attributes, 3, CAMERA)
    traced, _ = cpu.rasterise_forward(order, geometry, attributes, 3, CAMERA)
    assert np.array_equal(plain.channels, traced.channels) and np.array_equal(plain.alpha, traced.alpha)
