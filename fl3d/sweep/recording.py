"""Record in the background: a store that is slow, or makes hundreds of runs, delays no stage's start."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from itertools import islice

from fl3d.sweep.recorder import Recorder
from fl3d.sweep.sweepers.base import Standing

ASK_SECONDS = 0.5  # between looks at whether the recorder wants to ask a store again that was down
SAY_SECONDS = 60.0  # between lines on a store that is waited for
END_SECONDS = 20.0  # that an interrupted sweep waits for a call to the store


class Recording:
    """A recorder with a thread of its own; everything is logged by that thread, in the order in which it was offered.

    Args:
        recorder: writes to the store.
    """

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self._waiting: dict[str, Standing] = {}
        self._is_busy = False
        self._is_ending = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def offer(self, standings: Mapping[str, Standing]) -> None:
        """Have trials recorded as they stand now.

        Raises:
            Exception: what the recorder has ended with.
        """
        with self._changed:
            self._check()
            self._waiting |= standings
            self._changed.notify_all()

    @property
    def is_idle(self) -> bool:
        """Whether the store holds everything that was offered."""
        with self._changed:
            return not self._waiting and not self._is_busy

    def finish(self) -> None:
        """Wait until everything is logged, however long the store is down.

        Raises:
            Exception: what the recorder has ended with.
        """
        said = time.monotonic()
        with self._changed:
            while self._waiting or self._is_busy:
                self._check()
                self._changed.wait(ASK_SECONDS)
                if self.recorder.is_waiting and time.monotonic() - said > SAY_SECONDS:
                    said = time.monotonic()
                    self.recorder.say(
                        "All is trained. Waiting for the store, to log what is on disk; Ctrl-C and a later start do "
                        "it too."
                    )
            self._check()
            self._end()
        self._thread.join()

    def interrupt(self) -> None:
        """Log no more, and close the runs of trials that are not done, if the store answers."""
        with self._changed:
            self._end()
        self._thread.join(END_SECONDS)
        if not self._thread.is_alive():
            self.recorder.interrupt()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _end(self) -> None:
        self._is_ending = True
        self._changed.notify_all()

    def _run(self) -> None:
        while (batch := self._take()) is not None:
            try:
                left = self._record(batch)
            except (
                BaseException
            ) as error:  # told by the sweep's own thread, which is waiting for it
                with self._changed:
                    self._error = error
                    self._changed.notify_all()
                return
            with self._changed:
                self._waiting = {**left, **self._waiting}
                self._is_busy = False
                self._changed.notify_all()
                if left:
                    self._changed.wait_for(lambda: self._is_ending, ASK_SECONDS)

    def _take(self) -> dict[str, Standing] | None:
        """What waits; None: nothing more is to be recorded."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_ending)
            if self._is_ending:
                return None
            batch, self._waiting = self._waiting, {}
            self._is_busy = True
            return batch

    def _record(self, batch: dict[str, Standing]) -> dict[str, Standing]:
        """Log a batch; what is left of it where the store is down, or the sweep ends."""
        for number, (key, standing) in enumerate(batch.items()):
            if self._is_ending or not self.recorder.sync({key: standing}):
                return dict(islice(batch.items(), number, None))
        return {}
