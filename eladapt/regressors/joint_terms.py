"""Joint terms: what acts on a joint beside the bodies, for every joint, whatever the URDF says of it.

"rotor": tau_i = Ir_i a_i, the motor's inertia behind the gear, a standard parameter like a body's.
"viscous": tau_i = c_i v_i. "coulomb": tau_i = f_i sign(v_i). "offset": tau_i = o_i, as of a torque sensor.
A rotor stands among the bodies, since the torque does not always tell it from them: a first joint's is
indistinguishable from its link's inertia. The others have a parameter of their own for each joint.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, UnknownNameError

JOINT_TERMS = ("rotor", "viscous", "coulomb", "offset")
# While a joint moves one way, Coulomb friction, an offset and gravity look alike. Smaller columns make the
# least-squares prior prefer gravity: from theta = 0 to a set-point, gravity is then right within 0.2 to 0.9 N
# m on a panda, within 1 to 8 N m with columns of unit RMS.
RELUCTANCE = 10.0
FRICTION_TERMS = JOINT_TERMS[1:]  # those with columns of their own, theta_F


def in_order(names: str | Iterable[str]) -> tuple[str, ...]:
    """The joint terms named, each once, in the order of `JOINT_TERMS`; a string is one name.

    Raises UnknownNameError for another name, ArgumentError for what is no names at all.
    """
    try:
        given = [names] if isinstance(names, str) else list(names)
    except TypeError:
        raise ArgumentError(f"joint_terms: expected any of {', '.join(JOINT_TERMS)}, got {names!r}") from None
    unknown = [name for name in given if name not in JOINT_TERMS]
    if unknown:
        raise UnknownNameError("joint term", unknown, JOINT_TERMS)
    return tuple(name for name in JOINT_TERMS if name in given)


def nominal(model: pin.Model, term: str) -> np.ndarray:
    """(nv,) what the URDF says: damping [N m s/rad], friction [N m], and offsets of 0."""
    if term == "offset":
        return np.zeros(model.nv)
    return np.array(model.damping if term == "viscous" else model.friction)


def column_scale(term: str, velocity: np.ndarray) -> np.ndarray:
    """(nv,) what a term's columns are divided by; velocity (samples, nv) [rad/s], over random states.

    The RMS over all rows of stacked regressors (row j of joint i's column is zero unless j = i, hence the
    division by nv), and `RELUCTANCE` times that for Coulomb friction and offset.
    """
    nv = velocity.shape[1]
    if term == "viscous":
        return np.sqrt(np.mean(velocity**2, axis=0) / nv)
    return np.full(nv, RELUCTANCE / np.sqrt(nv))
