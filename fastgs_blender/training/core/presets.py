# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets of training: three lengths, and two published setups.

STG is Spacetime Gaussians' full model as it was published for Neural 3D Video (github.com/oppo-us-research/SpacetimeGaussians, commit
427abfc).  PAPER is the paper as printed, and STG where it is silent.  docs/paper.md says, item by item, what still differs from both.
"""
import math
from typing import Any

SCHEDULE = 30_000
"""Steps over which STG's rates of positions fall to a hundredth (arguments/__init__.py, position_lr_max_steps)."""


def published(steps: int, densified: int = 9000, **options: Any) -> dict[str, Any]:
    """Options of STG's run, of which the model after so many steps is measured (test_iteration of its configurations).

    densified  the step up to which Gaussians are added
    """
    return {"iterations": steps, "position_rate_end": 1.6e-4 * 0.01 ** (steps / SCHEDULE), "densify_from": 500 / steps,
            "densify_until": densified / steps, **options}


STG: dict[str, Any] = {
    **published(25_000), "batch": 2,
    "motion": "polynomial", "order": 3, "motion_weight": 0.0,
    "activation": "sigmoid", "decode": "premultiplied", "decoder_place": True,
    "loss": "mixed", "dssim": 0.2, "opaque_weight": 0.0, "background": "black", "moving_weight": 1.0,
    "exposures": "off", "clocks": "off", "poses": "off",
    "rate_unit": "extent", "position_rate": 1.6e-4, "slope_floor": 0.0, "motion_rate": 2.8e-4, "motion_decay": 1.0,
    "rotation_rate": 1e-3, "turn_rate": 1e-4, "scale_rate": 1.5e-3, "opacity_rate": 0.05, "base_rate": 2.5e-3, "direction_rate": 2.5e-3,
    "time_rate": 1e-3, "centre_rate": 1e-4, "duration_rate": 0.03, "decoder_rate": 1e-4, "rate_decay": 1.0,
    "cool_down": 0.0,
    "backdrop": 0.0, "init_points": 200_000, "init_opacity": 0.1, "init_scale": 1.0, "init_duration": 1.0, "init_duration_static": 1.0,
    "init_motion": False,
    "density": "default", "max_gaussians": 500_000, "densify_every": 100,
    "densify_rounds": 6, "densify_gradient": "plain", "densify_threshold": 2e-4, "densify_size": 0.01, "densify_share": 100.0,
    "prune_opacity": 0.005, "prune_size": 1e6,
    "reset_every": 3000, "densify_time": "random", "warm_up": (), "segment_frames": 50, "segment_overlap": 0,
    "segment_steps": 0.0,
}
PAPER: dict[str, Any] = {**STG, "motion": "paper", "order": 5, "motion_weight": 0.1, "regulariser": "printed", "loss": "sum"}

_TECHNICOLOR = published(25_000, scale_rate=5e-3, densify_rounds=12, init_duration=math.exp(-2),
                          init_duration_static=math.exp(-2), activation="clamp")
SCENES: dict[str, dict[str, dict[str, Any]]] = {
    "n3v": {"coffee_martini": published(10_000, scale_rate=3e-3), "flame_salmon": published(12_000, scale_rate=3e-3)},
    "technicolor": dict.fromkeys(("Birthday", "Fabien", "Painter", "Theater", "Train"), _TECHNICOLOR),
    "immersive": {"02_Flames": published(20_000, 12_000, scale_rate=1e-3, motion_rate=0.5 * 0.5 * 1.6e-4, activation="none",
                                         densify_time="keep")},
}
"""What STG's configurations of single scenes change (configs/n3d_full, techni_full, im_distort_full), by data set."""

LENGTHS: dict[str, dict[str, Any]] = {
    "draft": {"iterations": 2500, "max_gaussians": 20_000, "init_points": 10_000, "warm_up": (0.05, 0.2), "cool_down": 0.0},
    "standard": {},
    "final": {"iterations": 30_000, "max_gaussians": 150_000, "init_points": 60_000},
}
WARM_START: dict[str, dict[str, Any]] = {"draft": {"iterations": 1200, "warm_up": ()}}
"""What a preset changes besides, where training begins with a model: places need not be found in small pictures."""
PRESETS: dict[str, dict[str, Any]] = {**LENGTHS, "paper": PAPER, "stg": STG}
"""What each preset changes."""
