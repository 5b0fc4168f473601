"""Visual shapes as MeshCat draws them, with meshes that were judged, and thinned."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from meshcat import geometry as draw

from eladapt.errors import MeshError, MeshWarning, UrdfError
from eladapt.meshes.mesh import Mesh, read_mesh
from eladapt.robot.model import Robot
from eladapt.urdf.assets import Folders, MeshUse
from eladapt.urdf.checks import read_urdf

MOST_TOGETHER = 1_000_000  # triangles of a robot's meshes; each has a part in what the page keeps
SHOWN = 8  # refused meshes named in a warning
ROBOT_TRIANGLES, GHOST_TRIANGLES = 140_000, 40_000  # the Panda has 134,913: 3.3 MB of the page


class Visual(NamedTuple):
    """A shape, where on which joint it is, and its colour."""

    joint: int
    placement: np.ndarray  # (4, 4)
    colour: np.ndarray  # (4,) red, green, blue, opacity, in [0, 1]
    form: coal.CollisionGeometry | Mesh

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """(3,) least and (3,) largest coordinates in the shape's frame [m]."""
        if isinstance(self.form, Mesh):
            return self.form.vertices.min(axis=0), self.form.vertices.max(axis=0)
        self.form.computeLocalAABB()
        return self.form.aabb_local.min_, self.form.aabb_local.max_


class Drawn(NamedTuple):
    """What MeshCat draws for a shape and for its ghost, and where in the shape's frame."""

    geometry: draw.Geometry
    thinned: draw.Geometry
    placement: np.ndarray  # (4, 4)


def shapes_of(model: pin.GeometryModel, forms: dict[str, Mesh | None]) -> list[Visual]:
    """The shapes of a model. ``forms`` has the meshes that some stand for by name; None is left out."""
    return [
        Visual(shape.parentJoint, shape.placement.homogeneous, np.array(shape.meshColor), form)
        for shape in model.geometryObjects
        if (form := forms.get(shape.name, shape.geometry)) is not None
    ]


def meshes_of(robot: Robot, uses: dict[str, MeshUse]) -> dict[str, Mesh | None]:
    """The meshes by the names of the shapes that they are. One that is refused is None, and is warned of."""
    folders, left = Folders.of(_robot_file(robot), robot.package_dirs), MOST_TOGETHER
    read = functools.cache(lambda use: read_mesh(folders.located(use.filename), use.scale))
    meshes: dict[str, Mesh | None] = {}
    refused = []
    for name, use in uses.items():
        try:
            mesh = read(use)
            if len(mesh.triangles) > left:
                raise MeshError(f"{use.filename}: with it, the robot has more than {MOST_TOGETHER} triangles")
        except MeshError as reason:
            refused.append(f"{name}: {reason}")
            meshes[name] = None
        else:
            left -= len(mesh.triangles)
            meshes[name] = mesh
    if refused:
        rest = f"; and {len(refused) - SHOWN} more" if len(refused) > SHOWN else ""
        said = f"{robot.path}: drawn without {'; '.join(refused[:SHOWN])}{rest}"
        warnings.warn(said, MeshWarning, stacklevel=2)
    return meshes


def _robot_file(robot: Robot) -> Path | None:
    """The robot's file; None where there is none any more. A record brings the text of one along, and the
    name of a folder that it may never have been in."""
    try:
        read_urdf(robot.path)
    except UrdfError:
        return None
    return robot.path


def drawn(shape: Visual, total: int) -> Iterator[Drawn]:
    """The parts of a shape; ``total`` triangles of the whole robot decide how many a mesh may keep."""
    form = shape.form
    if isinstance(form, Mesh):
        share = len(form.triangles) / total
        full = _thinned(*form, share * ROBOT_TRIANGLES)
        yield Drawn(full, _thinned(*form, share * GHOST_TRIANGLES), np.eye(4))
    elif isinstance(form, coal.Sphere):
        yield _at(draw.Sphere(form.radius))
    elif isinstance(form, coal.Cylinder | coal.Capsule):
        upright = pin.utils.rotate("x", np.pi / 2)  # three.js has the axis along y
        yield _at(draw.Cylinder(2 * form.halfLength, form.radius), rotation=upright)
        for end in (-1, 1) if isinstance(form, coal.Capsule) else ():
            yield _at(draw.Sphere(form.radius), np.array([0, 0, end * form.halfLength]))
    else:
        low, high = shape.box()
        yield _at(draw.Box(list(high - low)), (high + low) / 2)


def _at(form: draw.Geometry, position: Any = (0, 0, 0), rotation: np.ndarray | None = None) -> Drawn:
    placement = pin.SE3(np.eye(3) if rotation is None else rotation, np.array(position, dtype=float))
    return Drawn(form, form, placement.homogeneous)


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
