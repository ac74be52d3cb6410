# SPDX-License-Identifier: GPL-3.0-or-later
"""A model to look at: a knotted ribbon, along which waves run, over a disc.  Made here, so that nothing has to be downloaded."""
from __future__ import annotations

import colorsys

import numpy as np

import fastgs_blender as fg

FRAMES = 40


def knot(n: int = 20_000, seed: int = 3) -> fg.GaussianModel:
    """n Gaussians in Blender's axes, within 2.2 of the origin, a clip of 40 frames at 24 fps that begins anew where it ends."""
    rng = np.random.default_rng(seed)
    disc, ribbon = _disc(rng, n // 5), _ribbon(rng, n - n // 5)
    fields = {name: np.concatenate([disc[name], ribbon[name]]) for name in ribbon}
    return fg.GaussianModel(**fields, basis=fg.Fourier(2), clip=fg.Clip(FRAMES, 24.0), axes="RFU")


def ball(n: int = 9_000, seed: int = 4) -> fg.GaussianModel:
    """A red ball, the first two thirds of the Gaussians, that rises and sinks over a disc."""
    rng = np.random.default_rng(seed)
    count = 2 * n // 3
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    motion = np.zeros((count, 4, 3))
    motion[:, 0, 2] = 0.15
    round_ = dict(position=0.6 * normal + [0, 0, 0.95], motion=motion, rotation=rng.normal(size=(count, 4)),
                  scale=np.full((count, 3), np.log(0.025)), opacity=np.full(count, 3.0),
                  features=np.array([0.75, 0.2, 0.15]) + rng.uniform(-0.03, 0.03, (count, 3)))
    disc = _disc(rng, n - count)
    fields = {name: np.concatenate([round_[name], disc[name]]) for name in disc}
    return fg.GaussianModel(**fields, basis=fg.Fourier(2), clip=fg.Clip(FRAMES, 24.0), axes="RFU")


def _ribbon(rng, n):
    along, across = rng.uniform(0, 2 * np.pi, n), rng.uniform(-1, 1, n)
    ring = 1.0 + 0.38 * np.cos(3 * along)
    centre = np.stack([ring * np.cos(2 * along), ring * np.sin(2 * along), 0.95 + 0.5 * np.sin(3 * along)], -1)
    twist = 3 * along
    outward = np.stack([np.cos(2 * along), np.sin(2 * along), np.zeros(n)], -1)
    side = np.cos(twist)[:, None] * outward + np.sin(twist)[:, None] * np.array([0, 0, 1.0])
    wave = 4 * along  # four crests, which go once around the knot's cycle in each clip
    motion = np.zeros((n, 4, 3))
    motion[:, 0], motion[:, 1] = 0.10 * np.cos(wave)[:, None] * side, -0.10 * np.sin(wave)[:, None] * side
    motion[:, 2, 2], motion[:, 3, 2] = 0.05 * np.cos(2 * wave), 0.05 * np.sin(2 * wave)
    hue = (along / (2 * np.pi) + 0.05 * across) % 1
    colour = np.array([colorsys.hsv_to_rgb(h, 0.75, 0.95 - 0.35 * abs(v) ** 3) for h, v in zip(hue, across)])
    return dict(position=centre + 0.17 * across[:, None] * side, motion=motion, rotation=rng.normal(size=(n, 4)),
                scale=np.log(rng.uniform(0.012, 0.022, (n, 3))), opacity=rng.uniform(1, 4, n), features=colour)


def _disc(rng, n):
    radius, angle = 1.9 * np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)
    ground = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, 0.0)], -1)
    dark = (np.floor(radius / 0.475) + np.floor(angle / (np.pi / 8))) % 2
    colour = np.where(dark[:, None] > 0, [0.20, 0.23, 0.30], [0.78, 0.80, 0.82])
    flat = np.tile(np.log([0.045, 0.045, 0.004]), (n, 1))
    return dict(position=ground, motion=np.zeros((n, 4, 3)), rotation=np.tile([1.0, 0, 0, 0], (n, 1)), scale=flat,
                opacity=np.full(n, 3.0), features=colour)
