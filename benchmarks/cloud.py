# SPDX-License-Identifier: GPL-3.0-or-later
"""The moving cloud of Gaussians that the renderer's benchmarks draw."""
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import fastgs_blender as fg


def scene(n: int, width: int, height: int, appearance: str = "rgb") -> tuple[fg.GaussianModel, fg.Camera]:
    """A cloud that fills the view: about 7 tiles a splat, opacities from faint to solid, Fourier motion, slow turning."""
    rng = np.random.default_rng(0)
    focal = 0.9 * width
    depth = rng.uniform(3, 9, n)
    x, y = rng.uniform(-0.55, 0.55, (2, n)) * depth / focal
    position = np.stack([x * width, y * height, depth], 1)
    decoder = fg.Features(rng.normal(0, 0.3, (6, 12)), rng.normal(0, 0.3, (3, 6)), "clamp")
    kinds = {"rgb": (fg.RGB(), 3), "sh": (fg.SH(3), 48), "features": (decoder, 9)}
    look, columns = kinds[appearance]
    pixels = 5.2 * (300_000 / n) ** 0.5
    model = fg.GaussianModel(
        position=position, rotation=rng.normal(size=(n, 4)), scale=np.log(pixels * depth[:, None] / focal) + rng.normal(-0.2, 0.5, (n, 3)),
        opacity=rng.normal(0, 2, n), features=rng.uniform(0, 1, (n, columns)) * 0.5,
        motion=rng.normal(0, 0.02, (n, 10, 3)), rotation_motion=rng.normal(0, 0.2, (n, 1, 4)), mu_tau=rng.uniform(0, 1, n),
        temporal=rng.normal(-2, 1, (n, 1)), basis=fg.Fourier(5), rotation_basis=fg.Polynomial(1), temporal_kind=fg.Radial(),
        appearance=look, raster=fg.Raster(alpha_max=0.999, near=0.01))
    return model, fg.Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))
