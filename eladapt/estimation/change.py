"""Noticing that the arm is no longer the one that was learned: a load came or went.

Each update of the information triangle gives the innovation of the regression for free: what the new
rows say that no theta fitting the old rows can say, so that directions never excited before raise
no alarm. It jumps when the parameters do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.errors import require_number
from eladapt.estimation.extensions import Information
from eladapt.signals import Regression

TOLD = 0.9  # of a row's direction, less the prior's part


class Snapshot(NamedTuple):
    """What was known at a time."""

    t: float  # [s]
    parameters: np.ndarray  # (l,)
    information: Information


class Change(NamedTuple):
    """What is known of changes so far."""

    noticed: int  # how many there were
    t: float  # [s] when the last one was; -inf before the first
    level: float  # mean square innovation in quiet times
    before: Snapshot  # what was known before the last one
    recent: Snapshot  # at most `margin` old
    trusted: Snapshot  # `margin` to twice that old: before a change that is being noticed

    def __repr__(self) -> str:
        last = f", the last at t = {self.t:.6g} s" if self.noticed else ""
        return f"Change({self.noticed} noticed{last})"


@dataclass(frozen=True)
class ChangeDetector:
    """A change is an innovation above ``least`` and above ``factor`` times its quiet RMS.

    least: in units of weighted rows, 0.01 of an effort limit with derived gains (0.9 N m on a Panda's
    shoulder). memory [s]: over which the quiet RMS is taken. pause [s]: least time between changes, and
    from the start to the first. margin [s]: what was learned so shortly before a change was noticed (a load
    that comes slowly takes 10 ms) may have been learned of the changed arm, and is not used as what was
    known before.

    In seconds of rest velocity noise makes the inertia look smaller than it is (errors in Omega, not in y),
    and a hard start can then be taken for a change: panda, 1e-3 rad/s, after 3 s. Its payload estimate has
    a misfit of 1.
    """

    least: float = 0.01
    factor: float = 6.0
    memory: float = 1.0
    pause: float = 0.2
    margin: float = 0.05

    def __post_init__(self) -> None:
        for name in ("least", "factor", "memory", "pause", "margin"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self, now: Snapshot) -> Change:
        """Nothing noticed yet."""
        return Change(0, -np.inf, 0.0, now, now, now)

    def step(
        self,
        change: Change,
        before: Snapshot,
        after: Information,
        regression: Regression,
        t: float,
        dt: float,
    ) -> Change:
        """``noticed`` is one more when the rows that led to ``after`` at time t [s] show a change.

        before: what was known a step of dt [s] earlier.
        """
        square = after.innovation**2
        if square > self.least**2:
            square = surprise(before.information, regression, before.parameters)
        limit = max(self.least**2, self.factor**2 * change.level)
        since = change.t if change.noticed else change.before.t
        if square > limit and t - since > self.pause:
            now = before._replace(t=t)
            return Change(change.noticed + 1, t, change.level, change.trusted, now, now)
        level = change.level + min(1.0, dt / self.memory) * (min(square, limit) - change.level)
        if t - change.recent.t >= self.margin:
            return change._replace(level=level, recent=before, trusted=change.recent)
        return change._replace(level=level)


def surprise(information: Information, regression: Regression, parameters: np.ndarray) -> float:
    """Square of what the rows contradict the least-squares estimate by, where that is known.

    The prior in the triangle is no knowledge: a row counts when the data tell `TOLD` of its direction.
    """
    y, omega = regression
    told = information.told(omega)
    if not np.any(told > TOLD):
        return 0.0
    known = information.completed(parameters)
    return float(np.sum(np.where(told > TOLD, y - omega @ known, 0.0) ** 2))
