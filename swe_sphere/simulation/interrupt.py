"""Ctrl-C, SIGTERM and a lost terminal end a run between two steps, its file in good order."""

import signal
import threading
from types import FrameType, TracebackType
from typing import Any, Self


def _heard() -> list[signal.Signals]:
    """The signals that end a run in good order, as far as the system has them."""
    numbers = [signal.SIGINT, signal.SIGTERM]
    if hangup := getattr(signal, "SIGHUP", None):
        numbers += [hangup] if signal.getsignal(hangup) != signal.SIG_IGN else []
    return numbers


class Interrupted(Exception):
    """The user asked the run to stop; the message says how."""


class Interruption:
    """Within the block the first signal only raises a flag; the second acts at once as ever.

    Outside the main thread, where Python delivers no signals, it does nothing; nor does it about
    SIGHUP where that is ignored, as nohup has it.
    """

    def __init__(self) -> None:
        self._received: str | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in _heard()}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        self._restore()

    @property
    def received(self) -> str | None:
        """The signal that has come, if one has."""
        return self._received

    def check(self) -> None:
        """Raise Interrupted if a signal has come."""
        if self._received is not None:
            raise Interrupted(self._received)

    def _note(self, number: int, _: FrameType | None) -> None:
        self._received = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}
