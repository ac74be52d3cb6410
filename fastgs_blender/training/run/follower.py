# SPDX-License-Identifier: GPL-3.0-or-later
"""What torchrun's other processes do: they take the steps of the first one's trainer with it, and write nothing."""
from ...captures.pixels.store import FrameStore
from ...captures.refined import refined
from ...util.backends import choose_device
from ..core.processes import Several
from ..core.trainer import Trainer
from ..initial.calibrate import with_poses
from ..initial.visual_hull import hull_of
from .plan import plan_from_dict
from .session import MEMORY
from .stopping import StopFlag


def follow(processes: Several, device: str | None) -> None:
    """Take steps until the first process says that the run has ended; Ctrl-C and SIGTERM are the first one's affair."""
    trainer: Trainer | None = None
    with StopFlag() as stop:
        stop.patient = True
        while (message := processes.hear()) is not None:
            if message == "step" and trainer:
                trainer.step()
            else:
                trainer = _trainer(message, processes, device)


def _trainer(message: dict, processes: Several, device: str | None) -> Trainer:
    """The trainer of one segment, as the first process describes it (session.py)."""
    plan = plan_from_dict(message["plan"])
    capture = plan.source.open()
    store = FrameStore(capture, MEMORY, whole=plan.settings.masks == "off")
    capture = refined(with_poses(capture, store, message["out"]), message["cameras"])
    store, capture = store.of(capture), capture.part(*message["span"])
    store.fill(shots=capture.shots)  # of another machine, whose cache nobody has filled
    backend = choose_device(device)[0]
    settings = plan.settings.of_segment(message["number"])
    trainer = Trainer(capture, store, settings, backend="cpu" if backend == "auto" else backend, processes=processes,
                      hull=hull_of(capture, store, lambda text: None))
    trainer.fixed = tuple(message["fixed"])
    trainer.restore(processes.hear_arrays(), message["about"])
    return trainer
