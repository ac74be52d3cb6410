# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets of training: three lengths, and two published setups.

STG is Spacetime Gaussians' full model as it was published for Neural 3D Video (github.com/oppo-us-research/SpacetimeGaussians, commit
427abfc).  PAPER is the paper as printed, and STG where it is silent.  docs/paper.md says, item by item, what still differs from both.
"""
from __future__ import annotations

from typing import Any

STG: dict[str, Any] = {
    "iterations": 30_000, "batch": 2,
    "motion": "polynomial", "order": 3, "motion_weight": 0.0,
    "activation": "sigmoid", "decode": "premultiplied", "decoder_place": True,
    "loss": "mixed", "dssim": 0.2, "opaque_weight": 0.0, "background": "black", "moving_weight": 1.0,
    "exposures": "off", "clocks": "off", "poses": "off",
    "rate_unit": "extent", "position_rate": 1.6e-4, "position_rate_end": 1.6e-6, "motion_rate": 2.8e-4, "motion_decay": 1.0,
    "rotation_rate": 1e-3, "turn_rate": 1e-4, "scale_rate": 1.5e-3, "opacity_rate": 0.05, "base_rate": 2.5e-3, "direction_rate": 2.5e-3,
    "time_rate": 1e-3, "centre_rate": 1e-4, "duration_rate": 0.03, "decoder_rate": 1e-4, "rate_decay": 1.0,
    "cool_down": 0.0,
    "backdrop": 0.0, "points": 200_000, "start_opacity": 0.1, "start_size": 1.0, "start_life": 1.0, "static_life": 1.0,
    "start_motion": False,
    "density": "default", "max_gaussians": 500_000, "densify_from": 500 / 30_000, "densify_until": 9000 / 30_000, "densify_every": 100,
    "growths": 6, "gradient": "plain", "threshold": 2e-4, "dense_size": 0.01, "grow": 100.0, "prune_opacity": 0.005, "near_size": 1e6,
    "reset_every": 3000, "copied_time": "random", "warm_up": (), "segment_frames": 50, "segment_overlap": 2,
}
PAPER: dict[str, Any] = {**STG, "motion": "paper", "order": 5, "motion_weight": 0.1, "regulariser": "printed", "loss": "sum"}

LENGTHS: dict[str, dict[str, Any]] = {
    "draft": {"iterations": 2500, "max_gaussians": 20_000, "points": 10_000, "warm_up": (0.05, 0.2), "cool_down": 0.0},
    "standard": {},
    "final": {"iterations": 30_000, "max_gaussians": 150_000, "points": 60_000},
}
KNOWN: dict[str, dict[str, Any]] = {"draft": {"iterations": 1200, "warm_up": ()}}
"""What a preset changes besides, where training begins with a model: places need not be found in small pictures."""
PRESETS: dict[str, dict[str, Any]] = {**LENGTHS, "paper": PAPER, "stg": STG}
"""What each preset changes."""
