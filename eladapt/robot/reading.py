"""From a URDF, as it was checked, to a Pinocchio model with the joints that are wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from eladapt.errors import UnknownNameError, UrdfError, require_gain
from eladapt.robot import library

LINK = "\x1f"  # after a name: a character that no XML file can have
PUBLISHED = ("velocity", "acceleration", "jerk", "torque_rate")  # [rad/s, rad/s^2, rad/s^3, N m/s]


def frame_index(model: pin.Model, name: str) -> int:
    """Index of a frame by name; of a link where a joint has the same name. Raises UnknownNameError."""
    found = [k for k, frame in enumerate(model.frames) if frame.name == name]
    if not found:
        raise UnknownNameError("frame", [name], [frame.name for frame in model.frames])
    bodies = [k for k in found if model.frames[k].type == pin.FrameType.BODY]
    return (bodies or found)[0]


def read_model(document: Element, path: Path) -> pin.Model:
    """Pinocchio's model of the document as it was checked, not of what another parser makes of it."""
    try:
        return pin.buildModelFromXML(ElementTree.tostring(document, "unicode"))
    except (RuntimeError, ValueError) as reason:
        raise UrdfError(path, [library.unreadable(reason)]) from reason


def published_limits(given: Mapping[str, Sequence[float] | np.ndarray], nv: int) -> dict[str, np.ndarray]:
    """A maker's limits by name, (nv,) each. Raises UnknownNameError, ArgumentError."""
    if unknown := [name for name in given if name not in PUBLISHED]:
        raise UnknownNameError("published limit", unknown, PUBLISHED)
    return {name: require_gain(f"published {name}", values, nv) for name, values in given.items()}


def lock(
    full: pin.Model, names: Sequence[str], shapes: pin.GeometryModel | None = None
) -> tuple[pin.Model, pin.GeometryModel | None]:
    """The model with these joints fixed at their neutral position, clipped to their limits, and its shapes.

    Pinocchio finds the frames of joints by name, and refuses a name that a link has too: meanwhile links
    have another one.
    """
    ids = [full.getJointId(name) for name in names if full.existJointName(name)]  # the others are fixed
    if not ids:
        return full, shapes
    full = full.copy()
    for frame in full.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name += LINK
    reduced, kept = pin.buildReducedModel(full, shapes or pin.GeometryModel(), ids, clipped_neutral(full))
    for frame in reduced.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name = frame.name.removesuffix(LINK)
    return reduced, kept if shapes else None


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
