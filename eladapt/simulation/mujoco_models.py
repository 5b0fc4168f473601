"""What MuJoCo simulates: the robot's own URDF, or another's MJCF of the same arm, and the load on it.

Shapes, limits and the couplings of locked joints, which the dynamics do not need, are left out of the URDF.
An MJCF is taken as it is, but for limits, contacts and actuators.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin

from eladapt.errors import ArgumentError, Finding, UrdfError
from eladapt.robot.model import Robot
from eladapt.robot.postures import turning
from eladapt.robot.reading import frame_index
from eladapt.simulation.alignment import point_in_body
from eladapt.simulation.disturbances import Payload

COMPILER = {"discardvisual": "true", "fusestatic": "false", "balanceinertia": "false"}
SHAPES = ("visual", "collision")
LIMITS = ("limit", "mimic", "safety_controller")
DISABLED = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_LIMIT
    | mujoco.mjtDisableBit.mjDSBL_ACTUATION  # torques are applied to the joints themselves
    | mujoco.mjtDisableBit.mjDSBL_AUTORESET  # what diverges is an error, not a fresh start
)
FRICTION_SWEEPS, TOLERANCE = 50, 1e-14


class Models(NamedTuple):
    """The compiled arm without and with its load, each a model of its own: attaching the load switches."""

    bare: mujoco.MjModel
    loaded: mujoco.MjModel
    joint_ids: np.ndarray  # (nv,) the robot's joints in both


def urdf_models(robot: Robot, payload: Payload | None) -> Models:
    """The robot as MuJoCo reads its URDF. Raises UrdfError when MuJoCo refuses it."""
    try:
        spec = _specification(robot)
        bare = loaded = _compiled(spec)
        joint_ids = np.array([bare.joint(name).id for name in robot.joint_names])
        if payload is not None:
            frame = robot.model.frames[frame_index(robot.model, payload.frame or robot.tool)]
            if frame.parentJoint:
                place = frame.placement.act(np.asarray(payload.com, dtype=float))
                _attach(spec.joint(robot.model.names[frame.parentJoint]).parent, place, payload.mass)
                loaded = _compiled(spec)
    except ValueError as reason:
        said, remedy = " ".join(str(reason).split()), "Mend it, or simulate it with PinocchioPlant"
        raise UrdfError(robot.path, [Finding("file", said, "MuJoCo refused it", remedy)]) from reason
    return Models(bare, loaded, joint_ids)


def mjcf_models(robot: Robot, mjcf: str, payload: Payload | None) -> Models:
    """Another's model of the robot: a path, or MJCF text. Raises ArgumentError, with MuJoCo's reason."""
    spec, where = _foreign(mjcf)
    try:
        bare = loaded = _compiled(spec)
    except ValueError as reason:
        raise _unloadable(where, reason) from reason
    joint_ids = _matched(robot, bare, where)
    if payload is not None:
        frame = robot.model.frames[frame_index(robot.model, payload.frame or robot.tool)]
        if joint := frame.parentJoint:  # else it stands on the base
            point = frame.placement.act(np.asarray(payload.com, dtype=float))
            place = point_in_body(robot, joint, point, bare, joint_ids)
            carrier = bare.jnt_bodyid[joint_ids[robot.model.idx_vs[joint]]]
            _attach(next(body for body in spec.bodies if body.id == carrier), place, payload.mass)
            loaded = _compiled(spec)
    return Models(bare, loaded, joint_ids)


def _foreign(mjcf: str) -> tuple[mujoco.MjSpec, str]:
    """The specification, and what messages call it."""
    if mjcf.lstrip().startswith("<"):
        where, read, given = "the MJCF text", mujoco.MjSpec.from_string, mjcf
    else:
        where, read, given = mjcf, mujoco.MjSpec.from_file, mjcf
        if not Path(mjcf).is_file():
            problem = "is not a file" if Path(mjcf).exists() else "does not exist"
            raise ArgumentError(f"mjcf: {mjcf} {problem}; expected the path of an MJCF file, or its text")
    try:
        return read(given), where
    except ValueError as reason:
        raise _unloadable(where, reason) from reason


def _unloadable(where: str, reason: Exception) -> ArgumentError:
    return ArgumentError(f"mjcf: MuJoCo does not load {where}: {' '.join(str(reason).split())}")


def _matched(robot: Robot, model: mujoco.MjModel, where: str) -> np.ndarray:
    """(nv,) the robot's joints in another's model: by name where names agree, the others in order."""
    names = [model.joint(k).name for k in range(model.njnt)]
    if len(names) != robot.nv:
        shown = ", ".join(name or "(no name)" for name in names) or "none"
        raise ArgumentError(
            f"mjcf: {where} has {len(names)} joints ({shown}), expected the robot's {robot.nv} "
            f"({', '.join(robot.joint_names)}); remove what is not the arm, or lock joints of the robot"
        )
    rest = iter([k for k, name in enumerate(names) if name not in robot.joint_names])
    found = np.array([names.index(name) if name in names else next(rest) for name in robot.joint_names])
    for name, hinge, k in zip(robot.joint_names, turning(robot), found, strict=True):
        expected = mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE
        if model.jnt_type[k] != expected:
            raise ArgumentError(
                f"mjcf: joint {names[k] or k!r} of {where} is of another kind than the robot's {name!r}; "
                f"expected a {'hinge' if hinge else 'slide'}"
            )
    return found


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model, with what the dynamics of joints alone need."""
    spec.option.disableflags |= int(DISABLED)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # RK4 is called by name
    spec.option.noslip_iterations, spec.option.noslip_tolerance = FRICTION_SWEEPS, TOLERANCE
    spec.option.tolerance = TOLERANCE
    return spec.compile()


