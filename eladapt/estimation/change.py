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


class Change(NamedTuple):
    """What is known of changes so far."""

    noticed: int  # how many there were
    t: float  # [s] when the last one was; -inf before the first
    steps: int  # since then
    level: float  # mean square innovation in quiet times
    theta_before: np.ndarray  # (n_potential,) estimate when the last one was noticed
    information_before: Information


@dataclass(frozen=True)
class ChangeDetector:
    """A change is an innovation above ``least`` and above ``factor`` times its quiet RMS.

    least: in units of weighted rows, 0.01 of an effort limit with derived gains (0.9 N m on a Panda's
    shoulder). memory [s]: over which the quiet RMS is taken. pause [s]: least time between changes.
    """

    least: float = 0.01
    factor: float = 6.0
    memory: float = 1.0
    pause: float = 0.2

    def __post_init__(self) -> None:
        for name in ("least", "factor", "memory", "pause"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self, information: Information, n_potential: int) -> Change:
        """Nothing noticed yet."""
        return Change(0, -np.inf, 0, 0.0, np.zeros(n_potential), information)

    def step(
        self, change: Change, before: Information, after: Information, theta: np.ndarray, t: float, dt: float
    ) -> Change:
        """``noticed`` is one more when the step from ``before`` to ``after`` at time t [s] shows a change."""
        square = after.innovation**2
        limit = max(self.least**2, self.factor**2 * change.level)
        if square > limit and t - change.t > self.pause:
            return Change(change.noticed + 1, t, 0, change.level, theta, before)
        noticed, when, steps, level, theta_before, information_before = change
        level += min(1.0, dt / self.memory) * (min(square, limit) - level)
        return Change(noticed, when, steps + 1, level, theta_before, information_before)
