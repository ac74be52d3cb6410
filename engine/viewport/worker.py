# SPDX-License-Identifier: GPL-3.0-or-later
"""A thread that works for all viewports: of the requests of a viewport only the latest is done."""
import logging
import threading

log = logging.getLogger(__name__)


class Worker:
    """Runs functions that touch neither Blender's data nor the GPU."""

    def __init__(self):
        self._ready = threading.Condition()
        self._pending: dict = {}
        self._current = None
        self._thread: threading.Thread | None = None

    def ask(self, owner, work) -> None:
        """Let owner.done(work()) happen on the thread, unless the owner asks for something else before."""
        with self._ready:
            self._pending.pop(owner, None)
            self._pending[owner] = work
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="fastgs-viewport", daemon=True)
                self._thread.start()
            self._ready.notify()

    def busy(self, owner) -> bool:
        """Whether anything that an owner asked for is still to be done."""
        with self._ready:
            return owner in self._pending or self._current is owner

    def forget(self, owner) -> None:
        """Drop the request of an owner."""
        with self._ready:
            self._pending.pop(owner, None)

    def stop(self) -> None:
        """End the thread, and wait for it."""
        with self._ready:
            self._pending.clear()
            thread, self._thread, self._current = self._thread, None, None
            self._ready.notify_all()
        if thread is not None:
            thread.join(10)  # it may compile; its answer is then dropped

    def _run(self):
        own = threading.current_thread()
        while True:
            with self._ready:
                while not self._pending and self._thread is own:
                    self._ready.wait()
                if self._thread is not own:
                    return
                owner = self._current = next(iter(self._pending))
                work = self._pending.pop(owner)
            try:
                owner.done(work())
            except Exception as error:  # a viewport must survive whatever a file holds
                log.exception("the viewport's thread")
                owner.failed(error)
            with self._ready:
                if self._thread is own:
                    self._current = None
