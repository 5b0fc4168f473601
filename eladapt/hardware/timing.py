"""A fixed rate from an ordinary operating system: sleep, spin for the rest, and count what is late."""

from __future__ import annotations

import contextlib
import gc
import os
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from eladapt.errors import HardwareError, require_number

SPIN = 2e-4  # [s] before it is due, sleeping ends: what Linux wakes late by is below this 99 % of the time
BLOCKED = 0.1  # of a period: a read that takes longer has waited for the robot


class Timing(NamedTuple):
    """How well a loop held its rate; times in [s]."""

    period: float
    ticks: int  # how many there were
    overruns: int  # whose work was not done when the next one was due
    missed: int  # ticks that were left out because of that
    work: tuple[float, float, float, float]  # from measurement to command: 50 %, 99 %, 99.9 %, largest
    late: tuple[float, float, float, float]  # from when a tick was due to its measurement: the same

    @property
    def overrun_share(self) -> float:
        """Overruns by ticks."""
        return self.overruns / max(1, self.ticks)

    def __str__(self) -> str:
        def row(values: tuple[float, ...]) -> str:
            return ", ".join(f"{1e6 * value:.0f}" for value in values)

        return (
            f"{self.ticks} ticks at {1 / self.period:g} Hz, {self.overruns} overruns "
            f"({self.overrun_share:.2%}), {self.missed} ticks missed; from measurement to command "
            f"{row(self.work)} us, late by {row(self.late)} us (50 %, 99 %, 99.9 %, largest)"
        )


class Pacer:
    """Says when the next tick is due, on the monotonic clock.

    Each tick: `began` when the measurement is there, `wait` when the command is out. An overrun skips the
    ticks that it covers, so that nothing is caught up in a burst. A measurement that had to be waited for
    moves all ticks to come: the robot's clock leads. robot_keeps_clock: every measurement is waited for, so
    a tick is due when it comes, and nothing else is waited for.
    """

    def __init__(self, period: float, capacity: int = 1024, *, robot_keeps_clock: bool = False):
        self.period = require_number("period", period, 0)
        self.robot_keeps_clock = robot_keeps_clock
        self._work, self._late = np.empty(capacity), np.empty(capacity)
        self.ticks = self.overruns = self.missed = 0
        self.due = self._start = time.monotonic()

    def restart(self) -> None:
        """The first tick is due now."""
        self.due = time.monotonic()

    def began(self, waited: float) -> None:
        """A measurement came, after ``waited`` [s] for it."""
        self._start = time.monotonic()
        if self.robot_keeps_clock:
            self.due = self._start
        elif waited > BLOCKED * self.period:
            self.due += waited
        if self.ticks < len(self._late):
            self._late[self.ticks] = max(0.0, self._start - self.due)

    def wait(self) -> None:
        """The tick's work is done; return when the next one is due."""
        now = time.monotonic()
        if self.ticks < len(self._work):
            self._work[self.ticks] = now - self._start
        self.ticks += 1
        self.due += self.period
        if now > self.due:
            behind = int((now - self.due) / self.period)
            self.overruns += 1
            self.missed += behind
            self.due += behind * self.period
            return
        if self.robot_keeps_clock:
            return
        if (left := self.due - now) > SPIN:
            time.sleep(left - SPIN)
        while time.monotonic() < self.due:
            pass

    def timing(self) -> Timing:
        """What there was so far."""
        count = min(self.ticks, len(self._work))
        work, late = (_quantiles(values[:count]) for values in (self._work, self._late))
        return Timing(self.period, self.ticks, self.overruns, self.missed, work, late)


@contextlib.contextmanager
def undisturbed(priority: int | None = None) -> Iterator[None]:
    """No garbage collection inside, and the real-time ``priority`` (1 to 99, Linux) if one is given.

    Raises HardwareError where that is not permitted.
    """
    collecting, before = gc.isenabled(), None
    if priority is not None:
        before = _scheduled(priority)
    gc.collect()
    gc.freeze()  # what is there already is not looked at again
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if collecting:
            gc.enable()
        if before is not None:
            os.sched_setscheduler(0, *before)


def _scheduled(priority: int) -> tuple[int, os.sched_param]:
    """Set real-time scheduling; returns what was before."""
    if not hasattr(os, "sched_setscheduler"):
        raise HardwareError("priority: this system has no real-time scheduling; leave it out")
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError) as reason:
        raise HardwareError(
            f"priority: {priority} was refused ({reason}); it takes 1 to 99 and a limit on rtprio in "
            "/etc/security/limits.conf, or root"
        ) from reason
    return before


def _quantiles(values: np.ndarray) -> tuple[float, float, float, float]:
    if not len(values):
        return (0.0, 0.0, 0.0, 0.0)
    half, most, nearly, largest = (float(q) for q in np.quantile(values, (0.5, 0.99, 0.999, 1.0)))
    return half, most, nearly, largest
