"""From a URDF to a Pinocchio model with the joints that are wanted, and to its shapes."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from eladapt.errors import (
    AssumedWarning,
    MendedWarning,
    UnitsWarning,
    UnknownNameError,
    UrdfError,
    require_vector,
)
from eladapt.robot import library
from eladapt.robot.joint_limits import clipped_neutral, too_heavy
from eladapt.robot.rotors import assume_rotors
from eladapt.urdf.assets import MeshUse, set_meshes_aside
from eladapt.urdf.checks import Checked, check_model, check_urdf, read_urdf
from eladapt.urdf.editing import Edits
from eladapt.urdf.holding import hold
from eladapt.urdf.mending import mend as mended
from eladapt.urdf.sizes import misplaced_masses
from eladapt.urdf.tree import MOVING, child_value
from eladapt.urdf.weighing import add_inertials, weigh

LINK = "\x1f"  # after a name: a character that no XML file can have


class Read(NamedTuple):
    """What a URDF became."""

    model: pin.Model
    locked: tuple[str, ...]  # the joints that are held
    weighed: dict[str, pin.Inertia]  # links that were weighed by their shapes, each in its own frame


def read_robot(
    path: Path,
    package_dirs: Sequence[str | Path],
    locked: Iterable[str],
    *,
    armature: Mapping[str, float],
    gravity: Sequence[float] | np.ndarray | None,
    mend: bool,
    density: float | None,
    text: bytes,
    edits: Edits | None = None,
) -> Read:
    """The model of a file with this text, checked before and after Pinocchio read it; see `Robot.from_urdf`.

    What was mended or assumed, and what looks like other units, is warned of where `Robot.from_urdf` was
    called.
    """
    checked, weighed = check_urdf(path, locked, edits, text), {}
    if density is not None:
        weighed = weigh(checked.root, checked.locked, density, path, package_dirs)
        add_inertials(checked.root, weighed)
    model, _ = lock(read_model(checked.root, path), checked.locked)
    for joint, inertia in {**_rotors(checked), **armature}.items():
        model.armature[velocity_index(model, joint)] = inertia
    if gravity is not None:
        model.gravity = pin.Motion(require_vector("gravity", gravity, 3), np.zeros(3))
    for change in mended(model) if mend else ():
        warnings.warn(f"{path.name}, mended: {change}", MendedWarning, stacklevel=3)
    for rotor in assume_rotors(model):
        warnings.warn(f"{path.name}: {rotor}", AssumedWarning, stacklevel=3)
    check_model(model, path)
    for told in (*misplaced_masses(checked.root, checked.locked), *too_heavy(model)):
        warnings.warn(f"{path.name}: {told}", UnitsWarning, stacklevel=3)
    return Read(model, checked.locked, weighed)


def _rotors(checked: Checked) -> dict[str, float]:
    """Rotor inertias [kg m^2] that the file itself gives, by joint: <dynamics armature="...">."""
    given = {
        joint.get("name", ""): child_value(joint, "dynamics", "armature", "")
        for joint in checked.root.findall("joint")
        if joint.get("type") in MOVING and joint.get("name", "") not in checked.locked
    }
    return {name: float(text) for name, text in given.items() if text}


def read_document(
    path: Path,
    locked: Sequence[str],
    weighed: Mapping[str, pin.Inertia],
    edits: Edits | None,
    text: bytes,
) -> Element:
    """The <robot> element of a file read before, with the same edits, joints held and links weighed."""
    root = read_urdf(path, edits, text)
    hold(root, locked)
    add_inertials(root, weighed)
    return root


def read_visuals(
    document: Element, path: Path, locked: Sequence[str]
) -> tuple[pin.GeometryModel, dict[str, MeshUse]]:
    """The visuals of a document, whose meshes become boxes, and those meshes by the names of their shapes."""
    uses = set_meshes_aside(document)
    full = read_model(document, path)
    try:
        visuals = pin.buildGeomFromUrdfString(full, ElementTree.tostring(document, "unicode"), pin.VISUAL)
    except ValueError as reason:
        raise UrdfError(path, [library.unreadable(reason)]) from reason
    return lock(full, locked, visuals)[1], uses


def read_model(document: Element, path: Path) -> pin.Model:
    """Pinocchio's model of the document as it was checked, not of what another parser makes of it."""
    try:
        return pin.buildModelFromXML(ElementTree.tostring(document, "unicode"))
    except (RuntimeError, ValueError) as reason:
        raise UrdfError(path, [library.unreadable(reason)]) from reason


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


def frame_index(model: pin.Model, name: str) -> int:
    """Index of a frame by name; of a link where a joint has the same name. Raises UnknownNameError."""
    found = [k for k, frame in enumerate(model.frames) if frame.name == name]
    if not found:
        raise UnknownNameError("frame", [name], [frame.name for frame in model.frames])
    bodies = [k for k in found if model.frames[k].type == pin.FrameType.BODY]
    return (bodies or found)[0]


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
