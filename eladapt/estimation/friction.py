"""Friction of every joint, from the information that the estimator has accumulated anyway.

Friction columns are nuisance parameters to the controller. Ordered [theta_M, theta_U, theta_F] instead
of [theta_M, theta_F, theta_U], the triangle's bottom block T_FF theta_F = t_F is the exact elimination of
all the rest: it needs only friction to be excited.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError, require_gain, require_number
from eladapt.estimation.extensions import Information
from eladapt.estimation.mixing import DUST
from eladapt.robot.regressors import Regressors

# A parameter is unknown when more than this part of it lies in directions that are not excited.
UNSEEN = 1e-3


class FrictionEstimate(NamedTuple):
    """tau_f = viscous v + coulomb sign(v), by joint; nan where it is not known."""

    viscous: np.ndarray  # (nv,) [N m s/rad]
    coulomb: np.ndarray  # (nv,) [N m]
    known: np.ndarray  # (2, nv) which of viscous, coulomb were excited, joint by joint


def estimate_friction(regressors: Regressors, information: Information) -> FrictionEstimate:
    """Least squares over all that was seen, in physical units, of the friction columns there are.

    A joint that has not moved, or at one speed only, leaves a direction without information: what
    lies in it is nan and not ``known``. Raises ArgumentError for information of another regression.
    """
    found = _directions(regressors, information)
    unseen = np.linalg.norm(found.basis[:, found.gates == 0], axis=1)
    values = np.where(unseen > UNSEEN, np.nan, found.basis @ found.estimate)
    viscous, coulomb = by_joint = _by_joint(regressors, values, np.nan)
    return FrictionEstimate(viscous, coulomb, np.isfinite(by_joint))


class CompensationState(NamedTuple):
    """What is fed forward."""

    theta: np.ndarray  # (n_friction,) in physical units
    breakaway: np.ndarray  # (nv,) [N m] beyond coulomb, while a joint is stuck away from its goal


@dataclass(frozen=True, eq=False)
class FrictionCompensation:
    """tau = viscous w + coulomb sat(w / speed) - breakaway sat(e / tolerance): what friction takes.

    w is the velocity that the control law is about to make, so a stuck joint is helped towards its goal, and
    one that has arrived, where w = 0, is left alone. The least-squares estimates are followed
    with ``time``, along each direction as far as it is trusted (its gate's fourth root times its reliability): a joint seen at one speed only gets the
    least pair of coefficients that makes the torque seen, and information lost is not forgotten. What no estimate covers (a joint that
    has never moved, static friction above Coulomb's) is met by ``breakaway``: it grows by ``rate`` limits a
    second while |e_i| > ``tolerance`` and |v_i| is below twice ``stiction_speed``, so that the joint comes to
    speeds that the regression sees, and fades with ``time`` near the goal and above five times that speed.

    limit: scalar or (nv,) [N m], the largest torque that it may add. speed [rad/s]: below it the
    compensation fades, and with it chatter; above what velocity noise is left in w. time [s];
    tolerance [rad]; stiction_speed [rad/s]; rate [1/s].
    """

    regressors: Regressors
    limit: float | np.ndarray
    speed: float = 1e-3
    time: float = 0.05
    tolerance: float = 1e-4
    stiction_speed: float = 0.01
    rate: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "limit", require_gain("limit", self.limit, self.regressors.robot.nv))
        for name in ("speed", "time", "tolerance", "stiction_speed", "rate"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self) -> CompensationState:
        """Nothing is known, nothing is fed forward."""
        return CompensationState(np.zeros(self.regressors.n_friction), np.zeros(self.regressors.robot.nv))

    def step(
        self, state: CompensationState, information: Information, e1: np.ndarray, v: np.ndarray, dt: float
    ) -> CompensationState:
        """Follow the estimates over dt [s]; e1 (nv,): error [rad], v (nv,) [rad/s]."""
        found = _directions(self.regressors, information)
        kept = np.exp(-dt / self.time)
        trust = found.gates**0.25 * found.reliability(0.1 * float(np.min(self.limit)))
        change = (1 - kept) * trust * (found.estimate - found.basis.T @ state.theta)
        theta = state.theta + found.basis @ change
        away = (np.abs(e1) > self.tolerance) & self.regressors.coulomb
        grown = np.minimum(state.breakaway + dt * self.rate * self.limit, self.limit)
        held = np.where(np.abs(v) < 2 * self.stiction_speed, grown, state.breakaway)
        fading = ~away | (np.abs(v) > 5 * self.stiction_speed)
        return CompensationState(theta, np.where(fading, kept * state.breakaway, held))

    def torque(self, state: CompensationState, e1: np.ndarray, w: np.ndarray) -> np.ndarray:
        """(nv,) [N m] at the error e1 (nv,) [rad] and the predicted velocity w (nv,) [rad/s]."""
        viscous, coulomb = np.maximum(_by_joint(self.regressors, state.theta, 0.0), 0.0)
        slide = viscous * w + coulomb * np.clip(w / self.speed, -1, 1)
        push = state.breakaway * np.clip(-e1 / self.tolerance, -1, 1)
        return np.clip(slide + push, -self.limit, self.limit)


class _Directions(NamedTuple):
    """The information about theta_F by direction, all other parameters eliminated."""

    estimate: np.ndarray  # (n,) along each direction; 0 where there is none
    gates: np.ndarray  # (n,) in [0, 1) with least squares, 0 where there is none
    basis: np.ndarray  # (n, n) directions, one a column
    spread: np.ndarray  # (n,) what the whole residual could change each estimate by; inf where there is none

    def reliability(self, tolerance: float) -> np.ndarray:
        """(n,) 1 where the residual, all of it put into one direction, would not matter; tolerance [N m]."""
        return 1 / (1 + (self.spread / tolerance) ** 2)


def _directions(regressors: Regressors, information: Information) -> _Directions:
    start, n, triangle = regressors.n_inertial, regressors.n_friction, information.triangle
    if len(triangle) != len(regressors) + 1:
        raise ArgumentError(
            f"information: expected that of {len(regressors)} parameters, got {len(triangle) - 1}"
        )
    rest = triangle[start:-1, start:]  # [F U t], all before it eliminated
    reordered = np.hstack([rest[:, n:-1], rest[:, :n], rest[:, -1:]])
    bottom = np.linalg.qr(reordered, mode="r")[len(reordered) - n :]
    left, singular, right = np.linalg.svd(bottom[:, -n - 1 : -1])
    excited = singular > DUST * max(np.linalg.norm(triangle[:-1, :-1]), np.finfo(float).tiny)
    projected = left.T @ bottom[:, -1]
    estimate = np.divide(projected, singular, where=excited, out=np.zeros(n))
    gates = np.where(excited, information.gate(singular**2), 0.0)
    spread = np.divide(abs(triangle[-1, -1]), singular, where=excited, out=np.full(n, np.inf))
    return _Directions(estimate, gates, right.T, spread)


def _by_joint(regressors: Regressors, values: np.ndarray, missing: float) -> np.ndarray:
    """(2, nv) viscous and Coulomb of the friction columns there are."""
    table = np.full((2, regressors.robot.nv), missing)
    table[[regressors.viscous, regressors.coulomb]] = values.reshape(-1, regressors.robot.nv)
    return table
