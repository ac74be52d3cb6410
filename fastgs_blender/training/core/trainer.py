# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer: renders, compares, follows the gradient and controls the density; gives its whole state for checkpoints."""
from __future__ import annotations

import time
from collections import deque
from dataclasses import replace

import numpy as np

from ...captures.viewpoints import viewpoints
from ...evaluation.training_record import evened_entry
from ...kernels.parameters import DECODER
from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...model.surroundings import Surroundings
from ...rendering.api import render
from ...util.backends import load_backend
from ...util.errors import FastGSError
from . import schedule
from .anchor import HELD, backdrop_of, held_features, hold
from .awaited import Awaited
from .camera_response import APART, Evening
from .camera_turns import Poses
from .density import STRATEGIES
from .distributed import Group
from .losses import motion_factor, motion_norm
from .model import empty_model, lasting, with_arrays
from .moving_pixels import Moving
from .optimiser import Optimiser
from .state import check_state
from .statistics import Statistics
from .targets import cover_of, target, use_of_mask


class Trainer:
    """One training run in memory.

    capture, store  the pictures (captures.base.Capture, FrameStore)
    settings        Settings
    model           where to begin: a GaussianModel (initial.first_model.model_from_points), or None before restore()
    group           the processes that share the views
    decoder         a model whose decoder is used as it is; None: the decoder is trained
    sizes           [N] of the points that the model was made from (Points.size): those that have one are held (anchor.py)
    reach           how far away is what the cameras film (initial.first_model.reach_of); None: the capture's extent
    gains           [V, 3] of the views trained on, as starting points tell them (initial.dense.evening_of); None: equal exposures
    fades           [V, 3] of these, how their exposures change (initial.fades.fades_of); None: they do not
    clocks          [V, 2] of these, the clock offsets that are expected (initial.start.expected_clocks); None: none are known
    known           it began with a model: see schedule.learning_rates()
    backend         the name of the backend that all arrays live on (util/backends.py)
    """

    def __init__(self, capture, store, settings, model: GaussianModel | None = None, group: Group | None = None,
                 decoder: GaussianModel | None = None, sizes: np.ndarray | None = None, reach: float | None = None, backend: str = "cpu",
                 gains: np.ndarray | None = None, fades: np.ndarray | None = None, known: bool = False, clocks: np.ndarray | None = None):
        self.backend_name, self.backend = backend, load_backend(backend)
        self.capture, self.store, self.settings = capture, store, settings
        self.group = group or Group()
        self.iteration, self._ahead, self._begun = 0, (-1, []), deque()
        self.fixed = () if decoder is None else DECODER
        self.extent = capture.extent
        self.around = [*map(float, capture.focus), float(np.linalg.norm(capture.centres() - capture.focus, axis=1).max(initial=0))]
        self.reach, self.known = reach or capture.extent, known
        self.shots = capture.training
        if not self.shots:
            raise FastGSError(f"{capture.path} has no pictures to train on; hold out fewer views.")
        self.views = schedule.Views(self.shots, settings.seed)
        self.moving = Moving(store, self.shots) if settings.moving_weight != 1 else None
        self.pixels = int(np.median([shot.camera.width * shot.camera.height for shot in self.shots]))
        self.template = empty_model(settings, capture.clip, capture.axes)
        views = tuple(dict.fromkeys(shot.view for shot in self.shots))
        self.awaited = Awaited(Evening.begun(views, capture.clip.frame_count, settings, gains, fades, clocks))
        self.awaited_poses = Awaited(Poses.begun(self.shots, settings.poses))
        self.motion_norm = motion_norm(self.template.basis, self.extent, settings.regulariser)
        self.strategy = STRATEGIES[settings.density](settings, self.extent, self.template, capture.centres())
        if model is not None:
            arrays = dict(model.arrays)
            if isinstance(model.appearance, Features):
                arrays |= {name: getattr((decoder or model).appearance, name) for name in DECODER}
            if sizes is not None:
                arrays[HELD] = held_features(model.features, sizes)
            self.optimiser = Optimiser({name: np.array(array) for name, array in arrays.items()}, backend=self.backend)
            self.statistics = Statistics.empty(self.backend, len(model))

    def __len__(self) -> int:
        return len(self.optimiser)

    @property
    def evening(self) -> Evening:
        """The cameras' exposures and clocks, as they are known now."""
        return self.awaited.known

    @property
    def poses(self) -> Poses:
        """The cameras' corrections, as they are known now."""
        return self.awaited_poses.known

    def step(self) -> dict:
        """One step, to its end; returns its values for the log."""
        goal, found = self.iteration + 1, []
        while self.iteration < goal:
            found = self.advance() + self.settle()
        return found[-1]

    def advance(self) -> list[dict]:
        """Begin the next step, and finish those that began some steps ago, or all where this one needs that; returns the values for the
        log of those that are finished.  Where one of them has to be taken again, `iteration` goes back to it."""
        s, i = self.settings, self.iteration
        guess = self.group.size == 1
        done = [] if guess else self.settle()  # what others are sent has to be right at once
        if self.iteration < i:
            return done
        self.awaited.lead = self.awaited_poses.lead = ahead = self.backend.begin_step() if guess else 0
        rates = schedule.learning_rates(s, i, self.extent, self.reach, self.template.basis, self.known)
        rates |= dict.fromkeys(self.fixed, 0.0)
        before = [(awaited.known, awaited.learnt) for awaited in (self.awaited, self.awaited_poses)]
        self._begun.append((i, len(self), before, self._begin(rates)))
        self.iteration += 1
        acts = self.strategy.acts(self.iteration)
        done += self.settle(0 if acts else ahead)
        if self.iteration == i + 1:
            self._control_density(rates)
            if acts:
                done[-1]["gaussians"] = len(self)
        return done

    def settle(self, keep: int = 0) -> list[dict]:
        """Finish the steps that have begun, but for the last `keep`; otherwise as advance()."""
        done = []
        while len(self._begun) > keep:
            i, count, before, ending = self._begun.popleft()
            found = ending()
            if found is None:
                self.optimiser.steps -= 1 + len(self._begun)
                self.iteration, self._ahead = i, (-1, [])
                for awaited, (known, learnt) in zip((self.awaited, self.awaited_poses), before, strict=True):
                    awaited.known, awaited.learnt = known, learnt
                self._begun.clear()
            else:
                done.append(self._values(i, count, *found))
        return done

    def _values(self, i: int, count: int, drawn, penalty, *values) -> dict:
        """The values for the log of step i, with so many Gaussians; what _begin() gave."""
        s = self.settings
        loss, l1, ssim, error = (float(value) for value in np.sum(values, 0) / (s.batch * self.group.size))
        if not np.isfinite(loss):
            raise FastGSError(f"training diverged at step {i + 1}: the loss is no number; use lower learning rates.")
        penalty = s.motion_weight * motion_factor(s.regulariser, count) * float(penalty[0])
        return {"iteration": i + 1, "loss": s.loss_scale * loss + penalty, "l1": l1, "ssim": ssim, "motion_penalty": penalty,
                "psnr": -10 * float(np.log10(max(error, 1e-12))), "gaussians": count, "seen": int(drawn[0]),
                "reduction": schedule.reduction(s, i)}

    def _begin(self, rates):
        """The views of a step, forward and backward, and Adam's; returns what end_step() gives for the number of the Gaussians seen, the
        motion penalty and the values of each view."""
        s, i, group, backend, n = self.settings, self.iteration, self.group, self.backend, len(self)
        statistics = self.statistics if group.size == 1 else Statistics.empty(backend, n)
        seen, gradients, views = backend.zeros((n,)), None, []
        look, sums = self.evening.looks(i, s.iterations), []
        posed, pictures = self.poses.looks(i, s.iterations), []
        for shot, goal, *arrays in self._targets(i):
            rgb, weight, least = arrays
            picture = backend.splat(self.optimiser.arrays, self.template, goal.camera, goal.t)
            opaque_weight = s.opaque_weight / s.loss_scale if goal.opaque else 0.0
            difference = backend.compare(picture, rgb, weight, goal.background, s.dissimilarity, opaque_weight,
                                         s.loss_scale / (s.batch * group.size), least)
            views.append((shot, goal, arrays, picture, difference))
        for shot, goal, arrays, picture, difference in views:
            gradients = backend.backward(picture, difference.rgb, difference.alpha, into=gradients, statistics=statistics, seen=seen,
                                         detach_time=not s.free_centre)
            if look:
                sides = self._sides(goal) if self.evening.times(i, s.iterations) else None
                sums.append((shot, self.evening.compared(backend, shot, picture, *arrays, goal.background, sides)))
            if posed:
                pictures.append((shot, goal, backend.over(picture, goal.background)))
        values = [difference.values for *_, difference in views]
        if group.size > 1:
            gradients, seen, values = self._join(gradients, seen, values, statistics)
        rows = backend.rows(seen)
        penalty = self._penalise(gradients, rows)
        self.optimiser.step(gradients, rows, rates)
        told = [*(array for _, array in sums), *(array for *_, both in pictures for array in both)]
        ending = backend.end_step(backend.count(rows), penalty, *values, *told)
        ending = self.awaited_poses.listening(i, _looking(ending, self.poses, pictures), [shot for shot, *_ in pictures], group.total)
        ending = self.awaited.listening(i, ending, [shot for shot, _ in sums], group.total)
        self.awaited.learn(i)
        self.awaited_poses.learn(i)
        if i + 1 < s.iterations:
            self._targets(i + 1)  # while the device works
        return ending

    def _targets(self, i: int) -> list[tuple]:
        """This process' (shot, Target, and of it rgb, weight and least, or None) of a step, the arrays on the backend; one step's are
        kept."""
        if self._ahead[0] != i:
            s, group, array = self.settings, self.group, self.backend.array
            chosen, reduction, found = self.views.at(i, s.batch * group.size), schedule.reduction(s, i), []
            for place in range(group.rank * s.batch, (group.rank + 1) * s.batch):
                shot = self.shots[chosen[place]]
                filmed = self.store.pixels(shot)
                moving = self.moving.share(shot, filmed) if self.moving else None
                goal = target(self.capture, self.evening.pixels(shot, filmed), shot, s, reduction, i, place, moving=moving)
                goal = replace(goal, t=self.evening.moment(shot), camera=self.poses.camera(shot.view, goal.camera))
                rest = (None if values is None else array(values) for values in (goal.weight, goal.least))
                found.append((shot, goal, self.backend.picture(goal.rgb, goal.stored), *rest))
            self._ahead = i, found
        return self._ahead[1]

    def _sides(self, goal):
        """The model's pictures a little later and earlier than a target."""
        apart = APART * self.evening.frame
        return [self.backend.splat(self.optimiser.arrays, self.template, goal.camera, goal.t + side) for side in (apart, -apart)]

    def _join(self, gradients, seen, values, statistics):
        """Sum over all processes: gradients by name, seen [N], values [4], and the statistics; returns the first three."""
        backend = self.backend
        host = {name: backend.numpy(gradient) for name, gradient in gradients.items()}
        seen, sums = backend.numpy(seen), np.sum(backend.read(*values), 0)
        new = statistics.on_host(backend)
        self.group.total([*host.values(), seen, sums, new.gradient, new.absolute, new.seen])
        self.group.largest(new.radius)
        total = self.statistics.on_host(backend)
        total.add(new)
        self.statistics = Statistics.restored(backend, vars(total))
        return {name: backend.array(gradient) for name, gradient in host.items()}, backend.array(seen), [backend.array(sums)]

    def _penalise(self, gradients, rows):
        """Add the gradients of penalties that do not depend on the views; returns L_M-reg, [1] of the backend."""
        s, backend, arrays = self.settings, self.backend, self.optimiser.arrays
        value = backend.zeros((1,), np.float64)
        if s.motion_weight and self.template.basis.terms:
            waits = self.optimiser.waits(rows)
            scale = s.motion_weight * motion_factor(s.regulariser, len(self))
            value = backend.motion_penalty(self.motion_norm, arrays["motion"], gradients["motion"], scale, waits)
        hold(backend, arrays, gradients, rows, s.backdrop_hold, self.pixels // schedule.reduction(s, self.iteration) ** 2)
        self.strategy.penalise(backend, arrays, gradients)
        return value

    def _control_density(self, rates):
        """Let the strategy change the Gaussians after a step."""
        if self.strategy.acts(self.iteration):
            with self.optimiser.on_host() as rows:
                changed = self.strategy.after_step(self.iteration, rows, self.statistics.on_host(self.backend), rates)
            if changed:
                self.statistics = Statistics.empty(self.backend, len(self))
        self.strategy.shake(self.backend, self.iteration, self.optimiser.arrays, rates)

    def model(self, provenance: dict[str, str] | None = None) -> GaussianModel:
        """The model as it is now; its arrays are the trained ones, not copies."""
        arrays = {name: self.backend.numpy(array) for name, array in self.optimiser.arrays.items()}
        return with_arrays(self.template, arrays, provenance)

    def final_model(self, provenance: dict[str, str]) -> GaussianModel:
        """The model without the Gaussians that can never be seen, and what the capture says of its surroundings."""
        host = {name: self.backend.numpy(self.optimiser.arrays[name]) for name in ("position", HELD) if name in self.optimiser.arrays}
        around = Surroundings(backdrop_of(host, self.around), viewpoints(self.capture))
        return replace(lasting(self.model(provenance | evened_entry(self.evening.facts() | self.poses.facts()))), surroundings=around)

    def measure(self, shots):
        """measure() of the model as it is now."""
        return measure(self.model(), self.capture, self.store, self.settings, shots, self.backend_name, self.evening.colours_differ)

    def state(self) -> tuple[dict[str, np.ndarray], dict]:
        """All state on which the rest of the run depends: arrays, and JSON values."""
        arrays = {f"optimiser.{name}": array for name, array in self.optimiser.state().items()}
        arrays |= {f"statistics.{name}": array for name, array in self.statistics.state(self.backend).items()}
        arrays |= {f"evening.{name}": array for name, array in self.awaited.state(self.iteration).items()}
        arrays |= {f"poses.{name}": array for name, array in self.awaited_poses.state(self.iteration).items()}
        clip = self.capture.clip
        return arrays, {"iteration": self.iteration, "settings": self.settings.to_dict(), "capture": fingerprint(self.capture),
                        "clip": [clip.frame_count, clip.fps, clip.start_frame], "axes": self.capture.axes, "around": self.around,
                        "reach": self.reach, "known": self.known}

    def restore(self, arrays: dict[str, np.ndarray], about: dict) -> None:
        """Continue from what state() gave; raises FastGSError if it is damaged, or belongs to another capture."""
        if about.get("capture") != fingerprint(self.capture):
            raise FastGSError(f"this run was begun with another capture than {self.capture.path} "
                              f"({about.get('capture')}, not {fingerprint(self.capture)}); train it into a folder of its own.")
        check_state(arrays, about, self.template, self.settings.iterations)

        def part(name):
            return {key.removeprefix(f"{name}."): array for key, array in arrays.items() if key.startswith(f"{name}.")}

        self.iteration, self.reach = about["iteration"], float(about.get("reach", self.extent))
        self.known = bool(about.get("known", False))
        self.optimiser = Optimiser.restored(part("optimiser"), self.backend)
        self.statistics = Statistics.restored(self.backend, part("statistics"))
        self.awaited.restore(part("evening"), self.iteration)
        self.awaited_poses.restore(part("poses"), self.iteration)
        self._ahead = -1, []
        self._begun.clear()


def _looking(ending, poses: Poses, pictures: list):
    """What end_step() gives, with Poses.compared() of the last arrays, which are those pictures with their alpha, in their place."""
    def end():
        values = ending()
        if values is None or not pictures:
            return values
        first = len(values) - 2 * len(pictures)
        return [*values[:first], *(poses.compared(shot, goal, *values[first + 2 * k:first + 2 * k + 2])
                                   for k, (shot, goal, _) in enumerate(pictures))]

    return end


def measure(model, capture, store, settings, shots, backend: str = "cpu", fit_colours: bool = False):
    """(mean PSNR of shots, that of their foreground where masks show it or None, [(picture, truth)] of each, over black).

    fit_colours  colours of each half of a picture are fitted on its other half (evaluation/halves.py)
    """
    from ...evaluation import halves
    from ...evaluation.metrics import psnr

    whole, part, pictures = [], [], []
    for shot in shots:
        pixels = store.pixels(shot)
        picture = render(model, shot.camera, shot.t, ("rgb",), backend)["rgb"]
        cover = cover_of(use_of_mask(settings, capture, shot, pixels.mask), pixels)
        truth = pixels.rgb if cover is None else pixels.rgb * cover[..., None]
        picture = halves.fitted(picture, truth, pixels.valid) if fit_colours else picture
        whole.append(psnr(picture, truth))
        if pixels.mask is not None:
            part.append(psnr(picture, truth, pixels.mask))
        pictures.append((picture, truth))
    part = [value for value in part if np.isfinite(value)]
    return float(np.mean(whole)), float(np.mean(part)) if part else None, pictures


def fingerprint(capture) -> dict:
    """A fingerprint of a capture: its time line, and the number and size of the training pictures."""
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

    def report(finished):
        for values in finished:
            reporter.step({**values, "iteration": before + values["iteration"]})

    while trainer.iteration < s.iterations:
        report(trainer.advance())
        i = trainer.iteration
        stopped = _agreed(trainer.group, stop())
        last = stopped or i == s.iterations
        look = preview and trainer.group.first and s.preview_every and (i % s.preview_every == 0 or i == s.iterations)
        keep = trainer.group.first and (last or time.monotonic() - saved > pause)
        if look or keep or last:
            report(trainer.settle())
            if trainer.iteration < i:
                continue
        if look:
            whole, part, pictures = trainer.measure(preview)
            kind = "held_out" if preview[0].held_out else "preview"
            measured = {f"{kind}_psnr": whole} | ({} if part is None else {f"{kind}_foreground_psnr": part})
            reporter.preview(before + i, np.concatenate(pictures[len(pictures) // 2], 1), measured)
        if keep:
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
