# SPDX-License-Identifier: GPL-3.0-or-later
"""One thread that works for all viewports: of what a viewport asked for, only the latest is done."""
from __future__ import annotations

import logging
import threading

log = logging.getLogger(__name__)


class Worker:
    """Runs functions that touch neither Blender's data nor the GPU."""

    def __init__(self):
        self._ready = threading.Condition()
        self._pending: dict = {}
        self._thread: threading.Thread | None = None
        self._stopping = False

    def ask(self, owner, work) -> None:
        """Let owner.done(work()) happen on the thread, unless the owner asks for something else before."""
        with self._ready:
            self._pending.pop(owner, None)
            self._pending[owner] = work
            if self._thread is None:
                self._stopping = False
                self._thread = threading.Thread(target=self._run, name="fastgs-viewport", daemon=True)
                self._thread.start()
            self._ready.notify()

    def forget(self, owner) -> None:
        """Drop what an owner asked for."""
        with self._ready:
            self._pending.pop(owner, None)

    def stop(self) -> None:
        """End the thread, and wait for it."""
        with self._ready:
            self._stopping = True
            self._pending.clear()
            thread, self._thread = self._thread, None
            self._ready.notify_all()
        if thread is not None:
            thread.join()

    def _run(self):
        while True:
            with self._ready:
                while not self._pending and not self._stopping:
                    self._ready.wait()
                if self._stopping:
                    return
                owner = next(iter(self._pending))
                work = self._pending.pop(owner)
            try:
                owner.done(work())
            except Exception as error:  # a viewport must survive whatever a file holds
                log.exception("the viewport's thread")
                owner.failed(error)
