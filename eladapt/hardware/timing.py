"""A fixed rate from an ordinary operating system: sleep, spin for the rest, and count what is late."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import operator
import os
import time
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

import numpy as np

from eladapt.errors import HardwareError, require_number

SPIN = 2e-4  # [s] before it is due, sleeping ends: what Linux wakes late by is below this 99 % of the time
MCL_CURRENT, MCL_ONFAULT = 1, 4  # of mlockall in Linux: what is there already, page by page as it is used
EDGES = (50, 100, 200, 300, 400, 500, 700, 1000, 2000, 5000)  # [us] between the bars of a histogram
BLOCKED = 0.1  # of a period: a read that takes longer has waited for the robot


class Timing(NamedTuple):
    """How well a loop held its rate; times in [s]."""

    period: float
    ticks: int  # how many there were
    overruns: int  # whose work was not done when the next one was due
    missed: int  # ticks that were left out because of that; of a robot that keeps the clock, unread cycles
    work: tuple[float, float, float, float]  # from measurement to command: 50 %, 99 %, 99.9 %, largest
    late: tuple[float, float, float, float]  # from when a tick was due to its measurement: the same
    work_counts: tuple[int, ...] = ()  # how many ticks there were with work below, between and above `EDGES`
    late_counts: tuple[int, ...] = ()  # the same of late

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
    a tick is due when it comes, nothing else is waited for, and what was missed its time stamps say.
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

    def began(self, waited: float, passed: float = 0.0) -> None:
        """A measurement came, after ``waited`` [s] for it, ``passed`` [s] after the last by the robot's
        clock."""
        self._start = time.monotonic()
        if self.robot_keeps_clock:
            self.due = self._start
            if self.period < passed < math.inf:
                self.missed += round(passed / self.period) - 1
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
            self.overruns += 1
            self._skip(int((now - self.due) / self.period))
            return
        if self.robot_keeps_clock:
            return
        if (left := self.due - now) > SPIN:
            time.sleep(left - SPIN)
        while time.monotonic() < self.due:
            pass

    def _skip(self, ticks: int) -> None:
        if not self.robot_keeps_clock:
            self.missed += ticks
            self.due += ticks * self.period

    def timing(self) -> Timing:
        """What there was so far."""
        count = min(self.ticks, len(self._work))
        work, late = self._work[:count], self._late[:count]
        return Timing(
            self.period, self.ticks, self.overruns, self.missed, _quantiles(work), _quantiles(late),
            _counts(work), _counts(late),
        )  # fmt: skip


@contextlib.contextmanager
def undisturbed(priority: int | None = None, cpus: Collection[int] | None = None) -> Iterator[None]:
    """No garbage collection inside; of what is given, the real-time ``priority`` (1 to 99, Linux), with the
    memory kept from the disk as far as that is permitted, and the ``cpus`` that alone are used.

    `eladapt doctor` says what there is. Both hold for the thread that asks. Raises HardwareError where it is
    not permitted.
    """
    with contextlib.ExitStack() as undone:
        if cpus is not None:
            undone.callback(os.sched_setaffinity, 0, _bound(cpus))
        if priority is not None:
            undone.callback(os.sched_setscheduler, 0, *_scheduled(priority))
            undone.callback(_kept_in_memory())
        if gc.isenabled():
            undone.callback(gc.enable)
        gc.collect()
        gc.freeze()  # what is there already is not looked at again
        undone.callback(gc.unfreeze)
        gc.disable()
        yield


def _bound(cpus: Collection[int]) -> set[int]:
    """Use these processors alone; returns those before."""
    if not hasattr(os, "sched_setaffinity"):
        raise HardwareError("cpus: this system does not bind threads to processors; leave it out")
    before = os.sched_getaffinity(0)
    legal = ", ".join(map(str, sorted(before)))
    try:
        wanted = {operator.index(cpu) for cpu in cpus}
    except TypeError as reason:
        raise HardwareError(f"cpus: expected numbers out of {legal}, got {cpus!r}") from reason
    if not wanted or not wanted <= before:
        raise HardwareError(f"cpus: expected some of {legal}, got {sorted(wanted)}")
    os.sched_setaffinity(0, wanted)
    return before


def _kept_in_memory() -> Callable[[], object]:
    """Keep what is in memory there, as far as RLIMIT_MEMLOCK permits; returns what ends that."""
    library = ctypes.CDLL(None)
    library.mlockall(MCL_CURRENT | MCL_ONFAULT)
    return library.munlockall


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


def _counts(values: np.ndarray) -> tuple[int, ...]:
    """How many values [s] are below, between and above `EDGES`."""
    bars = np.searchsorted(EDGES, 1e6 * values, side="right")
    return tuple(np.bincount(bars, minlength=len(EDGES) + 1).tolist())
