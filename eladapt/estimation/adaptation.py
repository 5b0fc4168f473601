"""The composite adaptation law (318): a direct term and a finite-time indirect term."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from math import sqrt, tanh

import numpy as np

from eladapt.compiling import COUNT, FLAGS, MATRIX, SCALAR, VECTOR, kernel
from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.estimation import kernels
from eladapt.estimation.excitation import zeta_1
from eladapt.signals import MixedRegression

NOTHING = slice(0, 0)
# [rad] The most that a motion which only sampled feedback sees may turn in one step. At 1 kHz the published
# arms stay below 0.17 (so_arm101), and explicit feedback of a mode diverges at 2.
RESOLVED = 0.3


@kernel(VECTOR, VECTOR, SCALAR, SCALAR, SCALAR)
def arrived(theta: np.ndarray, error: np.ndarray, rate: float, b: float, dt: float) -> np.ndarray:
    """theta after dt of theta' = rate r / |r|^(1 - b), which arrives at r = 0 and stays."""
    n, square = len(theta), 0.0
    for k in range(n):
        square += error[k] * error[k]
    share = min(1.0, rate * dt / sqrt(square) ** (1 - b)) if square > 0.0 else 0.0
    after = np.empty(n)
    for k in range(n):
        after[k] = theta[k] + share * error[k]
    return after


@kernel(VECTOR, MATRIX, VECTOR, VECTOR, SCALAR, SCALAR, VECTOR, SCALAR, FLAGS, COUNT, COUNT)
def direct_term(
    theta: np.ndarray, regressor: np.ndarray, e1: np.ndarray, e2: np.ndarray, position: float,
    velocity: float, Gamma: np.ndarray, dt: float, free: np.ndarray, first: int, end: int,
) -> np.ndarray:  # fmt: skip
    """The direct term of (318) over dt: theta - dt Gamma W' (position tanh(e1) + velocity e2), of the joints
    that are ``free``, and not of the parameters from first to end."""
    n, last = len(theta), len(Gamma) - 1
    after = theta.copy()
    for i in range(len(e1)):
        drive = dt * (position * tanh(e1[i]) + velocity * e2[i])
        if drive != 0.0 and free[i]:
            for k in range(n):
                if not first <= k < end:
                    after[k] -= Gamma[min(k, last)] * regressor[i, k] * drive
    return after


@kernel(MATRIX, MATRIX, VECTOR, COUNT, COUNT)
def stiffness(
    mass_matrix: np.ndarray, regressor: np.ndarray, Gamma: np.ndarray, first: int, end: int
) -> float:
    """[1/s^2] trace of M^-1 W Gamma W', without the parameters from first to end: at least the square of the
    fastest frequency at which the direct term, as a spring, makes the arm swing."""
    n, last, total = len(mass_matrix), len(Gamma) - 1, 0.0
    lower, x = np.zeros((n, n)), np.empty(n)
    for i in range(n):
        for j in range(i + 1):
            value = mass_matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            lower[i, j] = sqrt(max(value, 0.0)) if i == j else value / lower[j, j]
    for k in range(regressor.shape[1]):
        if first <= k < end:
            continue
        for i in range(n):
            x[i] = regressor[i, k]
            for j in range(i):
                x[i] -= lower[i, j] * x[j]
            x[i] /= lower[i, i]
            total += Gamma[min(k, last)] * x[i] * x[i]
    return total


