"""What a URDF must satisfy before Pinocchio reads it, and what its model must satisfy after.

Pinocchio's reader drops what it cannot use and says so on stderr only: a mass of "1,5" makes a link
without inertia, a joint that closes a loop disappears. So the file is checked first, and all its faults
are reported at once. What only whole bodies show (links on fixed joints are one body) is checked on
the model.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError

import numpy as np
import pinocchio as pin
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

from eladapt.errors import Finding, UrdfError
from eladapt.urdf.editing import Edits, edited
from eladapt.urdf.holding import held_joints, hold
from eladapt.urdf.numbers import NUMBERS, number_findings, parts
from eladapt.urdf.tree import joints, listed, mimics, names, tree

# Published robots reach 0.2 MB, depth 7 and 129 joints. Pinocchio's reader recurses along a chain and kills
# the process at the end of the stack: measured between 200 and 250 joints on 512 KiB (a thread's, on some
# systems), between 3000 and 4000 on 8 MiB.
MAX_BYTES = 5_000_000
MAX_DEPTH = 32
MAX_ELEMENTS = 50_000  # the largest published robot has 2,500; 5 MB of empty ones would take 0.4 GB
MAX_JOINTS = 200
DECLARATION = re.compile(rb"""\s*<\?xml[^>]*encoding=["']([-\w.]+)["'][^>]*\?>""")
WRITTEN = (b"gb", b"big5", b"shift", b"sjis", b"euc", b"iso-", b"iso2022", b"cp", b"windows-", b"koi8")
MACROS = ("property", "include", "macro")  # of xacro when it had no prefix

# Published links lie on the very boundary of the physical (rods without width, point masses): allow rounding.
INERTIA_TOLERANCE = 1e-9  # of the largest principal moment
LEAST_GYRATION = 1e-6  # [m] a radius of gyration below this is none
# The mass matrix, scaled to unit diagonal, of published arms stays above 0.008 over 200 postures.
SINGULAR = 1e-9
POSTURES = 50


def read_urdf(path: str | Path, edits: Edits | None = None, text: bytes | None = None) -> Element:
    """The <robot> element of a file from outside, read without entities and within bounds of size.

    edits: what of it is to be another than in the file. text: what `read_bytes` read of it before; then the
    file itself need not be there any more.

    Raises UrdfError for what is not a file, not XML, not a <robot>, or too large for a reader.
    """
    path = Path(path)
    text = read_bytes(path) if text is None else text
    root = _parse_xml(path, edited_urdf(path, edits, text) if edits else text)
    for element in root.iter():
        for held in NUMBERS.get(element.tag, ()):  # blanks around numbers, tabs between, that others read
            if (given := element.get(held.attribute)) is not None:
                element.set(held.attribute, " ".join(given.split()))
    if root.tag != "robot":
        raise _refusal(path, "root element", f"<{root.tag}>", "expected <robot>", "Convert the file to URDF")
    for tag, most in (("joint", MAX_JOINTS), ("link", MAX_JOINTS + 1)):
        if (number := len(root.findall(tag))) > most:
            remedy = "Leave out what the arm does not need"
            raise _refusal(path, "<robot>", f"{number} {tag}s", f"expected at most {most}", remedy)
    return root


def edited_urdf(path: str | Path, edits: Edits, text: bytes) -> bytes:
    """The text of a file, with these edits and otherwise as it is.

    Raises UrdfError as `read_urdf`, and what `edited` raises.
    """
    _parse_xml(Path(path), text)
    return edited(_as_utf8(text), edits)


class Checked(NamedTuple):
    """A robot file that was found sound: its <robot> element, and the joints in it that are held."""

    root: Element
    locked: tuple[str, ...]


def check_urdf(
    path: str | Path, locked: Iterable[str] = (), edits: Edits | None = None, text: bytes | None = None
) -> Checked:
    """Refuse a URDF that is not a fixed-base tree of 1-DoF joints with finite numbers throughout.

    ``locked`` names the joints that are held, see `held_joints`; they are judged as such, and the element
    that is returned has them as `hold` leaves them. Raises UnknownNameError, and UrdfError with every fault
    found; each names the element, the value and what to do. text: as in `read_urdf`.
    """
    root = read_urdf(path, edits, text)
    if unexpanded := list(_unexpanded(root)):  # what else such a file holds is not what it will hold
        raise UrdfError(path, unexpanded)
    held = held_joints(root, locked)
    hold(root, held)
    findings = [*names(root), *joints(root), *tree(root), *mimics(root), *number_findings(root)]
    if findings:
        raise UrdfError(path, findings)
    return Checked(root, held)


def check_model(model: pin.Model, path: str | Path) -> None:
    """Refuse a model whose moving bodies are not physical, or whose mass matrix is singular.

    A body is all links that one joint moves. Its mass is above 0 and none of its principal moments about the
    centre of mass exceeds the sum of the others, which is to say that its pseudo-inertia is positive
    semidefinite (to rounding). M(q) is positive definite at sampled q. Raises UrdfError.
    """
    if model.nv == 0:
        remedy = "Unlock a joint, or make one revolute, continuous or prismatic"
        raise _refusal(Path(path), f'robot "{model.name}"', "0 movable joints", "nothing can move", remedy)
    findings = [finding for joint in range(1, model.njoints) for finding in _body(model, joint)]
    findings = findings or list(_mass_matrix(model))
    if findings:
        raise UrdfError(path, findings)


def _refusal(path: Path, element: str, value: str, problem: str, remedy: str) -> UrdfError:
    return UrdfError(path, [Finding(element, value, problem, remedy)])


def read_bytes(path: Path) -> bytes:
    """What is in a robot file. Raises UrdfError for what is no file, cannot be read or is too large."""
    try:
        if not path.is_file():
            problem = "is a folder" if path.is_dir() else "is not a file"
            problem = problem if path.exists() else "does not exist"
            folder = path if path.is_dir() else path.parent
            near = sorted(file.name for file in folder.glob("*.urdf")) if folder.is_dir() else []
            remedy = "Give the path of a URDF file" + (f"; {folder} holds {listed(near)}" if near else "")
            raise _refusal(path, "file", str(path), problem, remedy)
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
    except OSError as reason:
        remedy = "Check the path and its permissions"
        raise _refusal(path, "file", str(path), f"cannot be read ({reason.strerror})", remedy) from reason
    if len(text) > MAX_BYTES:
        value, remedy = f"{path.stat().st_size} bytes", "Keep meshes and other data in files of their own"
        raise _refusal(path, "file", value, f"expected at most {MAX_BYTES}", remedy)
    return text


def _as_utf8(text: bytes) -> bytes:
    """A document in the encoding that it declares, as the XML reader takes it, which knows few.

    Of encodings in which people write, by the beginnings of their names: others of Python's are slow traps.
    """
    declared = DECLARATION.match(text)
    if not declared or not declared[1].lower().startswith(WRITTEN):
        return text
    return text[declared.end() :].decode(declared[1].decode("ascii")).encode()


def _parse_xml(path: Path, text: bytes) -> Element:
    depth, count, macros, plain = 0, 0, set[str](), set[str]()
    try:
        text = _as_utf8(text)
        events = iterparse(io.BytesIO(text), events=("start", "end", "start-ns"), forbid_dtd=True)
        for event, element in events:
            if event == "start-ns":
                prefix, namespace = element
                if "xacro" in prefix:
                    macros.add(f"{{{namespace}}}")
                elif not prefix:  # readers of robot files know no namespaces, and see a plain name
                    plain.add(f"{{{namespace}}}")
                continue
            depth += 1 if event == "start" else -1
            count += event == "start"
            if count > MAX_ELEMENTS:
                problem, remedy = f"expected at most {MAX_ELEMENTS}", "Leave out what the arm does not need"
                raise _refusal(path, "file", f"more than {MAX_ELEMENTS} elements", problem, remedy)
            if depth > MAX_DEPTH:
                problem = f"expected at most {MAX_DEPTH} nested elements"
                raise _refusal(path, f"<{element.tag}>", f"depth {depth}", problem, "Flatten the file")
    except DefusedXmlException as reason:
        problem, remedy = "document types and entities are refused", "Remove it and write its values out"
        raise _refusal(path, "<!DOCTYPE>", str(reason), problem, remedy) from reason
    except (ParseError, ValueError, LookupError) as reason:
        remedy = "Mend it at that place"
        if "unbound prefix" in str(reason):
            remedy = "Declare the prefix on <robot>; if it is xacro, expand the file to plain URDF first"
        raise _refusal(path, "file", str(reason), "expected XML", remedy) from reason
    root: Element = events.root
    plain.add(root.tag[: root.tag.find("}") + 1])
    for part in root.iter():  # by its prefix, whatever namespace that stands for
        start = part.tag.find("}") + 1
        if part.tag[:start] in macros:
            part.tag = f"{{xacro}}{part.tag[start:]}"
        elif part.tag[:start] in plain:
            part.tag = part.tag[start:]
    return root


def _unexpanded(root: Element) -> Iterator[Finding]:
    problem, remedy = "expected plain URDF", "Expand the file first: xacro robot.urdf.xacro > robot.urdf"
    for tag in sorted({element.tag for element in root.iter()}):
        namespace, _, name = tag.rpartition("}")
        if "xacro" in namespace:
            yield Finding(f"<xacro:{name}>", "xacro tag", problem, remedy)
    for part in root:
        if part.tag in MACROS:
            yield Finding(f"<{part.tag}>", "xacro tag", problem, remedy)
    for label, part in parts(root):
        for key, value in part.attrib.items():
            if re.search(r"\$[({]", value):
                yield Finding(label, f'{key}="{value}"', problem, remedy)


def _body(model: pin.Model, joint: int) -> Iterator[Finding]:
    inertia, armature = model.inertias[joint], model.armature[model.idx_vs[joint]]
    links = [f.name for f in model.frames if f.parentJoint == joint and f.type == pin.FrameType.BODY]
    label = f'link{"s" * (len(links) > 1)} {listed(links)} on joint "{model.names[joint]}"'
    if not 0 <= armature < math.inf:
        remedy = "Give the rotor's inertia times the squared gear ratio"
        yield Finding(label, f"armature {armature:g} kg m^2", "expected a finite value of at least 0", remedy)
    if not np.isfinite(inertia.toDynamicParameters()).all():
        yield Finding(label, f"inertia {inertia.toDynamicParameters()}", "not finite", "Mend its <inertial>")
    elif inertia.mass <= 0:
        remedy = (
            "Give one of its links an <inertial> with mass, or a shape and density= [kg/m^3] (--density) to "
            "weigh it by; or make the joint fixed"
        )
        yield Finding(label, f"mass {inertia.mass:g} kg", "a moving body needs mass", remedy)
    else:
        moments = np.linalg.eigvalsh(inertia.inertia)
        rounding = INERTIA_TOLERANCE * np.abs(moments).max() + inertia.mass * LEAST_GYRATION**2
        if moments[0] + moments[1] - moments[2] < -rounding:
            value = f"principal moments {', '.join(f'{moment:.6g}' for moment in moments)} kg m^2"
            problem = "no body has these: each is at least 0 and at most the sum of the others"
            remedy = (
                "Mend <inertia>, which is taken about the centre of mass; or take the nearest physical one: "
                "mend=True (--mend)"
            )
            yield Finding(label, value, problem, remedy)


def idle_joints(model: pin.Model) -> dict[int, float]:
    """The joints that turn mass but, in some posture, no inertia [kg m^2], by their place in v."""
    least = np.array([inertia.mass for inertia in model.inertias])[1:] * LEAST_GYRATION**2
    diagonals = [np.diag(mass_matrix) for mass_matrix in _mass_matrices(model)]
    smallest = np.min(diagonals, axis=0)
    return {int(i): float(smallest[i]) for i in np.flatnonzero((smallest <= least) & (least > 0))}


def _mass_matrix(model: pin.Model) -> Iterator[Finding]:
    names = list(model.names)[1:]
    if idle := idle_joints(model):
        for i, diagonal in idle.items():
            value, problem = f"{diagonal:.2g} kg m^2 about its axis", "it turns no inertia"
            remedy = "Give the links it moves moments of inertia, or the joint an effort limit or an armature"
            yield Finding(f'joint "{names[i]}"', value, problem, remedy)
        return
    smallest, motion = math.inf, np.zeros(model.nv)
    for mass_matrix in _mass_matrices(model):
        scale = np.sqrt(np.diag(mass_matrix))
        values, vectors = np.linalg.eigh(mass_matrix / np.outer(scale, scale))
        if values[0] < smallest:
            smallest, motion = values[0], np.abs(vectors[:, 0])
    if smallest < SINGULAR:
        moved = listed([name for name, part in zip(names, motion, strict=True) if part > 0.1])
        value = f"smallest eigenvalue of the scaled mass matrix {smallest:.2g}"
        problem, remedy = "they can move together and move no inertia", "Give the links between them inertia"
        yield Finding(f"joints {moved}", value, problem, remedy)


def _mass_matrices(model: pin.Model) -> Iterator[np.ndarray]:
    """M(q) (nv, nv) in the postures in which it is judged."""
    data, rng = model.createData(), np.random.default_rng(0)
    for _ in range(POSTURES):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-math.pi, math.pi, model.nv))
        yield np.reshape(pin.crba(model, data, q), (model.nv, model.nv))
