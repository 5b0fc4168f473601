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


class Snapshot(NamedTuple):
    """What was known at a time."""

    t: float  # [s]
    theta: np.ndarray  # (n_potential,)
    information: Information


class Change(NamedTuple):
    """What is known of changes so far."""

    noticed: int  # how many there were
    t: float  # [s] when the last one was; -inf before the first
    steps: float  # since then, each counting as much as the information still remembers of it
    level: float  # mean square innovation in quiet times
    theta_before: np.ndarray  # (n_potential,) estimate before the last one
    information_before: Information
    recent: Snapshot  # at most `margin` old
    trusted: Snapshot  # `margin` to twice that old: before a change that is being noticed


@dataclass(frozen=True)
class ChangeDetector:
    """A change is an innovation above ``least`` and above ``factor`` times its quiet RMS.

    least: in units of weighted rows, 0.01 of an effort limit with derived gains (0.9 N m on a Panda's
    shoulder). memory [s]: over which the quiet RMS is taken. pause [s]: least time between changes.
    margin [s]: what was learned so shortly before a change was noticed (a load that comes slowly takes
    10 ms) may have been learned of the changed arm, and is not used as what was known before.

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

    def init(self, information: Information, n_potential: int) -> Change:
        """Nothing noticed yet."""
        nothing = Snapshot(-np.inf, np.zeros(n_potential), information)
        return Change(0, -np.inf, 0.0, 0.0, nothing.theta, information, nothing, nothing)

    def step(
        self, change: Change, before: Information, after: Information, theta: np.ndarray, t: float, dt: float
    ) -> Change:
        """``noticed`` is one more when the step from ``before`` to ``after`` at time t [s] shows a change."""
        square = after.innovation**2
        limit = max(self.least**2, self.factor**2 * change.level)
        if square > limit and t - change.t > self.pause:
            _, known, seen = change.trusted
            now = Snapshot(t, theta, after)
            return Change(change.noticed + 1, t, 0.0, change.level, known, seen, now, now)
        level = change.level + min(1.0, dt / self.memory) * (min(square, limit) - change.level)
        kept = after.prior / before.prior if before.prior > 0 else 1.0
        recent, trusted = change.recent, change.trusted
        if t - recent.t >= self.margin:
            recent, trusted = Snapshot(t, theta, before), recent
        known, seen, steps = change.theta_before, change.information_before, kept * change.steps + 1
        return Change(change.noticed, change.t, steps, level, known, seen, recent, trusted)
