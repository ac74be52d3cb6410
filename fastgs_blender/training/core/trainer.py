# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer: render, compare, go down the gradient, control the density; and the whole state in between for checkpoints."""
from __future__ import annotations

import time

import numpy as np
import torch

from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...rendering.api import render as render_model
from ...util.errors import FastGSError
from . import schedule
from .density import STRATEGIES
from .differentiable import Statistics, render
from .distributed import Group
from .hold import HELD, held_features, pull
from .losses import MotionPenalty, photometric
from .model import DECODER, empty_model, lasting, with_arrays
from .optimiser import Optimiser
from .targets import cover_of, target, use_of_mask


class Trainer:
    """One training run in memory.

    capture, store  the pictures (captures.base.Capture, FrameStore)
    settings        Settings
    model           where to begin: a GaussianModel (initial.model.model_from_points), or None before restore()
    group           the processes that share the views
    decoder         a model whose decoder is used as it is; None: the decoder is trained
    sizes           of the points that the model was made from (captures.base.Points.size): those that have one are held (hold.py)
    """

    def __init__(self, capture, store, settings, model: GaussianModel | None = None, group: Group | None = None,
                 decoder: GaussianModel | None = None, sizes: np.ndarray | None = None):
        self.capture, self.store, self.settings = capture, store, settings
        self.group = group or Group()
        self.iteration = 0
        self.fixed = () if decoder is None else DECODER
        self.extent = capture.extent
        self.shots = capture.training
        if not self.shots:
            raise FastGSError(f"{capture.path} has no pictures to train on; hold out fewer views.")
        self.views = schedule.Views(self.shots, settings.seed)
        self.pixels = int(np.median([shot.camera.width * shot.camera.height for shot in self.shots]))
        self.template = empty_model(settings, capture.clip, capture.axes)
        self.penalty = MotionPenalty(self.template.basis, self.extent, settings.regulariser)
        self.strategy = STRATEGIES[settings.density](settings, self.extent, self.template, capture.centres())
        if model is not None:
            arrays = dict(model.arrays)
            if isinstance(model.appearance, Features):
                arrays |= {name: getattr((decoder or model).appearance, name) for name in DECODER}
            if sizes is not None:
                arrays[HELD] = held_features(model.features, sizes)
            self.optimiser = Optimiser({name: np.array(array) for name, array in arrays.items()})
            self.statistics = Statistics(len(model))

    def __len__(self) -> int:
        return len(self.optimiser.arrays["opacity"])

    def step(self) -> dict:
        """One step; returns its values for the log."""
        s, i, group = self.settings, self.iteration, self.group
        arrays, n = self.optimiser.arrays, len(self)
        count = s.batch * group.size
        chosen = self.views.at(i, count)
        reduction = schedule.reduction(s, i)
        tensors = {name: torch.from_numpy(array).requires_grad_() for name, array in arrays.items() if name != HELD}
        statistics = self.statistics if group.size == 1 else Statistics(n)
        seen = np.zeros(n, np.float32)
        sums = np.zeros(4)
        for place in range(group.rank * s.batch, (group.rank + 1) * s.batch):
            goal = target(self.capture, self.store, self.shots[chosen[place]], s, reduction, i, place)
            picture = render(tensors, self.template, goal.camera, goal.t, statistics=statistics, detach_time=not s.free_centre)
            rgb = picture.rgb
            if goal.background is not None:
                rgb = rgb + (1 - picture.alpha)[..., None] * torch.from_numpy(goal.background)
            loss, l1, ssim = photometric(rgb, goal.rgb, goal.weight, s.dssim)
            if goal.opaque and s.opaque_weight:
                loss = loss + s.opaque_weight * (1 - picture.alpha).mean()
            (loss / count).backward()
            seen[picture.seen] = 1
            error = float(np.square(rgb.detach().numpy() - goal.rgb).mean())
            sums += float(loss.detach()), l1, ssim, error
        gradients = {name: np.zeros_like(arrays[name]) if tensor.grad is None else tensor.grad.numpy() for name, tensor in tensors.items()}
        self._join(gradients, seen, sums, statistics)
        rows = np.flatnonzero(seen)
        penalty = self._penalise(gradients, rows)
        rates = schedule.learning_rates(s, i, self.extent, self.template.basis)
        rates |= dict.fromkeys(self.fixed, 0.0)
        self.optimiser.step(gradients, rows, rates)
        self.iteration += 1
        if self.strategy.after_step(self.iteration, self.optimiser, self.statistics, rates):
            self.statistics = Statistics(len(self))
        loss, l1, ssim, error = sums / count
        if not np.isfinite(loss):
            raise FastGSError(f"training diverged at step {self.iteration}: the loss is no number; use lower learning rates.")
        return {"iteration": self.iteration, "loss": loss + penalty, "l1": l1, "ssim": ssim, "motion_penalty": penalty,
                "psnr": -10 * float(np.log10(max(error, 1e-12))), "gaussians": len(self), "seen": len(rows), "reduction": reduction}

    def _join(self, gradients, seen, sums, statistics):
        """Make the sums of this process the sums of all."""
        if self.group.size == 1:
            return
        self.group.total([*gradients.values(), seen, sums, statistics.gradient, statistics.absolute, statistics.seen])
        self.group.largest(statistics.radius)
        self.statistics.add(statistics)

    def _penalise(self, gradients, rows) -> float:
        """Add the gradients of what does not depend on the views; returns lambda L_M-reg."""
        s, value, motion = self.settings, 0.0, self.optimiser.arrays["motion"]
        if s.motion_weight and motion.size:
            times = np.zeros(len(self), np.float32)
            times[rows] = self.optimiser.waited(rows)
            value = s.motion_weight * self.penalty.add(motion, gradients["motion"], s.motion_weight, times)
        pull(self.optimiser.arrays, gradients, rows, s.backdrop_hold, self.pixels // schedule.reduction(s, self.iteration) ** 2)
        for name, gradient in self.strategy.penalty(self.optimiser.arrays).items():
            gradients[name] += gradient
        return value

    def model(self, provenance: dict[str, str] | None = None) -> GaussianModel:
        """The model as it is now; its arrays are those that are being trained."""
        return with_arrays(self.template, self.optimiser.arrays, provenance)

    def final_model(self, provenance: dict[str, str]) -> GaussianModel:
        """The model without the Gaussians that can never be seen."""
        return lasting(self.model(provenance))

    def measure(self, shots):
        """measure() of the model as it is now."""
        return measure(self.model(), self.capture, self.store, self.settings, shots)

    def state(self) -> tuple[dict[str, np.ndarray], dict]:
        """Everything that the rest of the run depends on: arrays, and JSON values."""
        arrays = {f"optimiser.{name}": array for name, array in self.optimiser.state().items()}
        arrays |= {f"statistics.{name}": array for name, array in self.statistics.state().items()}
        clip = self.capture.clip
        return arrays, {"iteration": self.iteration, "settings": self.settings.to_dict(), "capture": fingerprint(self.capture),
                        "clip": [clip.frame_count, clip.fps, clip.start_frame], "axes": self.capture.axes}

    def restore(self, arrays: dict[str, np.ndarray], about: dict) -> None:
        """Continue from what state() gave; raises FastGSError if it belongs to another capture."""
        if about["capture"] != fingerprint(self.capture):
            raise FastGSError(f"this run was begun with another capture than {self.capture.path} "
                              f"({about['capture']}, not {fingerprint(self.capture)}); train it into a folder of its own.")

        def part(name):
            return {key.removeprefix(f"{name}."): array for key, array in arrays.items() if key.startswith(f"{name}.")}

        self.iteration = about["iteration"]
        self.optimiser = Optimiser.restored(part("optimiser"))
        self.statistics = Statistics(len(self))
        self.statistics.restore(part("statistics"))


def measure(model, capture, store, settings, shots) -> tuple[float, float | None, list[tuple[np.ndarray, np.ndarray]]]:
    """Mean PSNR of shots, that of their foreground where masks show it, and (picture, truth) of each, over black."""
    from ...evaluation.metrics import psnr

    whole, part, pictures = [], [], []
    for shot in shots:
        pixels = store.pixels(shot)
        picture = render_model(model, shot.camera, shot.t, ("rgb",))["rgb"]
        cover = cover_of(use_of_mask(settings, capture, shot, pixels.mask), pixels)
        truth = pixels.rgb if cover is None else pixels.rgb * cover[..., None]
        whole.append(psnr(picture, truth))
        if pixels.mask is not None:
            part.append(psnr(picture, truth, pixels.mask))
        pictures.append((picture, truth))
    part = [value for value in part if np.isfinite(value)]
    return float(np.mean(whole)), float(np.mean(part)) if part else None, pictures


def fingerprint(capture) -> dict:
    """What tells captures apart: their time line and the number and size of the pictures trained on."""
    first = capture.training[0].camera
    return {"frames": capture.clip.frame_count, "views": len(capture.views), "pictures": len(capture.training),
            "size": f"{first.width} x {first.height}"}


def run(trainer: Trainer, reporter, save, stop, preview=(), before: int = 0) -> bool:
    """Take all steps that are left; returns whether the run is complete.

    save()   writes a checkpoint; called at the end, and about every settings.checkpoint_seconds (0: after every step)
    stop()   whether to end early, for example because of Ctrl-C; agreed on by all processes
    preview  shots to look at now and then
    before   steps of earlier segments, by which the reporter counts on
    """
    s = trainer.settings
    saved = time.monotonic()
    pause = s.checkpoint_seconds
    while trainer.iteration < s.iterations:
        values = trainer.step()
        reporter.step({**values, "iteration": before + values["iteration"]})
        i = trainer.iteration
        if preview and trainer.group.first and s.preview_every and (i % s.preview_every == 0 or i == s.iterations):
            whole, part, pictures = trainer.measure(preview)
            kind = "held_out" if preview[0].held_out else "preview"
            measured = {f"{kind}_psnr": whole} | ({} if part is None else {f"{kind}_foreground_psnr": part})
            reporter.preview(before + i, np.concatenate(pictures[len(pictures) // 2], 1), measured)
        stopped = _agreed(trainer.group, stop())
        last = stopped or i == s.iterations
        if trainer.group.first and (last or time.monotonic() - saved > pause):
            began = time.monotonic()
            save(last)
            saved = time.monotonic()
            pause = max(s.checkpoint_seconds, 20 * (saved - began)) if s.checkpoint_seconds else 0.0  # a slow disk is asked less often
        if stopped:
            return i == s.iterations
    return True


def _agreed(group: Group, stop: bool) -> bool:
    if group.size == 1:
        return stop
    flag = np.array([float(stop)])
    group.total([flag])
    return bool(flag[0])
