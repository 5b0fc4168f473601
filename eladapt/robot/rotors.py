"""Rotors that a URDF says nothing of, where an arm cannot do without them."""

from __future__ import annotations

import math

import pinocchio as pin

from eladapt.urdf.checks import idle_joints

# [rad/s^2] by which an effort limit turns the rotor that is assumed: 0.03 kg m^2 in a Panda's wrist.
ASSUMED_ROTOR_ACCELERATION = 400.0


def assume_rotors(model: pin.Model) -> list[str]:
    """Give joints that turn no inertia the rotor of a motor of their effort, in place; a line for each.

    A last link whose moments a file leaves at 0 has no inertia about its axis, and any torque would turn it
    infinitely fast; the motor's rotor is what there is. A joint without an effort limit is left as it is.
    """
    told = []
    for k, diagonal in idle_joints(model).items():
        effort = model.upperEffortLimit[k]
        if 0 < effort < math.inf:
            model.armature[k] = effort / ASSUMED_ROTOR_ACCELERATION
            name = model.names[1 + k]
            told.append(
                f"joint {name!r}: its links have {diagonal:.2g} kg m^2 about its axis; assumed a rotor of "
                f"{model.armature[k]:.3g} kg m^2, which {effort:g} N m turn at "
                f"{ASSUMED_ROTOR_ACCELERATION:g} rad/s^2. "
                f"Give the true one: armature={{{name!r}: ...}}"
            )
    return told
