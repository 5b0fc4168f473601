"""Visual shapes as MeshCat draws them, with meshes mended and thinned."""

from __future__ import annotations

import contextlib
import copy
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from defusedxml import ElementTree
from meshcat import geometry as draw

ROBOT_TRIANGLES, GHOST_TRIANGLES = 140_000, 40_000  # the Panda has 134,293: 3.3 MB of the page
_PLACEMENTS = ("matrix", "translate", "rotate", "scale", "skew", "lookat")
_PARTS = "*[@count]"  # <triangles>, <polylist> and the like: a material each


class Drawn(NamedTuple):
    """What MeshCat draws for a shape and for its ghost, and where in the shape's frame."""

    geometry: draw.Geometry
    thinned: draw.Geometry
    placement: np.ndarray  # (4, 4)


def drawn(shape: pin.GeometryObject, total: int) -> Iterator[Drawn]:
    """The parts of a shape; ``total`` triangles of the whole robot decide how many a mesh may keep."""
    form = shape.geometry
    if isinstance(form, coal.BVHModelBase):
        vertices, triangles = _mesh(shape)
        share = len(triangles) / total
        full = _thinned(vertices, triangles, share * ROBOT_TRIANGLES)
        yield Drawn(full, _thinned(vertices, triangles, share * GHOST_TRIANGLES), np.eye(4))
    elif isinstance(form, coal.Sphere):
        yield _at(draw.Sphere(form.radius))
    elif isinstance(form, coal.Cylinder | coal.Capsule):
        upright = pin.utils.rotate("x", np.pi / 2)  # three.js has the axis along y
        yield _at(draw.Cylinder(2 * form.halfLength, form.radius), rotation=upright)
        for end in (-1, 1) if isinstance(form, coal.Capsule) else ():
            yield _at(draw.Sphere(form.radius), np.array([0, 0, end * form.halfLength]))
    else:
        form.computeLocalAABB()
        box = form.aabb_local
        yield _at(draw.Box(list(box.max_ - box.min_)), (box.max_ + box.min_) / 2)


def _at(form: draw.Geometry, position: Any = (0, 0, 0), rotation: np.ndarray | None = None) -> Drawn:
    placement = pin.SE3(np.eye(3) if rotation is None else rotation, np.array(position, dtype=float))
    return Drawn(form, form, placement.homogeneous)


def _mesh(shape: pin.GeometryObject) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [m] and the numbers (m, 3) of those of each triangle.

    coal 3.0 counts the vertices of nested COLLADA nodes, and of a node's further materials, from the
    wrong one on, which scrambles the UR5's wrists; vertices without a triangle give it away. What
    cannot be mended is drawn as it was read.
    """
    mesh = shape.geometry
    triangles = _triangles(mesh)
    if len(np.unique(triangles)) < mesh.num_vertices and shape.meshPath.lower().endswith(".dae"):
        with contextlib.suppress(KeyError, AttributeError, ValueError, ElementTree.ParseError):
            again = _flattened(shape.meshPath, shape.meshScale)
            if again.num_tris == mesh.num_tris:
                return again.vertices(), _triangles(again)
    return mesh.vertices(), triangles


def _triangles(mesh: coal.BVHModelBase) -> np.ndarray:
    corners = (mesh.tri_indices(index) for index in range(mesh.num_tris))
    return np.array([(corner[0], corner[1], corner[2]) for corner in corners])


def _flattened(path: str, scale: np.ndarray) -> coal.BVHModelBase:
    """A COLLADA mesh, read from a copy in which every part is a node of its own below the root."""
    tree = ElementTree.parse(path)
    root = tree.getroot()
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # assimp reads no namespace prefixes
    geometries = {f"#{geometry.get('id')}": geometry for geometry in root.iter("geometry")}
    scene, library = root.find(".//visual_scene"), root.find("library_geometries")

    def flatten(node: Any, placement: list[Any]) -> None:
        placement = placement + [child for child in node if child.tag in _PLACEMENTS]
        for use in node.findall("instance_geometry"):
            whole = geometries[use.get("url")]
            for number in range(len(whole.find("mesh").findall(_PARTS))):
                single, own = copy.deepcopy(whole), copy.deepcopy(use)
                mesh = single.find("mesh")
                for other, part in enumerate(mesh.findall(_PARTS)):
                    if other != number:
                        mesh.remove(part)
                name = f"part.{len(library)}"
                single.set("id", name)
                own.set("url", f"#{name}")
                library.append(single)
                scene.append(scene.makeelement("node", {"id": name, "name": name}))
                scene[-1].extend([*placement, own])
        for child in node.findall("node"):
            flatten(child, placement)

    for node in scene.findall("node"):
        scene.remove(node)
        flatten(node, [])
    with tempfile.TemporaryDirectory() as folder:
        copied = Path(folder) / "mesh.dae"
        tree.write(copied)
        return coal.MeshLoader().load(str(copied), scale)


def _thinned(vertices: np.ndarray, triangles: np.ndarray, most: float) -> draw.TriangularMeshGeometry:
    """The mesh with ``most`` triangles: the vertices within a cell of a grid become one, ever coarser."""
    points, corners = vertices, triangles
    cell = 2e-3 * np.ptp(vertices, axis=0).max()
    while len(corners) > max(most, 12) and cell > 0:
        cells = ((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
        _, group, counts = np.unique(cells @ (1, 2**20, 2**40), return_inverse=True, return_counts=True)
        points = np.stack([np.bincount(group, axis) for axis in vertices.T], axis=1) / counts[:, None]
        corners = group[triangles]
        corners = corners[np.all(corners != np.roll(corners, 1, axis=1), axis=1)]
        cell *= 1.5
    return draw.TriangularMeshGeometry(points, corners)
