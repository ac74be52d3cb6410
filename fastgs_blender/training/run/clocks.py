# SPDX-License-Identifier: GPL-3.0-or-later
"""Refines the clock offsets of a capture's cameras by a short training on small pictures; its model is discarded."""
import tempfile
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...captures import open_capture
from ...captures.capture import Capture
from ...captures.clocks.files import Clocks
from ...captures.pixels.probe import picture_size
from ...captures.pixels.store import FrameStore
from ...util.errors import FastGSError
from ..core.camera_response import FARTHEST
from ..core.settings import settings
from ..core.start import Start
from ..core.trainer import Trainer
from ..initial.start import expected_clocks, start

SIDE, MOST_FRAMES = 200, 24
"""Pictures are shrunk to this; frames that are trained on, from the middle of the clip."""
STEPS, GAUSSIANS, POINTS = 1600, 10_000, 6000
STAGES = ("reading small pictures", "comparing them", "finding starting points", "training on them")
ERROR = 0.04
"""Standard deviation of a refined clock at best, in frames (benchmarks/uneven.py)."""


def refined(path: str | Path, first: Clocks, lost: Collection[str] = (), layout: str | None = None, steps: int = STEPS,
            *, frames: slice | None = None, misplaced: Collection[str] = (),
            progress: Callable[[str, float], None] = lambda stage, share: None) -> tuple[Clocks, tuple[str, ...]]:
    """The clocks of a posed capture, from offsets that are right within a frame or so; and the views whose clock stays unsure.

    A clock moves only where pairs of cameras show where it is (initial.start.expected_clocks), and about as far as these are unsure; the
    training agrees with these and with its own model.  All views are trained on, those to be held out later too: of their pictures nothing
    is kept but the clocks.
    first, lost   what find_offsets() gave: clocks, and views whose clock is unsure
    frames    the part of the clip to use, a slice without a step
    misplaced  views whose poses are wrong: they are left out, and their clocks stay as they are
    progress  called as progress(stage, share of it), of STAGES
    Raises FastGSError where the capture has no poses or nothing can be trained on.
    """
    def within(stage: str) -> Callable[[int, int], None]:
        return lambda done, of: progress(stage, done / max(of, 1))

    chosen = settings("draft", iterations=steps, max_gaussians=GAUSSIANS, init_points=POINTS, preview_every=0)
    with tempfile.TemporaryDirectory() as folder:
        for again in (True, False):
            capture = _small(path, first.offsets, layout, frames)
            views = capture.views
            capture = replace(capture, shots=[shot for shot in capture.shots if shot.view not in misplaced])
            if not capture.posed:
                raise FastGSError(f"{capture.path}: it has no poses, and clocks are refined with them alone.")
            store = FrameStore(capture, folder=Path(folder, str(again)))
            store.fill(within(STAGES[0]))
            expected = expected_clocks(capture, store, chosen, lambda text: None, within(STAGES[1]))
            if expected is None or not expected[:, 1].any():
                return first, tuple(lost)
            far = {view: late for view, late in zip(capture.training_views, expected[:, 0]) if abs(late) > FARTHEST}
            if not far or not again:
                break
            # No training would get there: it begins there.
            first = replace(first, offsets={view: first.offsets.get(view, 0.0) + far.get(view, 0.0) for view in views})
        began = start(capture, store, replace(chosen, clocks="off"), lambda text: None, within(STAGES[2]))
        trainer = Trainer(capture, store, chosen, Start(began.model, began.sizes, began.depth, clocks=expected))
        response = trainer.cameras.response
        response.independent = np.array([first.offsets.get(view, 0.0) != 0 for view in response.views])
        while trainer.iteration < steps:
            trainer.step()
            progress(STAGES[3], trainer.iteration / steps)
    found = trainer.cameras.response
    late, spread = dict(zip(found.views, found.offsets)), dict(zip(found.views, found.uncertainty()))
    offsets = {view: first.offsets.get(view, 0.0) + float(late.get(view, 0.0)) for view in views}
    middle = float(np.median([offsets[view] for view in found.views]))
    known = {view for view in found.views if np.isfinite(spread[view])}
    uncertainty = {**first.uncertainty, **{view: float(np.hypot(ERROR, spread[view])) for view in known}}
    return Clocks({view: offset - middle for view, offset in offsets.items()}, uncertainty, "training"), tuple(set(lost) - known)


def _small(path: str | Path, offsets: Mapping[str, float], layout: str | None, frames: slice | None) -> Capture:
    """The capture with these offsets, small, of the middle of the frames."""
    whole = open_capture(path, layout=layout, offsets=offsets, held_out=(), frames=frames)
    scale = min(1.0, SIDE / max(picture_size(whole.shots[0].image)))
    capture = open_capture(path, layout=layout, offsets=offsets, held_out=(), scale=scale, frames=frames)
    return replace(capture.middle(MOST_FRAMES), points=None, model=None)
