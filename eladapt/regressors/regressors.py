"""Every regressor of adaptive control, in base parameters theta = [theta_M, theta_F, theta_U]."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Literal

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, require_vector
from eladapt.regressors.base import ROUNDING, ParameterBasis, independent_basis, sample, shared_basis
from eladapt.regressors.standard import StandardRegressors
from eladapt.robot.batch import Path, Positions, TorqueRegressors
from eladapt.robot.model import Robot

SPAN_TOLERANCE = 1e-9  # relative; a basis of one's own must reproduce the torque this well


class Regressors:
    """Turns a robot into regressors W(q, v, a) with W @ theta = tau.

    sharing: "shared" uses one base for motion and gravity, [complement; gravity base];
        "independent" gives theta_M and theta_U no parameter in common, as the paper has it (250).
    friction: False, "viscous" (nv parameters), "coulomb" (nv) or True (both, viscous first).
        Nominal values are the URDF's damping and friction.
    basis: a ParameterBasis of one's own; it fixes the units too, and must reproduce the robot's
        nominal torque (what it leaves out, such as masses off a centre line, the robot must not have).
    scaled: columns have unit RMS over random states, so every parameter is the torque [N m] that
        it typically makes and one gain serves them all. Never done to a basis of one's own.

    Raises ArgumentError for an unknown option, or a basis that does not span the regressors.
    Warns (RankWarning) when the rank of the base is not clear; ``rank_gap`` has the figure.
    """

    def __init__(
        self,
        robot: Robot,
        sharing: Literal["shared", "independent"] = "shared",
        friction: bool | Literal["viscous", "coulomb"] = False,
        basis: ParameterBasis | None = None,
        *,
        scaled: bool = True,
    ):
        if sharing not in ("shared", "independent"):
            raise ArgumentError(f"sharing: expected 'shared' or 'independent', got {sharing!r}")
        if friction not in (False, True, "viscous", "coulomb"):
            raise ArgumentError(f"friction: expected False, True, 'viscous' or 'coulomb', got {friction!r}")
        self.robot, self.sharing = robot, sharing
        self.viscous, self.coulomb = friction in (True, "viscous"), friction in (True, "coulomb")
        self._standard = StandardRegressors(robot)
        samples = sample(self._standard)
        # In a base shared by motion and gravity one product makes both.
        self._one_base = basis is None and sharing == "shared"
        if basis is None:
            derive = shared_basis if sharing == "shared" else independent_basis
            basis = derive(self._standard, samples)
        else:
            nominal = self._standard.parameters
            _require_span(basis, nominal, samples.kinetic, basis.kinetic, "kinetic")
            _require_span(basis, nominal, samples.gravity, basis.potential, "gravity")
            scaled = False
        self.basis = basis
        p = len(basis.labels)
        self.n_potential = basis.n_potential
        self.n_inertial = p - basis.n_potential
        self.n_friction = robot.nv * (self.viscous + self.coulomb)
        self.scale = np.ones(p + self.n_friction)  # theta = scale * physical base parameters
        if scaled:
            torque = samples.kinetic @ basis.kinetic
            torque[:, self.n_inertial :] = samples.gravity @ basis.potential[:, self.n_inertial :]
            self.scale[self._inertial] = np.sqrt(np.mean(torque**2, axis=0))
        # From standard to base parameters (s, l), with zeros for friction.
        self._kinetic_map = self._spread(basis.kinetic)
        self._potential_map = self._spread(basis.potential)
        self._gravity_map = self._potential_map[:, len(self) - self.n_potential :].copy()
        self._viscous_at, self._coulomb_at = self._friction_entries()

    @property
    def robot_parameters(self) -> np.ndarray:
        """(s,) the URDF's standard parameters."""
        return self._standard.parameters

    @property
    def rank_gap(self) -> float:
        """By which factor the singular values drop behind the rank of the base."""
        return self.basis.rank_gap

    @property
    def _inertial(self) -> np.ndarray:
        """Where the p base parameters stand in theta: all but the friction block."""
        return np.r_[0 : self.n_inertial, self.n_inertial + self.n_friction : len(self)]

    def __len__(self) -> int:
        return self.n_inertial + self.n_friction + self.n_potential

    @property
    def theta(self) -> np.ndarray:
        """(l,) the nominal parameters, those of the URDF."""
        theta = np.empty(len(self))
        theta[self._inertial] = self.basis.projection @ self._standard.parameters
        blocks = [self.robot.damping] * self.viscous + [self.robot.friction] * self.coulomb
        theta[self.n_inertial : self.n_inertial + self.n_friction] = np.concatenate([*blocks, []])
        return self.scale * theta

    def theta_of(self, model: pin.Model) -> np.ndarray:
        """(l,) the parameters of another model of the same arm, as one with a load is; friction and
        armature are this robot's. Raises ArgumentError for a model with other joints."""
        if list(model.names) != list(self.robot.model.names):
            raise ArgumentError(
                f"model: expected the joints {list(self.robot.model.names)}, got {list(model.names)}"
            )
        standard = self._standard.parameters.copy()
        bodies = [inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]]
        change = np.zeros_like(standard)
        change[: 10 * len(bodies)] = np.concatenate(bodies) - standard[: 10 * len(bodies)]
        theta = self.theta
        theta[self._inertial] += self.scale[self._inertial] * (self.basis.projection @ change)
        return theta

    @property
    def theta_potential(self) -> np.ndarray:
        """(n_potential,) theta_U, the nominal gravity parameters."""
        return self.theta[len(self) - self.n_potential :]

    @property
    def labels(self) -> tuple[str, ...]:
        """l names, in the order of theta; a leading factor is the column scale."""
        joints = self.robot.joint_names
        friction = [f"viscous({n})" for n in joints if self.viscous]
        friction += [f"coulomb({n})" for n in joints if self.coulomb]
        names = list(self.basis.labels)
        names[self.n_inertial : self.n_inertial] = friction
        return tuple(n if s == 1 else f"{s:.3g} ({n})" for n, s in zip(names, self.scale, strict=True))

    def gravity(self, q: np.ndarray, *, check: bool = True) -> np.ndarray:
        """Psi(q) (nv, n_potential): Psi @ theta_U = g(q) (209). check: whether q is to be validated."""
        return self._standard.gravity(self.robot.check_q(q) if check else q) @ self._gravity_map

    def momentum(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """[M_k(q) v]_k (nv, l): varphi_3 of (419)."""
        q, v = self.robot.check_q(q), self.robot.check_v(v)
        return self._standard.momentum(q, v) @ self._kinetic_map

    def kinetic_gradient(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """[1/2 grad_q v' M_k v]_k = [C_k' v]_k (nv, l), of (401)."""
        q, v = self.robot.check_q(q), self.robot.check_v(v)
        return self._standard.kinetic_gradient(q, v) @ self._kinetic_map

    def potential_gradient(self, q: np.ndarray) -> np.ndarray:
        """[grad U_k]_k (nv, l): varphi_2 of (419), zero but for theta_U."""
        return self._standard.gravity(self.robot.check_q(q)) @ self._potential_map

    def friction_torque(self, v: np.ndarray) -> np.ndarray:
        """[diag(v), diag(sign v)] in the friction columns (nv, l), zero elsewhere."""
        return self._add_friction(np.zeros((self.robot.nv, len(self))), self.robot.check_v(v))

    def energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """omega(q, v) (l,): omega @ theta = kinetic + potential energy, up to a constant (Omega)."""
        q, v = self.robot.check_q(q), self.robot.check_v(v)
        kinetic = self._standard.kinetic_energy(q, v) @ self._kinetic_map
        return kinetic + self._standard.potential_energy(q) @ self._potential_map

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, *, check: bool = True) -> np.ndarray:
        """W (nv, l): W @ theta = M a + C v + g + friction, armature included.

        check: whether the arguments are to be validated; unchecked ones may have leading axes.
        """
        if check:
            q, v, a = self.robot.check_q(q), self.robot.check_v(v), self.robot.check_v(a, "a")
        if self._one_base:
            standard = self._standard.torque(q, v, a)
            if v.ndim == 1:
                return self._add_friction(standard @ self._kinetic_map, v)
            rows = standard.reshape(-1, standard.shape[-1]) @ self._kinetic_map  # one product for all
            return self._add_friction(rows.reshape(*v.shape, -1), v)
        if v.ndim > 1:
            return np.array([self.torque(*state, check=False) for state in zip(q, v, a, strict=True)])
        return self._assemble(self._standard.kinetic_torque(q, v, a), q, v)

    def filtered_torque(self, omega: np.ndarray, rho: float, weight: np.ndarray, path: Path) -> np.ndarray:
        """rho omega + weight W (B, nv, l): what the filter of (419) makes of a step along each path.

        omega (B, nv, l), weight (nv,), of the rows; W is the mean of `torque` over the points of a path. By
        numba (extra ``fast``) in one call, without Pinocchio. Raises ArgumentError where there are friction
        columns, EladaptError without numba.
        """
        if self.n_friction:
            raise ArgumentError("friction: expected regressors without friction columns, got some")
        first, *others = self._compiled
        filtered = first.filtered(omega, rho, weight, path)
        for other in others:
            filtered = other.filtered(filtered, 1.0, weight, path)
        return filtered

    @functools.cached_property
    def positions(self) -> Positions:
        """Differences and sums of many positions at once."""
        return Positions(self.robot.model)

    @functools.cached_property
    def _compiled(self) -> list[TorqueRegressors]:
        """What adds up to W without friction."""
        if self._one_base:
            return [TorqueRegressors(self.robot, self._kinetic_map)]
        return [
            TorqueRegressors(self.robot, self._kinetic_map, weightless=True),
            TorqueRegressors(self.robot, self._potential_map, still=True),
        ]

    def slotine_li(self, q: np.ndarray, v: np.ndarray, vr: np.ndarray, ar: np.ndarray) -> np.ndarray:
        """W_r (nv, l): W_r @ theta = M ar + C(q, v) vr + g (+ friction at v where it has columns).

        The Christoffel C is symmetric, C(q, v) vr = C(q, vr) v, so it is polarised from the
        quadratic form c(v) = C(q, v) v: 4 C(q, v) vr = c(v + vr) - c(v - vr).
        """
        q, v = self.robot.check_q(q), self.robot.check_v(v)
        vr, ar = self.robot.check_v(vr, "vr"), self.robot.check_v(ar, "ar")
        kinetic = self._standard.kinetic_torque(q, (v + vr) / 2, ar)
        kinetic = kinetic - self._standard.kinetic_torque(q, (v - vr) / 2, np.zeros_like(v))
        return self._assemble(kinetic, q, v)

    def inertial_parameters(self, theta: Sequence[float] | np.ndarray) -> np.ndarray:
        """(s,) the standard parameters nearest the URDF's with the base parameters ``theta`` (l,).

        Least Euclidean change; ten a body, then the armatures. With sharing "independent",
        theta_M and theta_U may contradict each other: then in the least-squares sense.
        """
        theta = require_vector("theta", theta, len(self))
        base = (theta / self.scale)[self._inertial]
        nominal = self._standard.parameters
        projection = self.basis.projection
        change, *_ = np.linalg.lstsq(projection, base - projection @ nominal, rcond=ROUNDING)
        return nominal + change

    def _assemble(self, kinetic: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(nv, l) of a kinetic part (nv, s) in standard parameters, gravity and friction."""
        regressor = kinetic @ self._kinetic_map + self._standard.gravity(q) @ self._potential_map
        return self._add_friction(regressor, v)

    def _add_friction(self, regressor: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The regressor (nv, l), its zero friction columns filled in."""
        if self.viscous:
            regressor[..., *self._viscous_at] = v
        if self.coulomb:
            regressor[..., *self._coulomb_at] = np.sign(v)
        return regressor

    def _spread(self, columns: np.ndarray) -> np.ndarray:
        """(s, p) -> (s, l) in the units of theta, with zeros for friction."""
        spread = np.zeros((len(columns), len(self)))
        spread[:, self._inertial] = columns / self.scale[self._inertial]
        return spread

    def _friction_entries(self) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Rows and columns of the viscous and of the Coulomb friction that each joint has."""
        rows = np.arange(self.robot.nv)
        viscous = rows + self.n_inertial
        return (rows, viscous), (rows, viscous + self.robot.nv * self.viscous)


def _require_span(
    basis: ParameterBasis, nominal: np.ndarray, stacked: np.ndarray, columns: np.ndarray, what: str
) -> None:
    """The basis must reproduce the nominal torque: what it leaves out, this robot must not have."""
    if basis.projection.shape[1] != len(nominal):
        raise ArgumentError(
            f"basis: expected projection of shape (p, {len(nominal)}) for this robot's standard "
            f"parameters, got {basis.projection.shape}"
        )
    torque = stacked @ nominal
    residual = np.linalg.norm(stacked @ columns @ basis.projection @ nominal - torque)
    if residual > SPAN_TOLERANCE * np.linalg.norm(torque):
        raise ArgumentError(
            f"basis: its {what} parameters do not make up this robot's {what} torque "
            f"(relative residual {residual / np.linalg.norm(torque):.2g}, limit {SPAN_TOLERANCE:g})"
        )