@dataclass(frozen=True)
class CompositeLaw:
    """theta' = -Gamma W' [gamma1 d1 tanh(e1) + (gamma1 + gamma2) e2]
                - (gamma1 + gamma2) Gamma Upsilon f(Delta) Xi                               (318)

    W is the regressor of the torque that is fed forward, Psi of gravity at a set-point. The second term, the
    indirect one, is integrated so that it arrives and stays there whatever dt is. With a scalar mixing it is
    the paper's, f(Delta) Xi = zeta_1(Delta) |theta - theta_LS|^b sign for c = b, parameter by parameter and
    by its exact flow; unmixed it is the vector r / |r|^(1 - b), r = Y - Phi theta, over min(1, rate dt /
    |r|^(1 - b)) of the way.

    gamma1, gamma2 >= 0 (one of them positive), d1 >= 0; Gamma, Upsilon: scalar or (n_potential,) diagonal,
    Gamma in units of theta^2/J, scalars where they serve more than theta_U; b, d: exponents of (fphi) and
    (329), 0 < b <= 1, d > 0. bounds: known |theta_U| bounds, scalar or (n_potential,), or intervals,
    (n_potential, 2) or (l, 2) of the whole theta; the estimate is projected on them (Assumption 1). direct,
    indirect: which of the two terms act.
    """

    gamma1: float = 0.3
    gamma2: float = 0.7
    d1: float = 5.0
    Gamma: float | np.ndarray = 1.0
    Upsilon: float | np.ndarray = 50.0
    b: float = 0.5
    d: float = 0.5
    bounds: float | np.ndarray | None = field(default=None, repr=False)
    direct: bool = True
    indirect: bool = True

    def __post_init__(self) -> None:
        for name in ("gamma1", "gamma2", "d1"):
            value = require_number(name, getattr(self, name), 0, np.finfo(float).max, closed=True)
            object.__setattr__(self, name, value)
        if self.gamma1 + self.gamma2 == 0:
            raise ArgumentError("gamma1 + gamma2: expected a positive sum (318), got 0")
        object.__setattr__(self, "Gamma", require_gain("Gamma", self.Gamma))
        object.__setattr__(self, "Upsilon", require_gain("Upsilon", self.Upsilon))
        object.__setattr__(self, "d", require_number("d", self.d, 0))
        object.__setattr__(self, "b", require_number("b", self.b, 0, 1, closed=True))
        if self.b == 0:
            raise ArgumentError("b: expected 0 < b <= 1 (ExponeHom), got 0: the law would be discontinuous")
        if self.bounds is not None:
            object.__setattr__(self, "bounds", _intervals(self.bounds))

    @property
    def scalar_rate(self) -> bool:
        """Whether Gamma Upsilon is a multiple of the identity, as a matrix gain needs."""
        rate = np.atleast_1d(np.asarray(self.Gamma) * np.asarray(self.Upsilon))
        return bool(np.all(rate == rate[0]))

    @functools.cached_property
    def rate(self) -> np.ndarray:
        """(gamma1 + gamma2) Gamma Upsilon, scalar or (n_potential,), before any gate."""
        return np.asarray((self.gamma1 + self.gamma2) * self.Gamma * self.Upsilon)

    @functools.cached_property
    def _direct_gains(self) -> tuple[float, float, np.ndarray]:
        position, velocity = self.gamma1 * self.d1, self.gamma1 + self.gamma2
        return position, velocity, np.reshape(self.Gamma, -1).astype(float)

    @functools.cached_property
    def _scalar_rate(self) -> float:
        return float(np.reshape(self.rate, -1)[0])

    def descend(
        self, theta: np.ndarray, regressor: np.ndarray, e1: np.ndarray, e2: np.ndarray, dt: float,
        free: np.ndarray | None = None, kept: slice = NOTHING, mass_matrix: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """The direct term over dt [s]: theta (l,); regressor W (nv, l); e1, e2 (nv,).

        free (nv,): the joints that count, all by default; kept: a slice of theta that stays as it is.
        mass_matrix: M(q), where the reference moves, so that W is that of no set-point: Gamma is then taken
        for as much less as a step of dt asks for, which sees no swing of more than `RESOLVED` a step.
        """
        if not self.direct:
            return theta
        position, velocity, Gamma = self._direct_gains
        if len(Gamma) not in (1, len(theta)):  # a diagonal for theta_U: nothing else is adapted
            Gamma = np.concatenate([np.zeros(len(theta) - len(Gamma)), Gamma])
        if mass_matrix is not None:
            swing = dt**2 * stiffness(mass_matrix, regressor, Gamma, kept.start, kept.stop)
            share = min(1.0, RESOLVED**2 / swing) if swing > 0 else 1.0
            position, velocity = share * position, share * velocity
        if free is None:
            free = np.ones(len(e1), dtype=bool)
        return direct_term(
            theta, regressor, e1, e2, position, velocity, Gamma, dt, free, kept.start, kept.stop
        )

    def arrive(
        self, theta: np.ndarray, error: np.ndarray, dt: float, triangle: np.ndarray | None = None
    ) -> np.ndarray:
        """The indirect term over dt [s] along a vector error r (k,) = Y - Phi theta.

        triangle: of the information about these parameters. Bounds are then kept where that changes least of
        what the data say (`kernels.kept_within`); what they forbid does not count in |r|.
        """
        if not self.indirect:
            return theta
        if triangle is not None and np.shape(self.bounds) == (len(theta), 2):  # type: ignore[arg-type]
            error = kernels.kept_within(triangle, theta + error, *self._columns) - theta
        return arrived(theta, error, self._scalar_rate, self.b, dt)

    @functools.cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.array(self.bounds).T
        return low.copy(), high.copy()

    def scalar_flow(self, theta: np.ndarray, mixed: MixedRegression, dt: float) -> np.ndarray:
        """The indirect term over dt [s] with a scalar gain Delta: the last parameters of theta, as many as Y
        has."""
        delta, size = float(mixed.gain), len(mixed.Y)
        if not self.indirect or not delta > 0 or not size:
            return theta
        start = len(theta) - size
        rate = self.rate * zeta_1(delta, self.b, self.d)
        if rate.ndim and len(rate) < size:  # of theta_U alone
            rate = np.concatenate([np.zeros(size - len(rate)), rate])
        estimate = mixed.Y / delta
        moved = estimate + flow(theta[start:] - estimate, rate, self.b, dt)
        return np.concatenate([theta[:start], moved])

    def check_bounds(self, n_potential: int, size: int) -> None:
        """Raises ArgumentError for bounds of other numbers of parameters than those of theta_U and theta."""
        bounds = self.bounds
        if isinstance(bounds, np.ndarray) and bounds.ndim > 1 and len(bounds) not in (n_potential, size):
            raise ArgumentError(
                f"bounds: expected a scalar, ({n_potential},) or ({size}, 2), got {len(bounds)} of them"
            )

    def bounded(self, theta: np.ndarray, n_potential: int) -> np.ndarray:
        """theta (l,) projected on the bounds: theta_U, its last block, or all of it."""
        if self.bounds is None:
            return theta
        low, high = self.bounds[..., 0], self.bounds[..., 1]  # type: ignore[index]
        if low.size == len(theta):
            return np.minimum(np.maximum(theta, low), high)
        start = len(theta) - n_potential
        return np.concatenate([theta[:start], np.clip(theta[start:], low, high)])


def flow(x: np.ndarray, rate: float | np.ndarray, b: float, dt: float) -> np.ndarray:
    """The solution after dt of x' = -rate |x|^b sign(x), element by element; it stops at 0."""
    if b == 1:
        return x * np.exp(-rate * dt)
    left = np.maximum(np.abs(x) ** (1 - b) - (1 - b) * dt * rate, 0.0)
    return np.copysign(left ** (1 / (1 - b)), x)


def _intervals(bounds: float | np.ndarray) -> np.ndarray:
    """(..., 2) lower and upper bounds."""
    array = np.asarray(bounds, dtype=float)
    if array.ndim < 2:
        array = np.stack([-array, array], axis=-1)
    if array.shape[-1] != 2 or np.isnan(array).any() or np.any(array[..., 0] > array[..., 1]):
        raise ArgumentError(
            f"bounds: expected positive sizes (n_potential,) or intervals (n_potential, 2) with "
            f"lower <= upper, got {bounds!r}"
        )
    return array
