"""Every regressor of adaptive control, in base parameters theta = [theta_M, theta_F, theta_U]."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
import pinocchio as pin

from eladapt.compiling import prepare
from eladapt.errors import ArgumentError, UnknownNameError, require_vector
from eladapt.regressors import joint_terms as terms
from eladapt.regressors.base import ROUNDING, ParameterBasis, independent_basis, sample, shared_basis
from eladapt.regressors.projection import Columns, project
from eladapt.regressors.standard import StandardRegressors
from eladapt.robot.model import Robot

SPAN_TOLERANCE = 1e-9  # relative; a basis of one's own must reproduce the torque this well


class Regressors:
    """Turns a robot into regressors W(q, v, a) with W @ theta = tau. Threads may share them.

    theta = [theta_M, theta_F, theta_U]: what only the motion sees of bodies and rotors; viscous friction,
    Coulomb friction and torque offsets, nv each; what gravity sees.

    sharing: "shared" uses one base for motion and gravity, [complement; gravity base];
        "independent" gives theta_M and theta_U no parameter in common, as the paper has it (250).
    joint_terms: any of "rotor", "viscous", "coulomb", "offset" (one name, or several in any order), each for
        every joint whatever the URDF says of it; see `eladapt.regressors.joint_terms`. Nominal values are the
        URDF's armature, damping and friction, and offsets of 0. Without "rotor" only the joints to which
        the model gives an armature have a rotor.
    basis: a ParameterBasis of one's own; it fixes the units too, and must reproduce the robot's
        nominal torque (what it leaves out, such as masses off a centre line, the robot must not have).
    scaled: columns have unit RMS over random states, so every parameter is the torque [N m] that
        it typically makes and one gain serves them all: theta = scale * physical parameters. Without it,
        and always with a basis of one's own, ``scale`` is 1.

    Attributes: robot, sharing, basis; ``joint_terms`` in the order above; ``viscous``, ``coulomb``,
    ``offset``: whether theta_F has them (`block` says where); ``n_inertial``, ``n_friction``,
    ``n_potential``: the sizes of theta_M, theta_F, theta_U; ``scale`` (l,). `coulomb_speed` [rad/s]: over
    which speed `slotine_li` turns Coulomb friction round.

    Raises ArgumentError for an unknown sharing, or a basis that does not span the regressors;
    UnknownNameError for an unknown joint term. Warns (RankWarning) when the rank of the base is not clear;
    ``rank_gap`` has the figure.
    """

    coulomb_speed = 0.001

    def __init__(
        self,
        robot: Robot,
        sharing: Literal["shared", "independent"] = "shared",
        joint_terms: str | Iterable[str] = (),
        basis: ParameterBasis | None = None,
        *,
        scaled: bool = True,
    ):
        if sharing not in ("shared", "independent"):
            raise ArgumentError(f"sharing: expected 'shared' or 'independent', got {sharing!r}")
        prepare()
        self.robot, self.sharing = robot, sharing
        self.joint_terms = terms.in_order(joint_terms)
        self.viscous, self.coulomb, self.offset = (name in self.joint_terms for name in terms.FRICTION_TERMS)
        self._friction_terms = tuple(name for name in terms.FRICTION_TERMS if name in self.joint_terms)
        self._standard = StandardRegressors(robot, every_rotor="rotor" in self.joint_terms)
        self._still = np.zeros(robot.nv)  # writable, unlike robot.still: another type to the kernel
        samples = sample(self._standard)
        # In a base shared by motion and gravity one product makes both.
        self._own = basis is not None
        self._one_base = not self._own and sharing == "shared"
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
        self.n_friction = robot.nv * len(self._friction_terms)
        self.scale = np.ones(p + self.n_friction)  # theta = scale * physical base parameters
        if scaled:
            torque = samples.kinetic @ basis.kinetic + samples.gravity @ basis.potential
            self.scale[self.inertial] = np.sqrt(np.mean(torque**2, axis=0))
            for name in self._friction_terms:
                self.scale[self.block(name)] = terms.column_scale(name, samples.velocity)
        # From standard parameters to theta (s, l), with zeros for friction; as dense arrays for the energy.
        self._kinetic_map = self._spread(basis.kinetic)
        self._potential_map = self._spread(basis.potential)
        self._torque_columns = self._columns(self._kinetic_map, joint_columns=True)
        self._kinetic_columns = self._columns(self._kinetic_map)
        self._potential_columns = self._columns(self._potential_map)
        self._gravity_columns = self._columns(self._potential_map[:, len(self) - self.n_potential :])

    def __repr__(self) -> str:
        base = "own basis" if self._own else f"sharing={self.sharing!r}"
        sizes = f"{self.n_inertial} inertial + {self.n_friction} friction + {self.n_potential} potential"
        return (
            f"Regressors({self.robot.name}, {base}, joint_terms={self.joint_terms})\n"
            f"    l = {len(self)} parameters = {sizes}"
        )

    @property
    def robot_parameters(self) -> np.ndarray:
        """(s,) the URDF's standard parameters: ten a body, then the rotors."""
        return self._standard.parameters

    @property
    def rotor_joints(self) -> np.ndarray:
        """The joints whose rotors stand behind the bodies in the standard parameters."""
        return self._standard.rotors

    @property
    def rank_gap(self) -> float:
        """By which factor the singular values drop behind the rank of the base."""
        return self.basis.rank_gap

    @property
    def inertial(self) -> np.ndarray:
        """Where the p base parameters stand in theta: all but the friction block."""
        return np.r_[0 : self.n_inertial, self.n_inertial + self.n_friction : len(self)]

    def __len__(self) -> int:
        return self.n_inertial + self.n_friction + self.n_potential

    @property
    def theta(self) -> np.ndarray:
        """(l,) the nominal parameters, those of the URDF."""
        return self.theta_of(self.robot.model)

    def block(self, name: str) -> slice:
        """Where "viscous", "coulomb" or "offset" stands in theta: nv parameters, or none if not asked for.

        Raises UnknownNameError for another name. Rotors have no place of their own: they are combined with
        the bodies, see ``labels``.
        """
        if name not in terms.FRICTION_TERMS:
            raise UnknownNameError("block", [name], terms.FRICTION_TERMS)
        return self._blocks[name]

    @functools.cached_property
    def _blocks(self) -> dict[str, slice]:
        blocks, start = {}, self.n_inertial
        for name in terms.FRICTION_TERMS:
            blocks[name] = slice(start, start + self.robot.nv * (name in self.joint_terms))
            start = blocks[name].stop
        return blocks

    @functools.cached_property
    def friction(self) -> slice:
        """Where theta_F stands in theta: viscous and Coulomb friction and offsets."""
        return slice(self.n_inertial, self.n_inertial + self.n_friction)

    def theta_of(self, model: pin.Model) -> np.ndarray:
        """(l,) the parameters of another model of the same arm, as one with a load is: its bodies, rotors
        (armature), damping and friction; no offsets. Raises ArgumentError for a model with other joints."""
        if list(model.names) != list(self.robot.model.names):
            raise ArgumentError(
                f"model: expected the joints {list(self.robot.model.names)}, got {list(model.names)}"
            )
        theta = np.empty(len(self))
        theta[self.inertial] = self.basis.projection @ self._standard.parameters_of(model)
        for name in self._friction_terms:
            theta[self.block(name)] = terms.nominal(model, name)
        return self.scale * theta

    @property
    def theta_potential(self) -> np.ndarray:
        """(n_potential,) theta_U, the nominal gravity parameters."""
        return self.theta[len(self) - self.n_potential :]

    @property
    def names(self) -> tuple[str, ...]:
        """l names, in the order of theta, without its units."""
        friction = [f"{name}({joint})" for name in self._friction_terms for joint in self.robot.joint_names]
        names = list(self.basis.labels)
        names[self.n_inertial : self.n_inertial] = friction
        return tuple(names)

    @property
    def labels(self) -> tuple[str, ...]:
        """``names`` with the column scale as a factor before each, where it is not 1."""
        named = zip(self.names, self.scale, strict=True)
        return tuple(name if scale == 1 else f"{scale:.3g} ({name})" for name, scale in named)

    def gravity(self, q: np.ndarray, *, check: bool = True) -> np.ndarray:
        """Psi(q) (nv, n_potential): Psi @ theta_U = g(q) (209). check: whether q is to be validated."""
        return self._gravity(self.robot.check_q(q) if check else q, self._gravity_columns)

    def momentum(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """[M_k(q) v]_k (nv, l): varphi_3 of (419), the torque of the acceleration v from rest."""
        q, v, still = self.robot.check_q(q), self.robot.check_v(v), self._still
        bodies = self._standard.bodies(q, still, v, weight=False)
        return project(bodies, v, still, 0.0, *self._kinetic_columns)

    def kinetic_gradient(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """[1/2 grad_q v' M_k v]_k = [C_k' v]_k (nv, l), of (401)."""
        q, v, still = self.robot.check_q(q), self.robot.check_v(v), self._still
        return project(self._standard.kinetic_gradient(q, v), still, still, 0.0, *self._kinetic_columns)

    def potential_gradient(self, q: np.ndarray) -> np.ndarray:
        """[grad U_k]_k (nv, l): varphi_2 of (419), zero but for theta_U."""
        return self._gravity(self.robot.check_q(q), self._potential_columns)

    def joint_torque(self, v: np.ndarray) -> np.ndarray:
        """[diag(v), diag(sign v), identity] in the columns of theta_F (nv, l), zero elsewhere."""
        v, nothing = self.robot.check_v(v), np.zeros((self.robot.nv, self._standard.n_body_parameters))
        return project(nothing, self._still, v, 0.0, *self._torque_columns)

    def energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """omega(q, v) (l,): omega @ theta = kinetic + potential energy, up to a constant (Omega)."""
        q, v = self.robot.check_q(q), self.robot.check_v(v)
        kinetic = self._standard.kinetic_energy(q, v) @ self._kinetic_map
        return kinetic + self._standard.potential_energy(q) @ self._potential_map

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, *, check: bool = True) -> np.ndarray:
        """W (nv, l): W @ theta = M a + C v + g + friction + offsets, rotors included.

        check: whether the arguments are to be validated.
        """
        if check:
            q, v, a = self.robot.check_q(q), self.robot.check_v(v), self.robot.check_v(a, "a")
        bodies = self._standard.bodies(q, v, a, weight=self._one_base)
        regressor = project(bodies, a, v, 0.0, *self._torque_columns)
        return regressor if self._one_base else regressor + self._gravity(q, self._potential_columns)

    def slotine_li(
        self, q: np.ndarray, v: np.ndarray, vr: np.ndarray, ar: np.ndarray, *, check: bool = True
    ) -> np.ndarray:
        """W_r (nv, l): W_r @ theta = M ar + C(q, v) vr + g + the joint terms at vr, for feed-forward.

        The Christoffel C is symmetric, C(q, v) vr = C(q, vr) v, so it is polarised from the
        quadratic form c(v) = C(q, v) v: 4 C(q, v) vr = c(v + vr) - c(v - vr). Coulomb friction stands as
        diag(tanh(vr / coulomb_speed)). With vr = ar = 0 only gravity and the offsets are left.

        check: whether the arguments are to be validated.
        """
        if check:
            q, v = self.robot.check_q(q), self.robot.check_v(v)
            vr, ar = self.robot.check_v(vr, "vr"), self.robot.check_v(ar, "ar")
        bodies, still, one_base = self._standard.bodies, self._still, self._one_base
        if np.count_nonzero(vr) or np.count_nonzero(ar) or not one_base:
            difference = bodies(q, (v + vr) / 2, ar, weight=one_base)
            difference -= bodies(q, (v - vr) / 2, still, weight=False)
        else:
            difference = bodies(q, still, still)
        regressor = project(difference, ar, vr, self.coulomb_speed, *self._torque_columns)
        return regressor if one_base else regressor + self._gravity(q, self._potential_columns)

    def inertial_parameters(self, theta: Sequence[float] | np.ndarray) -> np.ndarray:
        """(s,) the standard parameters nearest the URDF's with the base parameters ``theta`` (l,).

        Least Euclidean change; ten a body, then the rotors; friction and offsets are not looked at. With
        sharing "independent", theta_M and theta_U may contradict each other: then in the least-squares sense.
        """
        theta = require_vector("theta", theta, len(self))
        base = (theta / self.scale)[self.inertial]
        nominal = self._standard.parameters
        projection = self.basis.projection
        change, *_ = np.linalg.lstsq(projection, base - projection @ nominal, rcond=ROUNDING)
        return nominal + change

    def _gravity(self, q: np.ndarray, to: Columns) -> np.ndarray:
        """The regressor of g in the columns ``to``; the torque at rest."""
        still = self._still
        return project(self._standard.bodies(q, still, still), still, still, 0.0, *to)

    def _spread(self, columns: np.ndarray) -> np.ndarray:
        """(s, p) -> (s, l) in the units of theta, with zeros for friction."""
        spread = np.zeros((len(columns), len(self)))
        spread[:, self.inertial] = columns / self.scale[self.inertial]
        return spread

    def _columns(self, columns: np.ndarray, *, joint_columns: bool = False) -> Columns:
        """A map (s, .) as the kernel reads it, with or without what theta_F is multiplied by."""
        row, column = np.nonzero(columns)
        bodies = np.arange(self._standard.n_body_parameters)
        place = np.append(bodies, len(bodies) + self._standard.rotors)
        first, size = np.full(3, -1), np.zeros((3, self.robot.nv))
        if joint_columns:
            for k, name in enumerate(terms.FRICTION_TERMS):
                if name in self.joint_terms:
                    first[k], size[k] = self.block(name).start, 1 / self.scale[self.block(name)]
        return Columns(np.array([place[row], column]), columns[row, column], first, size, columns.shape[1])


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
