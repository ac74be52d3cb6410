# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes random 4D Gaussian models of any kind for the library's tests."""
from __future__ import annotations

import numpy as np

import fastgs_blender as fg

BASES = {
    "static": fg.Static(),
    "paper": fg.Fourier(5),
    "fourier": fg.Fourier(2, scale=0.8, offset=0.1, linear=True),
    "cosine": fg.Cosine(6),
    "cubic": fg.Polynomial(3),
    "line": fg.Polynomial(1),
    "keys": fg.Keyframes((0.0, 0.25, 0.6, 1.0)),
    "smooth keys": fg.Keyframes((0.0, 0.2, 0.5, 0.9), "catmull-rom"),
}
TEMPORALS = {"always": fg.Always(), "radial": fg.Radial(), "window": fg.Window(),
             "radial-window": fg.WindowedRadial()}
APPEARANCES = ("rgb", "sh0", "sh1", "sh2", "sh3", "sh4", "sigmoid", "clamp", "none", "stg", "changing rgb", "changing sh1")
"""SH by degree, features by the decoder's activation; stg: given premultiplied sums, as Spacetime Gaussians does."""


def random_appearance(rng: np.random.Generator, name: str) -> fg.RGB | fg.SH | fg.Features:
    """The appearance of a name in APPEARANCES; decoders get random weights."""
    if name == "rgb":
        return fg.RGB()
    if name.startswith("changing"):
        return fg.Changing(random_appearance(rng, name.split()[1]), BASES["fourier" if name.endswith("rgb") else "cubic"])
    if name.startswith("sh"):
        return fg.SH(int(name[2:]))
    weights = rng.normal(0, 0.5, (6, 12)), rng.normal(0, 0.5, (3, 6))
    return fg.Features(*weights, "sigmoid", "premultiplied") if name == "stg" else fg.Features(*weights, name)


def random_model(rng: np.random.Generator, n: int = 40, basis="static", rotation_basis="static", temporal="always", appearance="rgb",
                 extent: float = 1.0, size: float = 0.1, motion: float = 0.3, **fields) -> fg.GaussianModel:
    """A random model of n Gaussians.

    basis, rotation_basis, temporal and appearance are objects or names in the tables above.  extent is the half edge of
    the cube that holds them, size the median standard deviation and motion the size of the motion, both in units of
    extent.  fields go to GaussianModel: clip, axes, raster, or arrays that replace the random ones.
    """
    basis, rotation_basis = BASES.get(basis, basis), BASES.get(rotation_basis, rotation_basis)
    temporal = TEMPORALS.get(temporal, temporal)
    if isinstance(appearance, str):
        appearance = random_appearance(rng, appearance)
    begin = rng.uniform(-0.2, 0.7, n)
    parameters = {"always": np.zeros((n, 0)), "radial": rng.normal(2, 1.5, (n, 1)),
                  "window": np.stack([begin, begin + rng.uniform(0.05, 0.6, n), *rng.normal(-3, 0.7, (2, n))], -1)}
    parameters["radial-window"] = np.stack([rng.normal(2, 1.5, n), begin, begin + 0.4, rng.normal(-3, 0.7, n)], -1)
    if isinstance(appearance, fg.RGB):
        features = rng.uniform(0, 1, (n, 3))
    elif isinstance(appearance, fg.SH):
        features = rng.normal(0, 0.3, (n, appearance.width))
        features[:, :3] = rng.normal(0, 1.0, (n, 3))
    elif isinstance(appearance, fg.Changing):
        features = rng.normal(0.3, 0.3, (n, appearance.width))
    else:
        features = rng.normal(0.3, 0.5, (n, 9))
    arrays = {
        "position": rng.uniform(-extent, extent, (n, 3)),
        "rotation": rng.normal(size=(n, 4)),
        "scale": np.log(size * extent) + rng.normal(0, 0.6, (n, 3)),
        "opacity": rng.normal(0.5, 2, n),
        "features": features,
        "motion": rng.normal(0, motion * extent, (n, basis.terms, 3)) / np.arange(1, basis.terms + 1)[:, None],
        "rotation_motion": rng.normal(0, 0.3, (n, rotation_basis.terms, 4)),
        "mu_tau": rng.uniform(0, 1, n),
        "temporal": parameters[temporal.name],
    }
    kinds = dict(basis=basis, rotation_basis=rotation_basis, temporal_kind=temporal, appearance=appearance)
    return fg.GaussianModel(**{**arrays, **kinds, **fields})
