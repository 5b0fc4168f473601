"""A horizon that grows where the loop shows that it is too short: of a delay that nobody told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.compiling import MATRIX, SCALAR, VECTOR, kernel
from eladapt.errors import require_gain, require_number

JUMP = 0.01  # [rad or m] by which an error changes beside its rate: the goal has jumped


class Ripple(NamedTuple):
    """Half-waves of each joint's change of velocity error, and what they have led to."""

    e1: np.ndarray  # (nv,) [rad] at the last sample
    e2: np.ndarray  # (nv,) [rad/s] there
    sign: np.ndarray  # (nv,) of the half-wave that lasts
    peak: np.ndarray  # (nv,) [rad/s] its largest change in a sample
    before: np.ndarray  # (nv,) [rad/s] that of the half-wave before
    length: np.ndarray  # (nv,) in how many samples it lasted so far
    waves: np.ndarray  # (nv,) how many in a row were a loop's that swings
    ahead: float  # how many steps the control law looks ahead at least


@kernel(*[VECTOR] * 9, MATRIX, VECTOR, *[SCALAR] * 4)
def rippled(
    e1: np.ndarray, e2: np.ndarray, last_e1: np.ndarray, last_e2: np.ndarray, sign: np.ndarray,
    peak: np.ndarray, before: np.ndarray, length: np.ndarray, waves: np.ndarray, mass_matrix: np.ndarray,
    least: np.ndarray, kept: float, shortest: float, longest: float, dt: float,
) -> np.ndarray:  # fmt: skip
    """(5, nv): sign, peak, before, length and waves a sample later."""
    found = np.empty((5, len(e2)))
    for i in range(len(e2)):
        change = e2[i] - last_e2[i]
        size = abs(change)
        if abs(e1[i] - last_e1[i]) > abs(e2[i] + last_e2[i]) * dt + JUMP:
            found[0, i], found[1, i], found[2, i], found[3, i], found[4, i] = 0.0, 0.0, 0.0, 0.0, 0.0
            continue
        if change == 0.0 or np.sign(change) == sign[i]:
            found[0, i], found[1, i], found[2, i] = sign[i], max(peak[i], size), before[i]
            found[3, i], found[4, i] = length[i] + 1.0, waves[i]
            continue
        swings = (
            shortest <= length[i] <= longest
            and peak[i] >= kept * before[i]
            and peak[i] * mass_matrix[i, i] > least[i] * dt
        )
        found[0, i], found[1, i], found[2, i] = np.sign(change), size, peak[i]
        found[3, i], found[4, i] = 1.0, waves[i] + 1.0 if swings else 0.0
    return found


@dataclass(frozen=True)
class Patience:
    """Where a loop swings, and neither noise nor motion do that, the control law's horizon grows.

    The law near rest is a stiff PD that answers within its horizon, and a delay that is longer makes it swing
    (`eladapt.gains.sensing`). Such a swing has ``waves`` half-waves in a row of ``shortest`` to ``longest``
    samples, none of which is smaller than ``kept`` of the one before: noise turns back from sample to sample,
    and a move does not turn back so often; a goal that jumps begins afresh. Each time the least horizon grows
    by ``growth``, from one step to ``most``: what is told asks for a longer one where it has to.

    least (nv,) [N m]: a smaller torque that makes a joint swing is not looked at. How far ahead is part of
    the state and stays for as long as that is carried on. What a longer horizon costs is stiffness. Measured,
    not proven: benchmarks/results/hardware_effects.md. Raises ArgumentError for what is not positive.
    """

    least: np.ndarray
    waves: int = 8
    shortest: int = 3
    longest: int = 20
    kept: float = 0.8
    growth: float = 1.3
    most: float = 10.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "least", require_gain("least", self.least, np.size(self.least)))
        for name in ("waves", "shortest", "longest", "kept"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))
        for name in ("growth", "most"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 1))

    def init(self, nv: int) -> Ripple:
        """At rest."""
        e1, e2, sign, peak, before, length, waves = np.zeros((7, nv))
        return Ripple(e1, e2, sign, peak, before, length, waves, 1.0)

    def step(
        self, state: Ripple, e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, dt: float
    ) -> Ripple:
        """One more sample, dt [s] after the last: e1, e2 (nv,), mass_matrix M(q) (nv, nv)."""
        *seen, ahead = state
        found = rippled(e1, e2, *seen, mass_matrix, self.least, self.kept, self.shortest, self.longest, dt)
        sign, peak, before, length, waves = found
        if waves.max() < self.waves:
            return Ripple(e1, e2, sign, peak, before, length, waves, ahead)
        ahead = min(ahead * self.growth, self.most)
        return Ripple(e1, e2, sign, peak, before, length, np.zeros_like(waves), ahead)
