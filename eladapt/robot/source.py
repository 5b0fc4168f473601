"""What a robot is built from, in plain JSON types, and back: for records, for other processes, for edits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eladapt.urdf.editing import Edits

if TYPE_CHECKING:
    from eladapt.robot.model import Robot


def arguments(robot: Robot) -> dict[str, Any]:
    """`Robot.from_urdf`'s, the path as "urdf", the text with a character for each byte; plain JSON types."""
    armature = {n: float(a) for n, a in zip(robot.joint_names, robot.armature, strict=True) if a}
    return {
        "urdf": str(robot.path),
        "package_dirs": list(robot.package_dirs),
        "locked": list(robot.locked),
        "name": robot.name,
        "armature": armature,
        "gravity": robot.model.gravity.linear.tolist(),
        "mend": robot.mend,
        "density": robot.density,
        "edits": robot.edits and list(robot.edits),
        "text": robot.text.decode("latin-1"),
        **beside_the_model(robot),
    }


def beside_the_model(robot: Robot) -> dict[str, Any]:
    """What makes a robot beside its dynamics; plain JSON types, to be compared."""
    return {
        "tool": robot.tool,
        "zero_parameters": list(robot.zero_parameters),
        "home": robot.home.tolist(),
        "target": robot.target.tolist(),
        "published": {name: limit.tolist() for name, limit in robot.published.items()},
    }


def with_edits(robot: Robot, edits: Edits) -> dict[str, Any]:
    """The `arguments` of the same robot with other inertias, friction and rotors, see `Robot.edited`."""
    before = robot.edits or Edits()
    weighed = {link: body.toDynamicParameters().tolist() for link, body in robot.weighed.items()}
    joints = {**before.dynamics, **edits.dynamics}
    merged = Edits(
        {**weighed, **before.inertials, **edits.inertials},
        {name: {**before.dynamics.get(name, {}), **edits.dynamics.get(name, {})} for name in joints},
    )
    given = {name for name, values in merged.dynamics.items() if "armature" in values}
    source = arguments(robot)
    armature = {name: inertia for name, inertia in source["armature"].items() if name not in given}
    return {**source, "edits": merged, "density": None, "armature": armature}
