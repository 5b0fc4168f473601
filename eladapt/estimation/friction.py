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
from eladapt.regressors.regressors import Regressors
from eladapt.signals import Measurement

# A parameter is unknown when more than this part of it lies in directions that are not excited.
UNSEEN = 1e-3
# Nor is it known when the residual, all of it put into the parameter, could change it by this part of the
# largest friction parameter.
DOUBT = 0.1


class FrictionEstimate(NamedTuple):
    """tau_f = viscous v + coulomb sign(v), by joint; nan where it is not known."""

    viscous: np.ndarray  # (nv,) [N m s/rad]
    coulomb: np.ndarray  # (nv,) [N m]
    known: np.ndarray  # (2, nv) which of viscous, coulomb were excited, joint by joint


def estimate_friction(regressors: Regressors, information: Information) -> FrictionEstimate:
    """Least squares over all that was seen, in physical units, of the friction columns there are.

    A joint that has not moved, or at one speed only, leaves a direction without information: what lies
    in it is nan and not ``known``, and so is what the residual leaves in doubt. Raises ArgumentError
    for information of another regression.
    """
    found = _directions(regressors, information)
    unseen = np.linalg.norm(found.basis[:, found.gates == 0], axis=1)
    values = found.basis @ found.estimate
    spread = np.where(found.gates > 0, found.spread, 0.0)
    doubt = np.linalg.norm(found.basis * spread, axis=1)
    values[(unseen > UNSEEN) | (doubt > DOUBT * np.abs(values).max(initial=0.0))] = np.nan
    viscous, coulomb = by_joint = _by_joint(regressors, values, np.nan)
    return FrictionEstimate(viscous, coulomb, np.isfinite(by_joint))


class CompensationState(NamedTuple):
    """What is fed forward."""

    theta: np.ndarray  # (n_friction,) in physical units
    disturbance: np.ndarray  # (nv,) [N m] what neither the model nor friction explains


@dataclass(frozen=True, eq=False)
class FrictionCompensation:
    """tau = viscous w + coulomb sat(w / speed) + d: what friction takes, and a disturbance estimate.

    w is the velocity that the control law is about to make, so a stuck joint is helped towards its goal,
    and one that has arrived, where w = 0, is left alone. The least-squares estimates are followed with
    ``time``, along each direction as far as it is trusted (its gate's fourth root times its reliability):
    a joint seen at one speed only gets the least pair of coefficients that makes the torque seen, and
    what was learned stays when the information is lost.

    d is the low-pass of the model's residual, tau - (M dv/dt + C v) - Psi theta - friction, with the URDF's
    M and C, in which a stuck joint has no friction: there it integrates the law's torque until the joint
    moves. It meets what no estimate covers: a joint that has never moved, gravity not yet learned. Where
    a joint rests within ``tolerance`` of its goal d is held, or it would hunt about it.

    limit: scalar or (nv,) [N m], the largest torque of friction and of d. speed [rad/s]: below it the
    compensation fades, and with it chatter; above what velocity noise is left in w. time [s]; memory [s]
    of d: velocity noise sigma costs about M sigma / memory [N m] of it. tolerance [rad].
    """

    regressors: Regressors
    limit: np.ndarray | float
    speed: float = 1e-3
    time: float = 0.05
    memory: float = 0.01
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        object.__setattr__(self, "limit", require_gain("limit", self.limit, self.regressors.robot.nv))
        for name in ("speed", "time", "memory", "tolerance"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    def init(self) -> CompensationState:
        """Nothing is known, nothing is fed forward."""
        return CompensationState(np.zeros(self.regressors.n_friction), np.zeros(self.regressors.robot.nv))

    def step(
        self,
        state: CompensationState,
        information: Information,
        before: Measurement,
        measurement: Measurement,
        gravity: np.ndarray,
        e1: np.ndarray,
        dt: float,
    ) -> CompensationState:
        """Follow the estimates over the dt [s] between two measurements; gravity (nv,): Psi theta [N m];
        e1 (nv,): error [rad]."""
        found = _directions(self.regressors, information)
        trust = found.gates**0.25 * found.reliability(0.1 * float(np.min(self.limit)))
        change = -np.expm1(-dt / self.time) * trust * (found.estimate - found.basis.T @ state.theta)
        robot, (_, q, v, tau) = self.regressors.robot, measurement
        inertial = robot.inverse_dynamics(q, v, (v - before.v) / dt) - robot.gravity(q)
        residual = tau - inertial - gravity - self._friction(state, v)
        arrived = (np.abs(e1) < self.tolerance) & (np.abs(v) < self.speed)
        residual = np.where(arrived, state.disturbance, residual)
        disturbance = state.disturbance - np.expm1(-dt / self.memory) * (residual - state.disturbance)
        return CompensationState(
            state.theta + found.basis @ change, np.clip(disturbance, -self.limit, self.limit)
        )

    def torque(self, state: CompensationState, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """(nv,) [N m] at the velocity v (nv,) and the predicted one w (nv,) [rad/s].

        Where the step would turn v back, friction brakes for a part of it that is not known: to push
        against it all along would throw a light joint over (0.5 rad/s on the panda's last).
        """
        turns = (v * w < 0) & (np.abs(v) > self.speed)
        return self._friction(state, np.where(turns, 0.0, w)) + state.disturbance

    def _friction(self, state: CompensationState, v: np.ndarray) -> np.ndarray:
        """What the estimates say friction takes at v (nv,), rounded off near zero."""
        viscous, coulomb = np.maximum(_by_joint(self.regressors, state.theta, 0.0), 0.0)
        return np.clip(viscous * v + coulomb * np.clip(v / self.speed, -1, 1), -self.limit, self.limit)


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
    upper = np.asarray(np.linalg.qr(reordered, mode="r"))
    bottom = upper[len(reordered) - n :]
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
