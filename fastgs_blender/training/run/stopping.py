# SPDX-License-Identifier: GPL-3.0-or-later
"""Stops a run when its user asks for it: with everything saved."""
import signal
import threading
from typing import Any

from ...util.stopping import SIGNALS


class Stopped(KeyboardInterrupt):
    """The user ended the run; the message says how to continue it."""


class StopFlag:
    """Handles Ctrl-C and the other signals to stop (util/stopping.py).  While `patient`, they only set the flag, and the step that is being
    taken is finished; a second one does not wait.  Otherwise there is nothing to save, and they end the run at once.
    """

    def __init__(self) -> None:
        self.patient = self.asked = False

    def __call__(self) -> bool:
        return self.asked

    def __enter__(self) -> "StopFlag":
        self._before = {}
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._handle) for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN}
        return self

    def __exit__(self, *error: object) -> None:
        for number, old in self._before.items():
            signal.signal(number, old)

    def _handle(self, number: int, frame: Any) -> None:
        if self.asked or not self.patient:
            raise KeyboardInterrupt
        self.asked = True
