# SPDX-License-Identifier: GPL-3.0-or-later
"""The measures of a picture: against plain loops, and against what scikit-image gives."""
from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from fastgs_blender import FastGSError
from fastgs_blender.evaluation import metrics

SKIMAGE_SSIM, SKIMAGE_SSIM_1, SKIMAGE_PSNR = 0.9353527954578574, 0.9346400739559485, 18.03315726073039
"""What scikit-image 0.26 says of waves(): structural_similarity(channel_axis=-1, data_range=2.0), the same with 1.0, and
peak_signal_noise_ratio(data_range=1)."""


def waves():
    """A picture and its truth, [19, 23, 3], the same on every machine."""
    y, x, c = np.mgrid[0:19, 0:23, 0:3].astype(float)
    truth = 0.5 + 0.5 * np.sin(0.7 * x + 0.3 * y * (c + 1))
    return np.clip(truth + 0.2 * np.cos(1.9 * x - 1.1 * y + c), 0, 1), truth


def ssim_by_loops(a, b, weights, data_range, sample):
    """Mean SSIM, window by window, of the windows that lie inside the pictures: Wang et al. (2004), equation 13."""
    size = len(weights)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    values = []
    for y in range(a.shape[0] - size + 1):
        for x in range(a.shape[1] - size + 1):
            for channel in range(a.shape[2]):
                p, q = (v[y:y + size, x:x + size, channel] for v in (a, b))
                mp, mq = (weights * p).sum(), (weights * q).sum()
                vp, vq = sample * (weights * (p - mp) ** 2).sum(), sample * (weights * (q - mq) ** 2).sum()
                cov = sample * (weights * (p - mp) * (q - mq)).sum()
                values.append((2 * mp * mq + c1) * (2 * cov + c2) / ((mp**2 + mq**2 + c1) * (vp + vq + c2)))
    return np.mean(values)


def gaussian_weights():
    at = np.arange(11) - 5
    weights = np.exp(-(at[:, None] ** 2 + at[None, :] ** 2) / (2 * 1.5**2))
    return weights / weights.sum()


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0, 0.5), st.integers(7, 14), st.integers(7, 14))
def test_ssim_is_what_plain_loops_say(seed, noise, height, width):
    rng = np.random.default_rng(seed)
    truth = rng.random((height, width, 3))
    picture = np.clip(truth + noise * rng.normal(size=truth.shape), 0, 1)
    uniform = np.full((7, 7), 1 / 49)
    assert metrics.dssim2(picture, truth) == pytest.approx((1 - ssim_by_loops(picture, truth, uniform, 2.0, 49 / 48)) / 2, abs=1e-12)
    assert metrics.dssim1_skimage(picture, truth) == pytest.approx((1 - ssim_by_loops(picture, truth, uniform, 1.0, 49 / 48)) / 2,
                                                                   abs=1e-12)
    # 3DGS's window reaches over the edges, where it finds zeros; its moments are not centred, which is the same while weights add up to 1
    padded = (np.pad(v, ((5, 5), (5, 5), (0, 0))) for v in (picture, truth))
    assert metrics.dssim1(picture, truth) == pytest.approx((1 - ssim_by_loops(*padded, gaussian_weights(), 1.0, 1.0)) / 2, abs=1e-12)


def test_dssim2_and_psnr_are_scikit_images():
    picture, truth = waves()
    assert metrics.dssim2(picture, truth) == pytest.approx((1 - SKIMAGE_SSIM) / 2, abs=1e-12)
    assert metrics.dssim1_skimage(picture, truth) == pytest.approx((1 - SKIMAGE_SSIM_1) / 2, abs=1e-12)
    assert metrics.psnr(picture, truth) == pytest.approx(SKIMAGE_PSNR, abs=1e-10)


def test_dssim1_is_3dgs_convolution():
    picture, truth = (torch.from_numpy(v.transpose(2, 0, 1)[None]) for v in waves())
    window = torch.from_numpy(gaussian_weights())[None, None].repeat(3, 1, 1, 1)

    def blurred(v):
        return torch.nn.functional.conv2d(v, window, padding=5, groups=3)

    ma, mb = blurred(picture), blurred(truth)
    va, vb, cov = blurred(picture**2) - ma**2, blurred(truth**2) - mb**2, blurred(picture * truth) - ma * mb
    ssim = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    assert metrics.dssim1(*waves()) == pytest.approx((1 - float(ssim.mean())) / 2, abs=1e-12)


def test_psnr_of_known_errors():
    truth = np.full((8, 9, 3), 0.4)
    assert metrics.psnr(truth + 0.1, truth) == pytest.approx(20)
    assert metrics.psnr(np.float32(truth + 0.01), np.float32(truth)) == pytest.approx(40, abs=1e-4)
    assert metrics.psnr(truth, truth) == np.inf
    assert metrics.psnr(np.full_like(truth, 7.0), np.ones_like(truth)) == np.inf, "what lies above 1 is shown as 1"


def test_foreground_alone():
    truth = np.full((6, 8, 3), 0.5)
    picture, mask = truth.copy(), np.zeros((6, 8), np.float32)
    picture[:, :4] += 0.3
    mask[:, 3:] = 1
    mask[0, 0] = 0.4
    assert metrics.psnr(picture, truth, mask) == pytest.approx(-10 * np.log10(0.09 * 6 / 30))
    assert np.isnan(metrics.psnr(picture, truth, np.zeros((6, 8))))


@given(st.integers(0, 2**32 - 1))
def test_flicker_sees_changes_and_not_errors(seed):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.2, 0.6, (2, 5, 6, 3))
    wrong = truth + rng.uniform(-0.2, 0.2, (5, 6, 3))
    assert metrics.temporal_error(wrong[1], wrong[0], truth[1], truth[0]) == pytest.approx(0, abs=1e-12)
    wrong[1] += 0.05
    assert metrics.temporal_error(wrong[1], wrong[0], truth[1], truth[0]) == pytest.approx(0.05)


def test_equal_pictures_have_no_dissimilarity():
    picture, _ = waves()
    assert metrics.dssim1(picture, picture) == pytest.approx(0, abs=1e-12)
    assert metrics.dssim2(picture, picture) == pytest.approx(0, abs=1e-12)


def test_pictures_that_cannot_be_compared():
    picture, truth = waves()
    for measure in (metrics.psnr, metrics.dssim1, metrics.dssim1_skimage, metrics.dssim2):
        with pytest.raises(FastGSError, match="compared"):
            measure(picture[:-1], truth)
    with pytest.raises(FastGSError, match="at least 7 x 7"):
        metrics.dssim2(picture[:6], truth[:6])
