"""The composite adaptation law (318): a direct term and a finite-time indirect term."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from eladapt.batches import aligned, batch_first, batch_last, with_axes
from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.estimation.excitation import zeta_1
from eladapt.estimation.triangle import kernels, many_kernels
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
    compiled: by numba (extra ``fast``).
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
    compiled: bool = False

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

    @property
    def rate(self) -> float | np.ndarray:
        """(gamma1 + gamma2) Gamma Upsilon, before the gates."""
        return (self.gamma1 + self.gamma2) * self.Gamma * self.Upsilon

    def step(
        self,
        theta: np.ndarray,
        psi: np.ndarray,
        e1: np.ndarray,
        e2: np.ndarray,
        mixed: MixedRegression,
        dt: float,
        gates: np.ndarray | None = None,
    ) -> np.ndarray:
        """theta_U (j,) after dt [s]; psi (nv, j), e1, e2 (nv,), mixed over theta_U or over all.

        gates: zeta_1 of mixed.delta, where it is known already. All arrays may have the same leading axes.
        """
        gates = zeta_1(mixed.delta, self.b, self.d) if gates is None else gates
        if self.compiled and theta.ndim == 1:
            theta = self._compiled_step(theta, psi, e1, e2, mixed, gates, dt)
        elif self.compiled and np.ndim(mixed.delta) == theta.ndim and self.scalar_rate and theta.shape[-1]:
            theta = self._step_together(theta, psi, e1, e2, mixed, gates, dt)
        else:
            if self.direct:
                position, velocity = self.direct_factors
                drive = position * np.tanh(e1) + velocity * e2
                theta = theta - dt * self.Gamma * (drive[..., None, :] @ psi)[..., 0, :]
            if self.indirect and theta.shape[-1]:
                theta = self._towards(mixed, theta, gates, dt)
        if self.bounds is not None:
            theta = np.clip(theta, self.bounds[..., 0], self.bounds[..., 1])  # type: ignore[index]
        return theta

    @functools.cached_property
    def direct_factors(self) -> tuple[float, float]:
        """Of tanh(e1) and e2 in (318)."""
        return (self.gamma1 * self.d1, self.gamma1 + self.gamma2) if self.direct else (0.0, 0.0)

    @functools.cached_property
    def vectors(self) -> tuple[np.ndarray, np.ndarray]:
        """Gamma and the rate, of one entry or of one a parameter."""
        return np.reshape(self.Gamma, -1), np.reshape(self.rate * self.indirect, -1)

    def _compiled_step(
        self, theta: np.ndarray, psi: np.ndarray, e1: np.ndarray, e2: np.ndarray, mixed: MixedRegression,
        gates: np.ndarray, dt: float,
    ) -> np.ndarray:  # fmt: skip
        delta = mixed.delta if np.ndim(mixed.delta) else np.full(1, mixed.delta)
        gates = gates if gates.ndim else np.full(1, gates)
        return kernels().adapt(
            theta,
            psi,
            e1,
            e2,
            *self.direct_factors,
            *self.vectors,
            self.b,
            mixed.Y,
            delta,
            gates,
            mixed.basis,
            dt,
        )

    def _step_together(
        self, theta: np.ndarray, psi: np.ndarray, e1: np.ndarray, e2: np.ndarray, mixed: MixedRegression,
        gates: np.ndarray, dt: float,
    ) -> np.ndarray:  # fmt: skip
        """`_compiled_step` of a batch with one delta for each direction."""
        many, lead, (Gamma, rate) = many_kernels(), theta.shape[:-1], self.vectors
        if not self.direct:
            psi, e1, e2 = np.zeros((0, theta.shape[-1])), np.zeros(0), np.zeros(0)
        (nv, j), members = psi.shape[-2:], math.prod(lead)
        psi = np.ascontiguousarray(with_axes(psi, 2, lead)).reshape(members, nv, j)
        e1, e2 = (np.ascontiguousarray(with_axes(e, 1, lead)).reshape(members, nv) for e in (e1, e2))
        last = [batch_last(np.asarray(a), 1, lead) for a in (theta, mixed.Y, mixed.delta, gates)]
        basis = batch_last(mixed.basis, 2, lead)
        adapted = aligned(basis.shape[1:])
        many.all_adapt(
            last[0], psi, e1, e2, *self.direct_factors, Gamma, float(rate[0]), self.b, *last[1:], basis, dt,
            many.block_edges(basis.shape[-1]), adapted,
        )  # fmt: skip
        return batch_first(adapted, lead)

    def _towards(self, mixed: MixedRegression, theta: np.ndarray, gates: np.ndarray, dt: float) -> np.ndarray:
        """The indirect term's flow from theta, towards the least-squares estimate."""
        directional = np.ndim(mixed.delta) == mixed.Y.ndim
        delta = mixed.delta if directional else np.asarray(mixed.delta)[..., None]
        gates = gates if directional else np.reshape(gates, np.shape(delta))
        excited = delta > 0
        estimate = mixed.Y / np.where(excited, delta, 1.0)  # Y is 0 where delta is
        if directional:
            error = (theta[..., None, :] @ mixed.basis)[..., 0, :] - estimate
        else:
            error = theta - estimate[..., -theta.shape[-1] :]
        moved = np.where(excited, flow(error, self.rate * gates, self.b, dt) - error, 0.0)
        return theta + ((mixed.basis @ moved[..., None])[..., 0] if directional else moved)


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