def _specification(robot: Robot) -> mujoco.MjSpec:
    """The URDF as MuJoCo reads it: no shapes, no limits, locked joints welded where the robot has them."""
    urdf = ElementTree.Element("robot", name=robot.model.name)
    ElementTree.SubElement(ElementTree.SubElement(urdf, "mujoco"), "compiler", COMPILER)
    for element in robot.document():
        if element.tag not in ("link", "joint"):
            continue
        for child in list(element):
            if child.tag in (*SHAPES, *LIMITS):
                element.remove(child)
        if element.get("name") in robot.locked and element.tag == "joint":
            element.set("type", "fixed")
        elif element.get("type") == "revolute":
            element.set("type", "continuous")  # the same joint without limits
        urdf.append(element)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(urdf, "unicode"))
    for element in urdf.findall("joint"):
        if element.get("name") in robot.locked:
            _weld(spec, robot.model, element)
    for name, armature in zip(robot.joint_names, robot.armature, strict=True):
        spec.joint(name).armature = armature
    spec.option.gravity = robot.model.gravity.linear
    return spec


def _weld(spec: mujoco.MjSpec, model: pin.Model, joint: ElementTree.Element) -> None:
    """Put the child link of a locked joint where it is in the robot's model."""
    ends = {end: joint.find(end).get("link", "") for end in ("parent", "child")}  # type: ignore[union-attr]
    parent, child = (model.frames[frame_index(model, ends[end])].placement for end in ("parent", "child"))
    place = parent.actInv(child)
    body, quaternion = spec.body(ends["child"]), pin.Quaternion(place.rotation)
    body.pos = place.translation
    body.quat = [quaternion.w, quaternion.x, quaternion.y, quaternion.z]


def _attach(carrier: mujoco.MjsBody, place: np.ndarray, mass: float) -> None:
    """A point mass, fixed to a body at a place (3,) in its frame."""
    carrier.add_body(pos=place, mass=mass, ipos=[0, 0, 0], inertia=[0, 0, 0], explicitinertial=True)
