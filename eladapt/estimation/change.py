"""Noticing that the arm is no longer the one that was learned: a load came or went.

Each update of the information triangle gives the innovation of the regression for free: what the new
rows say that no theta fitting the old rows can say, so that directions never excited before raise
no alarm. It jumps when the parameters do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.compiling import SCALAR, VECTOR, kernel
from eladapt.errors import require_gain, require_number
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
    slow: np.ndarray  # (nv,) how much of a slow joint the filters remember, of the last time it was

    def __repr__(self) -> str:
        last = f", the last at t = {self.t:.6g} s" if self.noticed else ""
        return f"Change({self.noticed} noticed{last})"


@kernel(VECTOR, VECTOR, VECTOR, SCALAR)
def slow_part(before: np.ndarray, v: np.ndarray, limit: np.ndarray, kept: float) -> np.ndarray:
    """(nv,) 1 where a joint is slower than its limit, and ``kept`` of what it was where it is not."""
    after = np.empty(len(v))
    for i in range(len(v)):
        after[i] = 1.0 if abs(v[i]) < limit[i] else kept * before[i]
    return after


@dataclass(frozen=True)
class ChangeDetector:
    """A change is an innovation above ``least`` and above ``factor`` times its quiet RMS.

    least: in units of weighted rows, 0.01 of an effort limit with derived gains (0.9 N m on a Panda's
    shoulder). memory [s]: over which the quiet RMS is taken. pause [s]: least time between changes, and
    from the start to the first. margin [s]: what was learned so shortly before a change was noticed (a load
    that comes slowly takes 10 ms, one that goes from an arm at rest 52) may have been learned of the changed
    arm, and is not used as what was known before.

    slow (nv,) [rad/s]: a joint that breaks loose or turns back is slower, and friction does not jump with
    its sign then. What that may make of a row is no sign of a load: the Coulomb friction that is known, and
    at least ``friction``, in units of weighted rows. None where none is learned. pole [1/s]: of the
    regression.

    In seconds of rest velocity noise makes the inertia look smaller than it is (errors in Omega, not in y),
    and a hard start can then be taken for a change: panda, 1e-3 rad/s, after 3 s. Its payload estimate has
    a misfit of 1.
    """

    least: float = 0.01
    factor: float = 6.0
    memory: float = 1.0
    pause: float = 0.2
    margin: float = 0.07
    slow: np.ndarray | None = None
    friction: float = 0.02
    pole: float = 20.0

    def __post_init__(self) -> None:
        for name in ("least", "factor", "memory", "pause", "margin", "friction", "pole"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        if self.slow is not None:
            object.__setattr__(self, "slow", require_gain("slow", self.slow, len(self.slow), zero=True))

    def init(self, now: Snapshot, nv: int) -> Change:
        """Nothing noticed yet, and an arm of nv joints that rests."""
        return Change(0, -np.inf, 0.0, now, now, now, np.ones(nv))

    def step(
        self,
        change: Change,
        before: Snapshot,
        after: Information,
        regression: Regression,
        v: np.ndarray,
        friction: np.ndarray,
        t: float,
        dt: float,
    ) -> Change:
        """``noticed`` is one more when the rows that led to ``after`` at time t [s] show a change.

        before: what was known a step of dt [s] earlier. v (nv,): the joints' velocities. friction (m,): in
        each row, the Coulomb friction that is known, of joint i in row i.
        """
        if self.slow is not None:
            kept = math.exp(-self.pole * dt)
            change = change._replace(slow=slow_part(change.slow, v, self.slow, kept))
        square = after.innovation**2
        if square > self.least**2:
            doubt = change.slow * np.maximum(self.friction, friction) if self.slow is not None else 0.0
            square = surprise(before.information, regression, before.parameters, doubt)
        limit = max(self.least**2, self.factor**2 * change.level)
        since = change.t if change.noticed else change.before.t
        if square > limit and t - since > self.pause:
            now = before._replace(t=t)
            return Change(change.noticed + 1, t, change.level, change.trusted, now, now, change.slow)
        level = change.level + min(1.0, dt / self.memory) * (min(square, limit) - change.level)
        if t - change.recent.t >= self.margin:
            return change._replace(level=level, recent=before, trusted=change.recent)
        return change._replace(level=level)


def surprise(
    information: Information,
    regression: Regression,
    parameters: np.ndarray,
    doubt: np.ndarray | float = 0.0,
) -> float:
    """Square of what the rows contradict the least-squares estimate by, if by more than ``doubt`` (m,), where
    that is known.

    The prior in the triangle is no knowledge: a row counts when the data tell `TOLD` of its direction.
    """
    y, omega = regression
    told = information.told(omega)
    if not np.any(told > TOLD):
        return 0.0
    known = information.completed(parameters)
    left = y - omega @ known
    return float(np.sum(np.where((told > TOLD) & (np.abs(left) > doubt), left, 0.0) ** 2))
