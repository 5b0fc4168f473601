"""Steps in which the arm moved for another time than their stamps say."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isnan, nan
from typing import NamedTuple

import numpy as np

from eladapt.compiling import COUNT, MATRIX, SCALAR, VECTOR, kernel
from eladapt.errors import require_number
from eladapt.signals import Regression

ENOUGH = 20  # steps, after which what is usual of a row is known


class StepErrors(NamedTuple):
    """What theta leaves unexplained of single steps."""

    level: np.ndarray  # (nv,) of the last step that counted
    known: np.ndarray  # (nv,) 1 where there was one, 0 elsewhere
    scatter: np.ndarray  # (nv,) mean square of its changes
    seen: np.ndarray  # (nv,) how many there were
    apart: int  # how many steps in succession have not counted


@kernel(MATRIX, VECTOR, MATRIX, VECTOR, VECTOR, SCALAR)
def step_errors(
    omega: np.ndarray, y: np.ndarray, omega_before: np.ndarray, y_before: np.ndarray, theta: np.ndarray,
    rho: float,
) -> np.ndarray:  # fmt: skip
    """(nv,) what a step has added to y - Omega theta, of which rho times the last one was left; NaN in rows
    that say nothing."""
    errors = np.empty(len(y))
    for i in range(len(y)):
        error, length, row, before = y[i] - rho * y_before[i], 0.0, omega[i], omega_before[i]
        for k in range(len(row)):
            length += row[k] * row[k]
            error -= (row[k] - rho * before[k]) * theta[k]
        errors[i] = error if length > 0.0 else nan
    return errors


@kernel(*[VECTOR] * 5, COUNT, COUNT, *[SCALAR] * 3)
def judged(
    errors: np.ndarray, level: np.ndarray, known: np.ndarray, scatter: np.ndarray, seen: np.ndarray,
    apart: int, most: int, least: float, factor: float, share: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:  # fmt: skip
    """`StepErrors` after a step with these errors."""
    after, counts, jumps = scatter.copy(), seen.copy(), False
    levels, valid = np.zeros(len(errors)), np.zeros(len(errors))
    for i in range(len(errors)):
        if isnan(errors[i]):
            continue
        levels[i], valid[i] = errors[i], 1.0
        if known[i] == 0.0:
            continue
        change = errors[i] - level[i]
        square, limit = change * change, max(least * least, factor * factor * scatter[i])
        if seen[i] >= ENOUGH and square > limit:
            square, jumps = limit, True
        counts[i] += 1
        after[i] += max(share, 1 / counts[i]) * (square - scatter[i])
    if jumps and apart < most:
        return level, known, after, counts, apart + 1
    return levels, valid, after, counts, 0


@kernel(VECTOR, VECTOR, VECTOR, VECTOR)
def stale(q_before: np.ndarray, v_before: np.ndarray, q: np.ndarray, v: np.ndarray) -> bool:
    """Whether an arm that moves is said to be where it was, to the last digit: the same sample once more."""
    moves = False
    for i in range(len(v)):
        if v[i] != v_before[i]:
            return False
        moves = moves or v[i] != 0.0
    for i in range(len(q)):
        if q[i] != q_before[i]:
            return False
    return moves


@dataclass(frozen=True)
class MistimedSteps:
    """A step contradicts the one before and is contradicted by the one after: its time stamp is wrong.

    Over a step in which an arm moved for 2 ms and its stamp says 1, momentum grows by twice what the torque
    explains. The filters remember that for 1/pole, as if a load had come. But a load pushes in every step
    alike, and a mistimed step stands alone; so the filters start afresh after a step whose error differs by
    more than ``factor`` times what such differences are (RMS over ``memory`` [s]), and by ``least``, from
    that of the last one that counted. What lasts longer than ``most`` steps is no matter of time stamps.

    least: in units of weighted rows, of an effort limit with derived gains. pole [1/s]: of the regression.
    """

    pole: float = 20.0
    least: float = 1e-3
    factor: float = 6.0
    memory: float = 1.0
    most: int = 3

    def __post_init__(self) -> None:
        for name in ("pole", "least", "factor", "memory"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self, nv: int) -> StepErrors:
        """Nothing known yet."""
        level, known, scatter, seen = np.zeros((4, nv))
        return StepErrors(level, known, scatter, seen, 0)

    def step(
        self, state: StepErrors, before: Regression, after: Regression, theta: np.ndarray, dt: float
    ) -> StepErrors:
        """``apart`` is above 0 when the step of dt [s] from ``before`` to ``after`` is not to count."""
        errors = step_errors(after.omega, after.y, before.omega, before.y, theta, exp(-self.pole * dt))
        share = min(1.0, dt / self.memory)
        return StepErrors(*judged(errors, *state, self.most, self.least, self.factor, share))
