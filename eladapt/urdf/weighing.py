"""Masses and inertias that a URDF leaves out, from the shapes of its links and a density."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from eladapt.errors import ArgumentError, Finding, MeshError, UrdfError, require_number
from eladapt.meshes.mesh import read_mesh
from eladapt.urdf.assets import Folders
from eladapt.urdf.editing import inertial_text
from eladapt.urdf.holding import moving_links
from eladapt.urdf.numbers import label_of, parse
from eladapt.urdf.tree import child_value

LIGHTEST, HEAVIEST = 10.0, 23_000.0  # [kg/m^3] a foam; osmium


def require_density(name: str, value: float) -> float:
    """A density [kg/m^3] of something that an arm is made of. Raises ArgumentError: 2.7 is in g/cm^3."""
    try:
        return require_number(name, value, LIGHTEST, HEAVIEST, closed=True)
    except ArgumentError as reason:
        raise ArgumentError(f"{reason}; in kg/m^3, aluminium has 2700, steel 7800, plastic 1000") from None


def weigh(
    root: Element, held: Sequence[str], density: float, urdf: Path, package_dirs: Sequence[str | Path] = ()
) -> dict[str, pin.Inertia]:
    """The inertias, by name, of the moving links that have a shape but no <inertial>, in their own frames.

    Each is that of the link's collision shapes, else of its visual ones, filled with this density [kg/m^3]:
    boxes, cylinders and spheres as they are, a mesh as its convex hull; where two overlap, both count.
    ``root``: as it was checked. Raises UrdfError for each shape that has no volume or cannot be read.
    """
    weighed, findings = {}, []
    for link in moving_links(root, held):
        shapes = link.findall("collision") or link.findall("visual")
        if link.find("inertial") is not None or not shapes:
            continue
        total = pin.Inertia.Zero()
        for shape in shapes:
            form = shape.find("geometry/*")
            try:
                total += _placement(shape).act(_filled(form, density, urdf, package_dirs))
            except (ValueError, MeshError) as reason:
                kind = "" if form is None else f" <{form.tag}>"
                value = "" if form is None else " ".join(f'{k}="{v}"' for k, v in form.attrib.items())
                remedy = "Mend the shape, or give the link an <inertial>"
                label = f"{label_of(link)} <{shape.tag}>{kind}"
                findings.append(Finding(label, value or "empty", f"it cannot be weighed: {reason}", remedy))
        weighed[link.get("name", "")] = total
    if findings:
        raise UrdfError(urdf, findings)
    return weighed


def add_inertials(root: Element, weighed: Mapping[str, pin.Inertia]) -> None:
    """Give each of these links an <inertial> with its inertia, in place."""
    for link in root.findall("link"):
        if (body := weighed.get(link.get("name", ""))) is None:
            continue
        link.append(fromstring(inertial_text(body)))


def _placement(shape: Element) -> pin.SE3:
    xyz, rpy = (np.array(parse(child_value(shape, "origin", key, "0 0 0"), 3)) for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _filled(
    form: Element | None, density: float, urdf: Path, package_dirs: Sequence[str | Path]
) -> pin.Inertia:
    """A shape of this density [kg/m^3], in its own frame. Raises ValueError, MeshError."""
    if form is None:
        raise ValueError("it has no geometry")
    if form.tag == "mesh":
        return _hull(_vertices(form, urdf, package_dirs), density)
    if form.tag == "box":
        x, y, z = _sizes(form, "size", 3)
        return pin.Inertia.FromBox(density * x * y * z, x, y, z)
    if form.tag == "sphere":
        (radius,) = _sizes(form, "radius")
        return pin.Inertia.FromSphere(density * 4 / 3 * math.pi * radius**3, radius)
    if form.tag == "cylinder":
        (radius,), (length,) = _sizes(form, "radius"), _sizes(form, "length")
        return pin.Inertia.FromCylinder(density * math.pi * radius**2 * length, radius, length)
    raise ValueError("expected a box, cylinder, sphere or mesh")


def _sizes(form: Element, attribute: str, size: int = 1) -> tuple[float, ...]:
    given = parse(form.get(attribute, ""), size)
    if given is None or min(given) <= 0:
        raise ValueError(f"expected a {attribute} above 0")
    return given


def _hull(vertices: np.ndarray, density: float) -> pin.Inertia:
    """The convex hull of points (n, 3) [m], filled: the sum of tetrahedra from a point inside to its faces.

    A tetrahedron of volume V with one corner at 0, the others a, b and c and s = a + b + c has its centre at
    s/4 and second moments V (aa' + bb' + cc' + ss') / 20.
    """
    try:
        faces = vertices[ConvexHull(vertices).simplices]  # (m, 3, 3) corners
    except (QhullError, ValueError) as reason:
        raise ValueError("it has no volume") from reason
    inside = faces.mean(axis=(0, 1))
    corners = faces - inside
    volumes = np.abs(np.linalg.det(corners)) / 6
    sums = corners.sum(axis=1)
    volume = volumes.sum()
    centre = volumes @ sums / (4 * volume)
    second = (
        np.einsum("k,kia,kib->ab", volumes, corners, corners) + np.einsum("k,ka,kb->ab", volumes, sums, sums)
    ) / 20 - volume * np.outer(centre, centre)
    moments = np.trace(second) * np.eye(3) - second
    return pin.Inertia(density * volume, inside + centre, density * moments)


def _vertices(mesh: Element, urdf: Path, package_dirs: Sequence[str | Path]) -> np.ndarray:
    """(n, 3) [m] the vertices of a mesh. Raises MeshError for one that is refused, broken or nowhere."""
    place = Folders.of(urdf, package_dirs).located(mesh.get("filename", ""))
    return read_mesh(place, np.array(parse(mesh.get("scale", "1 1 1"), 3))).vertices
