"""How far a run opened the gates of the adaptation law: (502), (IELSDREM)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from eladapt.errors import ArgumentError, require_number
from eladapt.estimation.excitation import IntervalExcitation
from eladapt.signals import Measurement, Regression


class Run(Protocol):
    """What is asked of a record."""

    @property
    def t(self) -> np.ndarray: ...
    @property
    def q(self) -> np.ndarray: ...
    @property
    def v(self) -> np.ndarray: ...
    @property
    def error(self) -> np.ndarray: ...
    @property
    def tau(self) -> np.ndarray: ...
    @property
    def dt(self) -> float: ...
    @property
    def theta_error(self) -> np.ndarray: ...
    @property
    def parameter_error(self) -> np.ndarray: ...
    @property
    def zeta(self) -> np.ndarray | None: ...


class IntervalLevel(NamedTuple):
    """(502) from t_1 = 0."""

    duration: float  # T_IE [s], inf where mu is not reached
    mu: float  # smallest eigenvalue of the integral of Omega'Omega
    holds: bool


def interval_excitation(
    regressions: Sequence[Regression], dt: float, mu: float | None = None
) -> IntervalLevel:
    """(502) of the regressions at successive samples: the least T_IE with this mu, or, with None, the
    largest mu of all the samples, which holds if it is above rounding."""
    block, dt = IntervalExcitation(), require_number("dt", dt, 0)
    if not len(regressions):
        raise ArgumentError("regressions: expected at least one Regression, got none")
    size = np.shape(regressions[0].omega)[1]
    wanted = np.inf if mu is None else require_number("mu", mu, 0)
    information, level = block.init(size), 0.0
    for k, regression in enumerate(regressions):
        information = block.step(information, regression, dt)
        if mu is not None or k == len(regressions) - 1:
            level = block.level(information)
        if level >= wanted:
            return IntervalLevel((k + 1) * dt, level, True)
    if mu is not None:
        return IntervalLevel(np.inf, level, False)
    rounding = size * np.finfo(float).eps * np.linalg.norm(information.triangle[:-1, :-1])
    return IntervalLevel(len(regressions) * dt, level, bool(level > rounding**2))


class WindowLevel(NamedTuple):
    """(IELSDREM): the integral of the gate over every window of length ell in the run is at least w."""

    ell: float  # [s]
    w: float  # [s]


def window_excitation(t: np.ndarray, gate: np.ndarray, ell: float | None = None) -> WindowLevel:
    """The largest w for this window, or, with None, the pair with the largest w/ell, ell at most half
    the run: the pair with the smallest settling-time bound. t (N,) [s]; gate (N,), of `gates_along`. w = 0
    where nothing was excited."""
    if len(t) < 3:
        raise ArgumentError(f"t: expected at least 3 samples, got {len(t)}")
    integral = gate_integral(t, gate)
    dt = (t[-1] - t[0]) / (len(t) - 1)
    if ell is None:
        counts = np.unique(np.geomspace(1, (len(t) - 1) // 2, 200).astype(int))
    else:
        counts = np.array([round(require_number("ell", ell, 0, t[-1] - t[0], closed=True) / dt)])
        if counts[0] < 1:
            raise ArgumentError(f"ell: expected at least the step {dt:g} s, got {ell:g} s")
    least = [float(np.min(integral[n:] - integral[:-n])) for n in counts]
    best = int(np.argmax(np.array(least) / counts))
    return WindowLevel(float(counts[best] * dt), least[best])


def gates_along(controller: Any, record: Run) -> np.ndarray:
    """(N,) the factor g in [0, 1) of V' <= -rate g |theta_error|^(1 + b) at every sample (588).

    zeta_1 with a scalar mixing, with `Unmixed` what the eigenvalues of Phi allow (`Unmixed.gate`). Where the
    record does not keep zeta_1, the controller's regression and extension run along it again, from the
    plant's true state and the torque that was commanded: as in the run itself where nothing was noisy,
    clipped or started afresh.
    """
    if record.zeta is not None:
        return np.asarray(record.zeta.min(axis=1))
    size, n_potential = len(controller.regressors), controller.regressors.n_potential
    samples = list(zip(record.t, record.q, record.v, [record.tau[0], *record.tau[:-1]], strict=True))
    filters = controller.regression.init(Measurement(*samples[0]))
    information = controller.extension.init(size)
    gates = np.empty(len(samples))
    for k, sample in enumerate(samples):
        if k:
            filters, regression = controller.regression.step(filters, Measurement(*sample), record.dt)
            information = controller.extension.step(information, regression, record.dt)
        gates[k] = controller.mixing.gate(controller.law, information, n_potential)
    return gates


def gate_integral(t: np.ndarray, gate: np.ndarray) -> np.ndarray:
    """(N,) integral of the gate [s], by trapezoids; t (N,) [s]."""
    return np.concatenate([[0.0], np.cumsum(np.diff(t) * (gate[1:] + gate[:-1]) / 2)])
