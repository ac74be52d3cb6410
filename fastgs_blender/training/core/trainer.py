# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer: renders, compares, follows the gradient and controls the density; gives its whole state for checkpoints."""
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...captures.capture import Capture, Shot
from ...captures.viewpoints import viewpoints
from ...evaluation.training_record import corrections_entry
from ...kernels.parameters import DECODER
from ...kernels.protocol import Comparison, ForwardPass
from ...model.appearance import Features
from ...model.gaussians import GaussianModel
from ...model.surroundings import Surroundings
from ...util.backends import load_backend
from ...util.errors import FastGSError
from . import schedule
from .anchor import ANCHOR, anchor, anchor_features, backdrop_of
from .camera_estimates import CameraEstimates, DelayedStatistics
from .density import STRATEGIES
from .losses import motion_factor, motion_norm
from .measure import measure
from .model import empty_model, lasting, with_arrays
from .moving_pixels import MovingPixels
from .optimiser import Optimiser
from .processes import Processes
from .settings import Settings
from .start import Start
from .state import check_state
from .statistics import Statistics
from .targets import Target, target


@dataclass(eq=False)
class View:
    """One view of a step: its shot and target, three arrays of the target on the backend, and later its picture and loss."""

    shot: Shot
    target: Target
    rgb: Any
    weight: Any
    least: Any
    picture: ForwardPass | None = None
    loss: Comparison | None = None


@dataclass(frozen=True, eq=False)
class Pending:
    """A step that has begun: its number, Gaussians and views, what was known of the cameras, and end_step()'s function."""

    iteration: int
    count: int
    views: list[View]
    estimates: CameraEstimates
    updated: int
    end: Callable[[], list[np.ndarray] | None]


