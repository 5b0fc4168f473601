"""The composite adaptation law (318): a direct term and a finite-time indirect term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.estimation.excitation import zeta_1
from eladapt.signals import MixedRegression


@dataclass(frozen=True)
class CompositeLaw:
    """theta_U' = -Gamma Psi' [gamma1 d1 tanh(e1) + (gamma1 + gamma2) e2]
                  - (gamma1 + gamma2) Gamma Upsilon f(Delta) Xi                             (318)

    With c = b, f(Delta) Xi = zeta_1(Delta) |theta - theta_LS|^b sign: the second term is integrated by
    its exact flow about theta_LS, so that it arrives and stays there whatever dt is.

    gamma1, gamma2 >= 0 (one of them positive), d1 >= 0; Gamma, Upsilon: scalar or (n_potential,)
    diagonal, Gamma in units of theta^2/J; b, d: exponents of (fphi) and (329), 0 < b <= 1, d > 0.
    bounds: known |theta_U| bounds, scalar or (n_potential,), or (n_potential, 2) intervals; the
    estimate is projected on them (Assumption 1). direct, indirect: which of the two terms act.
    """

    gamma1: float = 0.3
    gamma2: float = 0.7
    d1: float = 5.0
    Gamma: float | np.ndarray = 1.0
    Upsilon: float | np.ndarray = 50.0
    b: float = 0.5
    d: float = 0.5
    bounds: float | np.ndarray | None = None
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
        """Whether Gamma Upsilon is a multiple of the identity, as `Directional` mixing needs."""
        rate = np.atleast_1d(np.asarray(self.Gamma) * np.asarray(self.Upsilon))
        return bool(np.all(rate == rate[0]))

    def step(
        self,
        theta: np.ndarray,
        psi: np.ndarray,
        e1: np.ndarray,
        e2: np.ndarray,
        mixed: MixedRegression,
        dt: float,
    ) -> np.ndarray:
        """theta_U (j,) after dt [s]; psi (nv, j), e1, e2 (nv,), mixed over theta_U or over all."""
        if self.direct:
            drive = self.gamma1 * self.d1 * np.tanh(e1) + (self.gamma1 + self.gamma2) * e2
            theta = theta - dt * self.Gamma * (psi.T @ drive)
        if self.indirect:
            theta = self._towards(mixed, theta, dt)
        if self.bounds is not None:
            theta = np.clip(theta, self.bounds[..., 0], self.bounds[..., 1])  # type: ignore[index]
        return theta

    def _towards(self, mixed: MixedRegression, theta: np.ndarray, dt: float) -> np.ndarray:
        """The indirect term's flow from theta, towards the least-squares estimate."""
        j = len(theta)
        excited = np.broadcast_to(np.asarray(mixed.delta) > 0, mixed.Y.shape)
        if j == 0 or not excited.any():
            return theta
        estimate = np.divide(mixed.Y, mixed.delta, where=excited, out=np.zeros_like(mixed.Y))
        rate = (self.gamma1 + self.gamma2) * self.Gamma * self.Upsilon * zeta_1(mixed.delta, self.b, self.d)
        if np.ndim(mixed.delta):
            error = mixed.basis.T @ theta - estimate
            return theta + mixed.basis @ (flow(error, rate, self.b, dt) - error)
        error = theta - estimate[-j:]
        return theta + flow(error, rate, self.b, dt) - error


def flow(x: np.ndarray, rate: np.ndarray, b: float, dt: float) -> np.ndarray:
    """The solution after dt of x' = -rate |x|^b sign(x), element by element; it stops at 0."""
    size = np.abs(x)
    if b == 1:
        return x * np.exp(-rate * dt)
    left = np.maximum(size ** (1 - b) - (1 - b) * rate * dt, 0.0)
    return np.sign(x) * left ** (1 / (1 - b))


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
