# SPDX-License-Identifier: GPL-3.0-or-later
"""The losses against plain float64 torch."""
from __future__ import annotations

import numpy as np
import pytest
import torch

import fastgs_blender as fg
from fastgs_blender.kernels.cpu import loss
from fastgs_blender.kernels.cpu.steps import motion_penalty
from fastgs_blender.kernels.protocol import ForwardPass
from fastgs_blender.training.core import losses
from fastgs_blender.util import threads
from fastgs_blender.util.backends import load_backend


def blurred(image):
    """[h, w, 3] under SSIM's window, as 3DGS does it: a 2D convolution with zeros beyond the border."""
    line = torch.exp(-torch.arange(-5, 6, dtype=torch.float64) ** 2 / 4.5)
    window = line[:, None] * line / line.sum() ** 2
    return torch.conv2d(image.permute(2, 0, 1)[None], window.expand(3, 1, 11, 11), padding=5, groups=3)[0].permute(1, 2, 0)


def plain(image, target, weight, dssim):
    """(loss, l1, ssim) of float64 tensors."""
    weight = torch.ones_like(image[..., :1]) if weight is None else weight[..., None]
    x = target + weight.clamp(max=1) * (image - target)
    mx, my = blurred(x), blurred(target)
    xx, yy, xy = blurred(x * x) - mx**2, blurred(target**2) - my**2, blurred(x * target) - mx * my
    ssim = (2 * mx * my + 1e-4) * (2 * xy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (xx + yy + 9e-4))
    l1, dissimilar = (weight * (image - target).abs()).mean(), (weight * (1 - ssim)).mean()
    return (1 - dssim) * l1 + dssim * dissimilar, l1, 1 - dissimilar