class Trainer:
    """One training run in memory.

    capture, store  the pictures (captures.base.Capture, FrameStore)
    settings        Settings
    start           what to begin with; None before restore()
    decoder         a model whose decoder is used as it is; None: the decoder is trained
    backend         the name of the backend that all arrays live on (util/backends.py)
    processes       those that take each step together
    hull            tells what a scan's pictures do not show (initial/visual_hull.py); None: they are not trained on
    """

    def __init__(self, capture: Capture, store: Any, settings: Settings, start: Start | None = None, *,
                 decoder: GaussianModel | None = None, backend: str = "cpu", processes: Processes | None = None, hull: Any = None) -> None:
        self.backend_name, self.backend = backend, load_backend(backend)
        self.capture, self.store, self.settings = capture, store, settings
        self.processes = processes or Processes()
        self.iteration = 0
        self.pending: deque[Pending] = deque()
        self._prepared: tuple[int, list[View]] = -1, []
        self.fixed = () if decoder is None else DECODER
        self.extent = capture.extent
        self.around = [*map(float, capture.focus), float(np.linalg.norm(capture.centres() - capture.focus, axis=1).max(initial=0))]
        self.hull, self.shots = hull, capture.training if hull is not None else capture.films
        if not self.shots:
            raise FastGSError(f"{capture.path} has no pictures to train on; hold out fewer views.")
        self.schedule = schedule.Views(self.shots, settings.seed, settings.scan_share)
        self.moving = MovingPixels(store, self.shots) if settings.moving_weight != 1 else None
        cameras = [shot.camera for shot in self.shots if shot.camera is not None]
        self.pixels = int(np.median([camera.width * camera.height for camera in cameras]))
        self.lens = float(np.median([camera.fx / camera.width for camera in cameras]))
        self.template = empty_model(settings, capture.clip, capture.axes)
        self.delayed = DelayedStatistics(CameraEstimates.initial(capture, settings, start))
        self.motion_norm = motion_norm(self.template.basis, self.extent, settings.regulariser)
        self.strategy = STRATEGIES[settings.density](settings, self.extent, self.template, capture.centres())
        self.depth, self.warm = self.extent, False
        if start is not None:
            self.depth, self.warm = start.depth or self.extent, start.warm
            self.strategy.frozen = start.frozen
            self.optimiser = Optimiser(_trained_arrays(start, decoder), backend=self.backend)
            self.statistics = Statistics.empty(self.backend, len(start.model))

    def __len__(self) -> int:
        return len(self.optimiser)

    @property
    def cameras(self) -> CameraEstimates:
        """What is known of the cameras now."""
        return self.delayed.estimates

    def step(self) -> dict:
        """One step, to its end; returns its values for the log."""
        goal, found = self.iteration + 1, []
        while self.iteration < goal:
            found = self.advance() + self.finish()
        return found[-1]

    def advance(self) -> list[dict]:
        """Begin the next step, and finish those that the device need not be waited for, or all where density changes.

        Returns the values for the log of those that are finished.  Where one of them has to be taken again, `iteration` goes back to it.
        """
        s, i, backend, processes = self.settings, self.iteration, self.backend, self.processes
        ahead = processes.begin_step(backend)
        rates = schedule.learning_rates(s, i, self.extent, self.depth, self.template.basis, self.warm) | dict.fromkeys(self.fixed, 0.0)
        views = self._views(i)
        for view in views:
            view.picture = self._splat(view)
        for view in views:
            view.loss = self._compare(view)
        measured = self.cameras.measure(backend, i, views, self._splat)
        statistics, seen = processes.statistics(backend, self.statistics), backend.zeros((len(self),))
        gradients = self._backward(views, statistics, seen)
        losses = [view.loss.values for view in views if view.loss is not None]
        gradients, seen, losses, self.statistics = processes.sum_step(backend, gradients, seen, losses, statistics)
        rows = backend.rows(seen, self.strategy.frozen)
        since = self.optimiser.steps_since_update(rows)
        penalty = self._regularise(gradients, rows, since)
        floors = schedule.slope_floors(s, self.lens, self.depth)
        self.optimiser.step(gradients, rows, rates, since, floors)
        end = backend.end_step(backend.count(rows), penalty, *losses, *measured)
        self.pending.append(Pending(i, len(self), views, self.cameras, self.delayed.updated, end))
        self.iteration += 1
        finished = [] if ahead else self.finish()
        if self.iteration == i + 1:
            self.delayed.update(i - ahead - 1 if ahead else i)
            if i + 1 < s.iterations:
                self._views(i + 1)  # while the device works
        densifies = self.strategy.acts(i + 1)
        finished += self.finish(0 if densifies else ahead)
        if self.iteration == i + 1:
            self._densify(rates)
            if densifies:
                finished[-1]["gaussians"] = len(self)
        return finished

    def finish(self, keep: int = 0) -> list[dict]:
        """Finish the steps that have begun, but for the last `keep`; otherwise as advance()."""
        finished = []
        while len(self.pending) > keep:
            step = self.pending.popleft()
            values = step.end()
            if values is None:
                self.optimiser.steps -= 1 + len(self.pending)
                self.iteration, self._prepared = step.iteration, (-1, [])
                self.delayed.estimates, self.delayed.updated = step.estimates, step.updated
                self.pending.clear()
                break
            seen, penalty, *rest = values
            losses = 1 if self.processes.count > 1 else len(step.views)
            sums = step.estimates.accumulate(step.iteration, step.views, rest[losses:])
            self.processes.total(list(sums.values()))
            self.delayed.arrive(step.iteration, sums)
            finished.append(self._log(step, int(seen[0]), float(penalty[0]), np.sum(rest[:losses], 0)))
        return finished

    def _log(self, step: Pending, seen: int, penalty: float, losses: np.ndarray) -> dict:
        """A step's values for the log."""
        s = self.settings
        loss, l1, ssim, error = (float(value) for value in losses / (s.batch * self.processes.count))
        if not np.isfinite(loss):
            raise FastGSError(f"training diverged at step {step.iteration + 1}: the loss is no number; use lower learning rates.")
        penalty *= s.motion_weight * motion_factor(s.regulariser, step.count)
        return {"iteration": step.iteration + 1, "loss": s.loss_scale * loss + penalty, "l1": l1, "ssim": ssim, "motion_penalty": penalty,
                "psnr": -10 * float(np.log10(max(error, 1e-12))), "gaussians": step.count, "seen": seen,
                "reduction": schedule.reduction(s, step.iteration)}

    def _views(self, i: int) -> list[View]:
        """This process' views of a step; one step's are kept."""
        if self._prepared[0] != i:
            s, cameras, array = self.settings, self.cameras, self.backend.array
            places = range(s.batch * self.processes.count)
            chosen, reduction, views = self.schedule.at(i, len(places)), schedule.reduction(s, i), []
            for place in self.processes.share(places):
                shot = self.shots[chosen[place]]
                filmed = self.store.pixels(shot)
                moving = self.moving.share(shot, filmed) if self.moving else None
                shot = schedule.at_a_moment(shot, self.capture.clip.frame_count, s.seed, i, place) if shot.place else shot
                hidden = self.hull.covers(shot.camera, shot.frame) if shot.place else None
                goal = target(self.capture, cameras.response.pixels(shot, filmed), shot, s, reduction, i, place, moving=moving,
                              hidden=hidden)
                goal = replace(goal, t=cameras.response.moment(shot), camera=cameras.turns.camera(shot.view, goal.camera))
                rest = (None if values is None else array(values) for values in (goal.weight, goal.least))
                views.append(View(shot, goal, self.backend.picture(goal.rgb, goal.stored), *rest))
            self._prepared = i, views
        return self._prepared[1]

    def _splat(self, view: View, later: float = 0.0) -> ForwardPass:
        """The model's picture of a view, or a little later or earlier."""
        return self.backend.forward(self.optimiser.arrays, self.template, view.target.camera, view.target.t + later)

    def _compare(self, view: View) -> Comparison:
        """The loss of a view's picture, and its gradient."""
        s = self.settings
        opaque_weight = s.opaque_weight / s.loss_scale if view.target.opaque else 0.0
        return self.backend.compare(view.picture, view.rgb, view.weight, view.target.background, s.dissimilarity, opaque_weight,
                                    s.loss_scale / (s.batch * self.processes.count), view.least)

    def _backward(self, views: list[View], statistics: Statistics, seen: Any) -> dict:
        """The gradients of the views' losses by name, summed; statistics and seen are added to."""
        gradients: Any = None
        for view in views:
            assert view.loss is not None
            gradients = self.backend.backward(view.picture, view.loss.rgb, view.loss.alpha, into=gradients, statistics=statistics,
                                              emphasis=view.loss.emphasis, seen=seen, detach_time=True)
        return gradients

    def _regularise(self, gradients: dict, rows: Any, since: Any) -> Any:
        """Add the gradients of penalties that do not depend on the views; returns L_M-reg, [1] of the backend."""
        s, backend, arrays = self.settings, self.backend, self.optimiser.arrays
        penalty = backend.zeros((1,), np.float64)
        if s.motion_weight and self.template.basis.terms:
            scale = s.motion_weight * motion_factor(s.regulariser, len(self))
            penalty = backend.motion_penalty(self.motion_norm, arrays["motion"], gradients["motion"], scale, since)
        anchor(backend, arrays, gradients, rows, self.pixels // schedule.reduction(s, self.iteration) ** 2)
        self.strategy.penalise(backend, arrays, gradients)
        return penalty

    def _densify(self, rates: dict) -> None:
        """Let the strategy change the Gaussians after a step."""
        if self.strategy.acts(self.iteration):
            with self.optimiser.on_host() as rows:
                changed = self.strategy.after_step(self.iteration, rows, self.statistics.on_host(self.backend), rates)
            if changed:
                self.statistics = Statistics.empty(self.backend, len(self))
        self.strategy.add_noise(self.backend, self.iteration, self.optimiser.arrays, rates)

    def model(self, provenance: dict[str, str] | None = None) -> GaussianModel:
        """The model as it is now; its arrays are the trained ones, not copies."""
        return with_arrays(self.template, {name: self.backend.numpy(array) for name, array in self.optimiser.arrays.items()}, provenance)

    def final_model(self, provenance: dict[str, str]) -> GaussianModel:
        """The model without the Gaussians that can never be seen, and what the capture says of its surroundings."""
        host = {name: self.backend.numpy(self.optimiser.arrays[name]) for name in ("position", ANCHOR) if name in self.optimiser.arrays}
        around = Surroundings(backdrop_of(host, self.around), viewpoints(self.capture))
        return replace(lasting(self.model(provenance | corrections_entry(self.cameras.facts()))), surroundings=around)

    def measure(self, shots: Sequence[Shot]) -> tuple[float, float | None, list]:
        """measure() of the model as it is now, and [(picture, truth)] of each shot."""
        pictures: list = []
        fit_colours = self.cameras.response.colours_differ
        return *measure(self.model(), self.capture, self.store, self.settings, shots, self.backend_name, fit_colours, pictures), pictures

    def state(self) -> tuple[dict[str, np.ndarray], dict]:
        """All state on which the rest of the run depends: arrays, and JSON values."""
        parts = {"optimiser": self.optimiser.state(), "statistics": self.statistics.state(self.backend), "cameras": self.delayed.state()}
        clip = self.capture.clip
        return ({f"{part}.{name}": array for part, arrays in parts.items() for name, array in arrays.items()},
                {"iteration": self.iteration, "settings": self.settings.to_dict(), "capture": fingerprint(self.capture),
                 "clip": [clip.frame_count, clip.fps, clip.start_frame], "axes": self.capture.axes, "around": self.around,
                 "depth": self.depth, "warm": self.warm, "frozen": self.strategy.frozen})

    def restore(self, arrays: dict[str, np.ndarray], about: dict) -> None:
        """Continue from what state() gave; raises FastGSError if it is damaged, or belongs to another capture."""
        if about.get("capture") != fingerprint(self.capture):
            raise FastGSError(f"this run was begun with another capture than {self.capture.path} "
                              f"({about.get('capture')}, not {fingerprint(self.capture)}); train it into a folder of its own.")
        check_state(arrays, about, self.template, self.settings.iterations)

        def part(name: str) -> dict[str, np.ndarray]:
            return {key.removeprefix(f"{name}."): array for key, array in arrays.items() if key.startswith(f"{name}.")}

        self.iteration, self.depth, self.warm = about["iteration"], float(about["depth"]), about["warm"]
        self.optimiser = Optimiser.restored(part("optimiser"), self.backend)
        self.strategy.frozen = about.get("frozen", 0)
        self.statistics = Statistics.restored(self.backend, part("statistics"))
        self.delayed.restore(part("cameras"))
        self._prepared = -1, []
        self.pending.clear()


def _trained_arrays(start: Start, decoder: GaussianModel | None) -> dict[str, np.ndarray]:
    """What the optimiser holds at the first step, copied."""
    model, arrays = start.model, dict(start.model.arrays)
    if isinstance(model.appearance, Features):
        arrays |= {name: getattr((decoder or model).appearance, name) for name in DECODER}
    if start.sizes is not None:
        arrays[ANCHOR] = anchor_features(model.features, start.sizes)
    return {name: np.array(array) for name, array in arrays.items()}


def fingerprint(capture: Capture) -> dict:
    """A fingerprint of a capture: its time line, and the number and size of the training pictures."""
    first = capture.training[0].camera
    assert first is not None
    return {"frames": capture.clip.frame_count, "views": len(capture.views), "pictures": len(capture.training),
            "size": f"{first.width} x {first.height}"}
