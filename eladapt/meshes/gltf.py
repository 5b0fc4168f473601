"""glTF 2.0, as text or binary: the triangles of its scene, from buffers that lie in the file itself."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from pinocchio import Quaternion

from eladapt.meshes.soup import Soup, fans, joined, limit, placed, soup, strip

MAGIC = b"glTF"
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
MOST_VALUES = 1_000_000  # of its text: some hundred bytes each, once they are Python's
MOST_NODES = 10_000  # as often as they are visited
FLOAT = 5126
NUMBERS = {5121: "<u1", 5123: "<u2", 5125: "<u4", FLOAT: "<f4"}
TRIANGLES, STRIP, FAN = 4, 5, 6


def read(contents: bytes, most: int) -> Soup:
    """The triangles of the scene. Raises ValueError for what is no glTF, and for data in another file."""
    text, binary = _chunks(contents) if contents.startswith(MAGIC) else (contents, b"")
    limit(sum(map(text.count, (b",", b"[", b"{"))), MOST_VALUES, "values in its text")
    document = json.loads(text)
    if required := document.get("extensionsRequired"):
        raise ValueError(f"it requires {', '.join(required)}, which is not read")
    buffers = [_buffer(buffer, binary) for buffer in document.get("buffers", [])]
    shapes: dict[int, Soup] = {}
    parts, count = [], 0
    for number, placement in _placed_meshes(document):
        if number not in shapes:
            shapes[number] = _mesh(document, buffers, document["meshes"][number], most)
        parts.append(placed(shapes[number], placement))
        count += len(parts[-1].triangles)
        limit(count, most)
    return joined(parts)


def _chunks(contents: bytes) -> tuple[bytes, bytes]:
    """The text and the data of the binary form."""
    found: dict[int, bytes] = {}
    place = 12
    while place + 8 <= len(contents):
        size, kind = struct.unpack_from("<II", contents, place)
        found.setdefault(kind, contents[place + 8 : place + 8 + size])
        place += 8 + size
    return found[JSON_CHUNK], found.get(BINARY_CHUNK, b"")


def _buffer(buffer: dict[str, Any], binary: bytes) -> bytes:
    uri = buffer.get("uri")
    if uri is None:
        return binary
    kind, _, data = uri.partition(",")
    if not (kind.startswith("data:") and kind.endswith(";base64")):
        raise ValueError(f"it refers to another file, {uri[:200]!r}, which is not read: export it as .glb")
    return base64.b64decode(data, validate=True)


def _placed_meshes(document: dict[str, Any]) -> Iterator[tuple[int, np.ndarray]]:
    """The meshes that the scene's nodes hold, with their placements."""
    nodes, visited = document["nodes"], 0
    left = [(number, np.eye(4)) for number in document["scenes"][document.get("scene", 0)]["nodes"]]
    while left:
        number, parent = left.pop()
        node = nodes[number]
        visited += 1
        limit(visited + len(left), MOST_NODES, "nodes, as often as they are used")
        placement = parent @ _placement(node)
        if "mesh" in node:
            yield node["mesh"], placement
        left += [(child, placement) for child in node.get("children", [])]


def _placement(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    placement = np.eye(4)
    rotation = Quaternion(np.array(node.get("rotation", (0, 0, 0, 1)), dtype=float)).toRotationMatrix()
    placement[:3, :3] = rotation * np.array(node.get("scale", (1, 1, 1)), dtype=float)
    placement[:3, 3] = node.get("translation", (0, 0, 0))
    return placement


def _mesh(document: dict[str, Any], buffers: list[bytes], mesh: dict[str, Any], most: int) -> Soup:
    parts, count = [], 0
    for primitive in mesh["primitives"]:
        mode = primitive.get("mode", TRIANGLES)
        if mode not in (TRIANGLES, STRIP, FAN):  # points and lines
            continue
        vertices = _accessor(document, buffers, primitive["attributes"]["POSITION"], "VEC3")
        indices = primitive.get("indices")
        corners = np.arange(min(len(vertices), 3 * (most + 1)))
        if indices is not None:
            corners = _accessor(document, buffers, indices, "SCALAR")[:, 0].astype(int)
        limit(len(corners) // 3 if mode == TRIANGLES else len(corners) - 2, most)
        triangles = corners.reshape(-1, 3) if mode == TRIANGLES else strip(corners)
        if mode == FAN:
            triangles = fans(corners, np.array([len(corners)]))
        parts.append(soup(vertices, triangles))
        count += len(triangles)
        limit(count, most)
    return joined(parts)


def _accessor(document: dict[str, Any], buffers: list[bytes], number: int, shape: str) -> np.ndarray:
    """The numbers, (count, 3) or (count, 1), where they lie: numpy refuses what reaches beyond the buffer."""
    accessor = document["accessors"][number]
    kind, count = accessor["componentType"], accessor["count"]
    if accessor["type"] != shape or (kind == FLOAT) != (shape == "VEC3") or "sparse" in accessor:
        raise ValueError(f"accessor {number}: expected a plain {shape} of positions or corners")
    numbers, width = np.dtype(NUMBERS[kind]), 3 if shape == "VEC3" else 1
    view = document["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    strides = (view.get("byteStride") or width * numbers.itemsize, numbers.itemsize)
    return np.ndarray((count, width), numbers, buffers[view["buffer"]], start, strides)