def pictures(rng, height, width, weighted):
    image, target = rng.uniform(0, 1, (2, height, width, 3)).astype(np.float32)
    target[:, : width // 3] = image[:, : width // 3]
    weight = rng.uniform(0, 2, (height, width)).astype(np.float32) * (rng.uniform(size=(height, width)) < 0.7)
    return image, target, weight.astype(np.float32) if weighted else None


@pytest.mark.parametrize("weighted", [False, True], ids=["plain", "weighted"])
@pytest.mark.parametrize("size", [(40, 57), (150, 24), (7, 3), (3, 2), (11, 1)])
@pytest.mark.parametrize("dssim", [0.0, 0.2, 1.0])
def test_photometric_loss(rng, size, weighted, dssim):
    arrays = pictures(rng, *size, weighted)
    value, ours, l1, ssim = loss.photometric(*arrays, dssim)
    exact = [None if a is None else torch.tensor(a, dtype=torch.float64) for a in arrays]
    expected = plain(exact[0].requires_grad_(), *exact[1:], dssim)
    expected[0].backward()
    np.testing.assert_allclose([value, l1, ssim], [e.item() for e in expected], rtol=1e-6, atol=1e-7)
    gradient = exact[0].grad.numpy()
    assert np.abs(ours - gradient).max() <= 2e-6 * np.abs(gradient).max()


@pytest.mark.parametrize(("background", "opaque_weight", "share"), [(None, 0.0, 1.0), (None, 0.3, 0.5), ((0.2, 0.9, 0.4), 0.0, 1 / 3),
                                                                     ((0.2, 0.9, 0.4), 0.3, 0.5)])
def test_the_loss_of_a_picture_over_a_background(rng, background, opaque_weight, share):
    """And of what it leaves transparent where the target is opaque."""
    rgb, target, weight = pictures(rng, 20, 31, True)
    alpha = rng.uniform(0, 1, (20, 31)).astype(np.float32)
    ground = None if background is None else np.array(background, np.float32)
    got = load_backend("cpu").compare(ForwardPass(rgb, alpha, None, None), target, weight, ground, 0.2, opaque_weight, share)
    tensors = [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (rgb, alpha)]
    shown = tensors[0] if ground is None else tensors[0] + (1 - tensors[1])[..., None] * torch.tensor(ground, dtype=torch.float64)
    value, l1, ssim = plain(shown, torch.tensor(target, dtype=torch.float64), torch.tensor(weight, dtype=torch.float64), 0.2)
    value = value + opaque_weight * (1 - tensors[1]).mean()
    error = ((shown - torch.tensor(target)) ** 2).mean()
    np.testing.assert_allclose(got.values, [v.item() for v in (value, l1, ssim, error)], rtol=1e-5)
    difference = (weight[..., None] * np.abs(shown.detach().numpy() - target)).mean(2)
    np.testing.assert_allclose(got.emphasis**2, difference / l1.item(), rtol=1e-4, atol=1e-6)
    (share * value).backward()
    assert np.abs(got.rgb - tensors[0].grad.numpy()).max() <= 2e-6 * np.abs(tensors[0].grad.numpy()).max()
    by_alpha = np.zeros_like(alpha) if tensors[1].grad is None else tensors[1].grad.numpy()
    assert np.abs((0 if got.alpha is None else got.alpha) - by_alpha).max() <= 2e-6 * np.abs(by_alpha).max()


def test_equal_pictures_lose_nothing(rng):
    image = rng.uniform(0, 1, (20, 30, 3)).astype(np.float32)
    value, gradient, l1, ssim = loss.photometric(image, image)
    assert value == pytest.approx(0, abs=1e-7) and l1 == 0 and ssim == pytest.approx(1, abs=1e-6)
    assert np.abs(gradient).max() < 1e-7


def test_what_does_not_count_does_not_show(rng):
    image, target, _ = pictures(rng, 30, 40, False)
    weight = np.ones((30, 40), np.float32)
    weight[:, 20:] = 0
    before = loss.photometric(image, target, weight)
    image[:, 20:] = rng.uniform(0, 1, (30, 20, 3))
    after = loss.photometric(image, target, weight)
    assert before[0] == after[0] and np.array_equal(before[1], after[1]) and not after[1][:, 20:].any()


def test_the_number_of_threads_changes_no_byte(rng, monkeypatch):
    image, target, weight = pictures(rng, 90, 31, True)
    results = []
    try:
        for count, rows in ((1, 64), (2, 64), (3, 7)):
            monkeypatch.setattr(loss, "ROWS", rows)
            threads.set_threads(count)
            value, gradient, *rest = loss.photometric(image, target, weight)
            square, roots = loss.errors(image, target, weight, 1.0)
            results.append((value, gradient.tobytes(), *rest, square, roots.tobytes()))
    finally:
        threads.set_threads(0)
    assert results[0] == results[1] == results[2]


BASES = {"paper": fg.Fourier(3), "linear": fg.Fourier(2, scale=0.5, linear=True), "cosine": fg.Cosine(5, scale=0.9),
         "cubic": fg.Polynomial(3), "keys": fg.Keyframes((0.0, 0.2, 0.3, 1.0)), "two keys": fg.Keyframes((0.0, 1.0)),
         "static": fg.Static()}


def smooth(x, width):
    return torch.where(x.abs() < width, x**2 / (2 * width), x.abs() - width / 2)


def written_out(motion, basis, extent, reading):
    """L_M-reg from its terms [N, R, 3] and their weights [R]."""
    terms, weights = motion / extent, None
    if isinstance(basis, fg.Fourier):
        weights = [(basis.scale * i) ** 2 for i in range(1, basis.order + 1) for _ in "sc"] + [0.0] * basis.linear
    elif isinstance(basis, fg.Cosine):
        weights = [(basis.scale * k / 2) ** 2 for k in range(1, basis.order + 1)]
    elif isinstance(basis, fg.Polynomial):
        weights = [k * (k - 1) / (2 * np.pi) ** 2 for k in range(1, basis.degree + 1)]
    elif isinstance(basis, fg.Keyframes):
        t = torch.tensor(basis.times, dtype=torch.float64)
        speed = (terms[:, 1:] - terms[:, :-1]) / (t[1:] - t[:-1])[:, None]
        terms = (speed[:, 1:] - speed[:, :-1]) / (2 * np.pi) ** 2 / (t[-1] - t[0])
        weights = [1.0] * terms.shape[1]
    else:
        weights = []
    weights = torch.tensor(weights, dtype=torch.float64)
    if reading == "mean":
        return (smooth(terms, losses.SMOOTH).sum(2) @ weights).mean()
    return ((torch.sqrt((terms**2).mean(0) + losses.SMOOTH**2) - losses.SMOOTH).sum(1) * weights).sum()


@pytest.mark.parametrize("reading", ["mean", "group"])
@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_motion_penalty(rng, basis, reading):
    extent = 3.0
    motion = torch.tensor(extent * rng.normal(0, 10.0 ** rng.uniform(-5, -1, (40, basis.terms, 3))), dtype=torch.float32)
    gradient = np.zeros(motion.shape, np.float32)
    ours = motion_penalty(losses.motion_norm(basis, extent, reading), motion.numpy(), gradient, 3.0, np.ones(40, np.float32))[0]
    exact = motion.double().requires_grad_()
    theirs = written_out(exact, basis, extent, reading)
    if not theirs.requires_grad or not theirs.item():
        assert ours == 0 and not gradient.any()
        return
    (3 * theirs).backward()
    assert ours == pytest.approx(theirs.item(), rel=1e-5)
    assert np.abs(gradient - exact.grad.numpy()).max() <= 1e-5 * exact.grad.abs().max().item()


def test_the_printed_penalty_has_neither_the_number_of_gaussians_nor_a_unit_of_length(rng):
    """Eq. 8: the sum over i and axes of i^2 (||w_sin|| + ||w_cos||), norms over all Gaussians."""
    motion = rng.normal(0, 1, (40, 4, 3)).astype(np.float32)
    norm = losses.motion_norm(fg.Fourier(2), 7.0, "printed")
    gradient = np.zeros_like(motion)
    factor = losses.motion_factor("printed", 40)
    value = factor * motion_penalty(norm, motion, gradient, 0.1 * factor, np.ones(40, np.float32))[0]
    columns, squared = np.linalg.norm(motion, axis=0), np.array([1, 1, 4, 4])[:, None]
    assert value == pytest.approx((squared * columns).sum(), rel=1e-3)
    np.testing.assert_allclose(gradient, 0.1 * squared * motion / columns, rtol=1e-3, atol=1e-7)
    assert losses.motion_factor("group", 40) == losses.motion_factor("mean", 40) == 1


def test_curvature_is_the_greatest_acceleration():
    """Of each term on its own, in units of (2 pi)^2, whatever the basis."""
    t = np.linspace(0, 1, 2001)
    for basis in (fg.Fourier(4), fg.Fourier(2, linear=True), fg.Cosine(6), fg.Polynomial(4)):
        second = np.gradient(basis.rates(t), t, axis=0)[1:-1]
        np.testing.assert_allclose(np.diag(basis.curvature()), np.abs(second).max(0) / (2 * np.pi) ** 2, rtol=2e-2, atol=1e-9)
    keys = fg.Keyframes(tuple(np.linspace(0, 1, 51)))
    assert np.abs(keys.curvature() @ np.asarray(keys.times)).max() < 1e-12  # straight motion is free
    swing = np.sin(2 * np.pi * np.asarray(keys.times))
    assert np.abs(keys.curvature() @ swing).sum() == pytest.approx(2 / np.pi, rel=2e-2)  # the mean of |sin|


def test_rows_that_move_seldom_are_pulled_as_much(rng):
    motion = rng.normal(0, 0.1, (30, 6, 3)).astype(np.float32)
    for basis in (fg.Fourier(3), fg.Keyframes((0.0, 0.2, 0.3, 0.5, 0.7, 1.0))):
        for reading in losses.READINGS:
            norm = losses.motion_norm(basis, 2.0, reading)
            whole, part = np.zeros_like(motion), np.ones_like(motion)
            times = np.zeros(30, np.float32)
            times[::3] = 4
            every = np.ones(30, np.float32)
            assert motion_penalty(norm, motion, whole, 1.0, every) == motion_penalty(norm, motion, part, 0.5, times)
            np.testing.assert_allclose(part[::3] - 1, 2 * whole[::3], rtol=1e-4, atol=1e-6)
            assert np.all(part[1::3] == 1) and np.all(part[2::3] == 1)
