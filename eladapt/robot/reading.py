"""From a URDF, as it was checked, to a Pinocchio model with the joints that are wanted."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from eladapt.errors import UnknownNameError, UrdfError, require_gain
from eladapt.robot import library
from eladapt.urdf.checks import coupled_joints, read_urdf

MIMIC = "mimic"
PUBLISHED = ("velocity", "acceleration", "jerk", "torque_rate")  # [rad/s, rad/s^2, rad/s^3, N m/s]


def frame_index(model: pin.Model, name: str) -> int:
    """Index of a frame by name; of a link where a joint has the same name. Raises UnknownNameError."""
    found = [k for k, frame in enumerate(model.frames) if frame.name == name]
    if not found:
        raise UnknownNameError("frame", [name], [frame.name for frame in model.frames])
    bodies = [k for k in found if model.frames[k].type == pin.FrameType.BODY]
    return (bodies or found)[0]


def read_model(path: Path) -> pin.Model:
    """Pinocchio's model of the document as it was checked, not of what another parser makes of it."""
    try:
        return pin.buildModelFromXML(ElementTree.tostring(read_urdf(path), "unicode"))
    except (RuntimeError, ValueError) as reason:
        raise UrdfError(path, [library.unreadable(reason)]) from reason


def matching_joints(model: pin.Model, patterns: Iterable[str]) -> list[str]:
    """The joints named, in the model's order; in what is no joint's name ``*`` matches any characters.

    Raises UnknownNameError.
    """
    if isinstance(patterns, str):
        patterns = (patterns,)
    chosen: set[str] = set()
    names, unknown = list(model.names)[1:], []
    for pattern in patterns:
        found = [pattern] if pattern in names else fnmatch.filter(names, pattern)
        chosen.update(found)
        if not found:
            unknown.append(pattern)
    if unknown:
        raise UnknownNameError("joint", unknown, names)
    return [name for name in names if name in chosen]


def coupled_too(path: Path, locked: Iterable[str], model: pin.Model) -> list[str]:
    """What is to be locked, with "mimic" standing for all joints that follow another one."""
    given = [locked] if isinstance(locked, str) else list(locked)
    if MIMIC not in given or model.existJointName(MIMIC):
        return given
    return [name for name in given if name != MIMIC] + list(coupled_joints(path))


def published_limits(given: Mapping[str, Sequence[float] | np.ndarray], nv: int) -> dict[str, np.ndarray]:
    """A maker's limits by name, (nv,) each. Raises UnknownNameError, ArgumentError."""
    if unknown := [name for name in given if name not in PUBLISHED]:
        raise UnknownNameError("published limit", unknown, PUBLISHED)
    return {name: require_gain(f"published {name}", values, nv) for name, values in given.items()}


def lock(full: pin.Model, names: Sequence[str]) -> pin.Model:
    """The model with these joints fixed at their neutral position, clipped to their limits."""
    if not names:
        return full
    return pin.buildReducedModel(full, [full.getJointId(name) for name in names], clipped_neutral(full))


def clipped_neutral(model: pin.Model) -> np.ndarray:
    """The neutral configuration, with the joints whose limits exclude it at the nearest limit."""
    q = pin.neutral(model)
    for joint in range(1, model.njoints):
        k = model.idx_qs[joint]
        low, high = model.lowerPositionLimit[k], model.upperPositionLimit[k]
        if model.nqs[joint] == 1 and low < high:
            q[k] = np.clip(q[k], low, high)
    return q


def last_body(model: pin.Model) -> str:
    """The last link that moves with the last joint."""
    last = model.njoints - 1
    bodies = [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == last]
    return bodies[-1]


def velocity_index(model: pin.Model, joint: str) -> int:
    """Where a joint stands in vectors of size nv. Raises UnknownNameError."""
    if not model.existJointName(joint):
        raise UnknownNameError("joint", [joint], list(model.names)[1:])
    return model.idx_vs[model.getJointId(joint)]
