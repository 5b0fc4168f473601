"""Signals that ask a process to end while it moves an arm: they end the loop, and never the robot's stop."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

# What Ctrl-C, `kill`, service managers and terminals that close send.
ASKING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Interruption:
    """Notes `ASKING` signals from entry to exit, in the main thread; elsewhere Python hears none.

    The first signal is noted, for the loop to end in order, or raises KeyboardInterrupt inside `impatient`. A
    second one raises it where the loop may hang. It is raised once at most, and after `settle` only inside
    `unimportant`; so what a ``finally`` does after `settle` runs to its end. A signal that is ignored (as
    ``nohup`` does) stays so.
    """

    def __init__(self) -> None:
        self.signals: list[signal.Signals] = []  # that came, in order
        self._raises_from = 2  # signals, the last of which raises
        self._settled = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for asking in ASKING:
                if signal.getsignal(asking) not in (signal.SIG_IGN, None):
                    self._before[asking] = signal.signal(asking, self._came)
        return self

    def __exit__(self, *_: object) -> None:
        for asking, handler in self._before.items():
            signal.signal(asking, handler)

    @contextlib.contextmanager
    def impatient(self) -> Iterator[None]:
        """Inside, the first signal raises: for calls that may take their time."""
        self._raises_from = 1
        try:
            yield
        finally:
            self._raises_from = 2

    def settle(self) -> None:
        """From here on nothing is raised."""
        self._settled = True

    @contextlib.contextmanager
    def unimportant(self) -> Iterator[None]:
        """Inside, after `settle`, the next signal raises: for a call that may hang and need not be made."""
        self._settled, self._raises_from = False, 1
        try:
            yield
        finally:
            self.settle()

    @property
    def ending(self) -> signal.Signals | None:
        """The first signal that would have ended the process; Ctrl-C is none, which raises in Python."""
        return next((came for came in self.signals if self._before[came] is signal.SIG_DFL), None)

    def hand_on(self) -> None:
        """After the exit: call the handlers of one's own that would have been called."""
        for came in self.signals:
            if callable(handler := self._before[came]) and handler is not signal.default_int_handler:
                handler(came, None)

    def _came(self, number: int, _frame: FrameType | None) -> None:
        self.signals.append(signal.Signals(number))
        if not self._settled and len(self.signals) >= self._raises_from:
            self._settled = True
            raise KeyboardInterrupt
