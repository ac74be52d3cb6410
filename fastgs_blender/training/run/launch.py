# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole training run: from the name of a capture to a folder with the finished model."""
from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ... import formats
from ...model.gaussians import GaussianModel
from ...training.core.settings import Settings
from ...util.backends import choose_device
from ...util.errors import FastGSError
from .files import MODEL, RUN

if TYPE_CHECKING:
    from ...captures.capture import Capture
    from .plan import Source


def train(capture: str | Path | None, out: str | Path, *, preset: str | None = None, resume: bool = False, overwrite: bool = False,
          layout: str | None = None, scale: float | None = None, frames: slice | None = None, held_out: Sequence[str] | None = None,
          scan: str | Path | None = None, quiet: bool = True, device: str | None = None, **options: Any) -> GaussianModel:
    """Train a model from a capture of several cameras; returns it when the training has ended.

    capture    folder or file of the capture; None with resume: that of the run
    out        folder of the run: it gets model.safetensors, checkpoints, previews, the log and report.json
    preset     "draft", "standard" (default) or "final"; "paper" and "stg": published setups (docs/paper.md)
    resume     continue the run in that folder, with its own capture and options; overwrite: replace it
    layout, scale, frames, held_out  see open_capture()
    scan       folder or file of photographs of the place, posed in the capture's world, such as of a walk around it while it is empty
    quiet      print no progress
    device     auto (the first GPU that has passed its self-test and was faster than the processor in it, else the processor), cpu, gpu
               or part of a GPU's name; None: $FASTGS_DEVICE
    options    any option of docs/training.md: iterations, motion, order, max_gaussians, seed ...

    Raises FastGSError, and KeyboardInterrupt where it is stopped; then resume=True continues it.

    Example:
        model = fg.train("my-capture", "run", preset="draft", iterations=500)
    """
    if capture is None and not resume:
        raise FastGSError("name the capture to train on; only a run that is resumed knows its own.")
    out, source = Path(out), source_of(capture, layout, scale, frames, held_out, scan)
    wanted = dict(options) if preset is None else {**options, "preset": preset}
    launch(source, out, wanted, resume, overwrite, quiet, lambda text: None, device)
    return formats.load(out / MODEL)


def source_of(capture: str | Path | None, layout: str | None, scale: float | None, frames: slice | None,
              held_out: Sequence[str] | None, scan: str | Path | None = None) -> Source:
    """The Source of open_capture()'s arguments, and of a scan of the place."""
    from ...captures.capture import Options
    from .plan import NO_END, Source

    Options(scale, frames, held_out)  # checks them
    part = None if frames is None else (frames.start or 0, NO_END if frames.stop is None else frames.stop, frames.step or 1)
    named = (None if place is None else str(Path(place).absolute()) for place in (capture, scan))
    return Source(next(named), layout, scale, part, None if held_out is None else tuple(held_out), next(named))


def launch(source: Source, out: str | Path, wanted: Mapping[str, Any], resume: bool, overwrite: bool, quiet: bool,
           note: Callable[[str], None], device: str | None = None) -> dict:
    """Begin or continue a run and train it to its end; returns the report, in the first process of several, else {}.

    wanted  the settings that were asked for by name; note: told remarks on the capture, and why no GPU is used; device: see train()
    """
    from ...captures.pixels.checks import check
    from ...captures.pixels.store import FrameStore
    from ...util.progress import estimated
    from ..core.processes import joined
    from ..core.settings import settings
    from . import follower, session
    from .folder import release
    from .plan import begin, smaller, suited

    def new(chosen: dict[str, Any]) -> Settings:
        return settings(**{"preset": "standard", **chosen})

    with joined() as processes:
        if processes.rank:
            follower.follow(processes, device)
            return {}
        plan = begin(out, dict(wanted), new, resume, overwrite, source)
        try:
            capture = plan.source.open()
            begins = plan.fresh or not (Path(out) / RUN).exists()
            if begins and (shrunk := smaller(plan.source, capture, plan.settings.preset)) != plan.source:
                note(f"pictures are used at {shrunk.scale:.0%} of their size, as in all drafts of large ones; --scale 1 keeps their size")
                plan, capture = replace(plan, source=shrunk), shrunk.open()
            for remark in capture.notes:
                note(remark)
            check(capture)
            if begins:
                plan = replace(plan, settings=suited(plan.settings, capture, wanted))
            backend, about = choose_device(device)  # last: the first time a GPU is tested, which takes a moment
            if about:
                note(about)
            backend = "cpu" if backend == "auto" else backend
            seconds = _seconds(capture, plan.settings) if backend == "cpu" and not resume else 0.0
            with estimated("training", seconds, note):
                store = FrameStore(capture, session.MEMORY, whole=plan.settings.masks == "off")
                return session.run(capture, store, plan, out, quiet=quiet, processes=processes, backend=backend, forecast=seconds)
        finally:
            release(out)


def _seconds(capture: Capture, settings: Settings) -> float:
    """How long a run on this capture will take on the processor, roughly."""
    from ...captures.pixels import decoding
    from ...util.progress import LONG
    from ..core import costs
    from ..core.spans import steps_of

    first = {shot.view: shot for shot in reversed(capture.training)}.values()
    pixels = max((math.prod(decoding.shape(shot, capture.scale)[:2]) for shot in first), default=0)
    run = pixels, steps_of(capture.clip.frame_count, settings), settings.max_gaussians, len(capture.training), len(first)
    usual = costs.estimate(*run)[0]
    return usual if usual < LONG / 3 else costs.estimate(*run, costs.measured_pace(pixels))[0]
