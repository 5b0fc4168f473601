"""A mesh, and the bounds that keep a file from outside from filling the memory or the day.

No reader in this room opens a file: each is given bytes. So a mesh shows what lies in its own file, which
was judged, and nothing that it refers to. The formats are those that robots come with; any other is refused
by name, since what it may refer to is not known here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eladapt.errors import MeshError
from eladapt.files import read_bytes
from eladapt.meshes import collada, gltf, obj, stl
from eladapt.meshes.soup import BoundError, Soup

MOST_BYTES = 64 << 20  # the largest of 670 published robot meshes has 29 MB
MOST_TRIANGLES = 500_000  # of one mesh; those of a published arm have up to 290,000 together
FARTHEST = 1e4  # [m] from the origin: no robot's, and within single precision, in which a page keeps it

READERS: dict[str, Callable[[bytes, int], Soup]] = {
    ".stl": stl.read, ".obj": obj.read, ".dae": collada.read, ".gltf": gltf.read, ".glb": gltf.read,
}  # fmt: skip


class Mesh(NamedTuple):
    """Triangles, by the numbers of their corners among the vertices. Every vertex is some triangle's."""

    vertices: np.ndarray  # (n, 3) [m]
    triangles: np.ndarray  # (m, 3)


def read_mesh(
    path: Path, scale: np.ndarray | tuple[float, ...] = (1, 1, 1), most: int = MOST_TRIANGLES
) -> Mesh:
    """The mesh in a file, times ``scale`` (3,), of up to ``most`` triangles.

    Raises MeshError, which names the file, for another format, for what is no regular file or too large, for
    contents that are broken, out of bounds or in another file, and for a mesh without a triangle.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise MeshError(f"{path}: expected one of the formats {', '.join(READERS)}; convert it to one")
    try:
        vertices, triangles = reader(read_bytes(path, MOST_BYTES), most)
        vertices = vertices * scale
        if not (np.abs(vertices) <= FARTHEST).all():
            raise ValueError(f"its vertices are to be finite, and within {FARTHEST:g} m of the origin")
    except OSError as reason:
        raise MeshError(f"{path}: {reason.strerror}") from reason
    except BoundError as reason:
        raise MeshError(f"{path}: {reason}; thin it out") from reason
    except Exception as reason:  # whatever a decoder of foreign bytes trips over
        said = str(reason) or type(reason).__name__
        raise MeshError(f"{path}: not a mesh in this format, or a damaged one ({said})") from reason
    mesh = _joined(vertices, triangles)
    if not len(mesh.triangles):
        raise MeshError(f"{path}: holds no triangles")
    return mesh


def _joined(vertices: np.ndarray, triangles: np.ndarray) -> Mesh:
    """The mesh with equal vertices made one, without the triangles that this leaves with two corners."""
    single = np.ascontiguousarray(vertices, dtype=np.float32) + np.float32(0)  # no negative zeros
    rows = single.view("V12")[:, 0]  # bytes: of 200,000 triangles 2.7 times as fast as by axis=0
    _, first, group = np.unique(rows, return_index=True, return_inverse=True)
    corners = group[triangles]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    used, corners = np.unique(corners, return_inverse=True)
    return Mesh(vertices[first[used]], corners.reshape(-1, 3))
