"""COLLADA: the triangles of its scene, as Pinocchio's reader takes them: without unit and upward axis.

What a node, an input or an instance refers to is looked for in the document alone.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from defusedxml.ElementTree import iterparse

from eladapt.meshes.soup import Soup, fans, joined, limit, numbers, placed, soup, strip

MOST_ELEMENTS, MOST_DEPTH = 200_000, 100  # published ones have 13,000 and 10
MOST_NODES = 10_000  # as often as they are visited
FLAT = ("triangles", "polylist", "polygons", "tristrips", "trifans")


def read(contents: bytes, most: int) -> Soup:
    """The triangles of the scene. Raises ValueError for what is no COLLADA, and for data in another file."""
    document = _Document(_parsed(contents))
    shapes: dict[str, Soup] = {}
    parts, count = [], 0
    for url, placement in document.placed_geometries():
        if url not in shapes:
            shapes[url] = _geometry(document, document.at(url, "geometry"), most)
        parts.append(placed(shapes[url], placement))
        count += len(parts[-1].triangles)
        limit(count, most)
    return joined(parts)


class _Document:
    """A document's elements by their identifiers."""

    def __init__(self, root: Any):
        self.root = root
        self.named = {f"#{element.get('id')}": element for element in root.iter() if element.get("id")}

    def at(self, url: str | None, tag: str) -> Any:
        """The element that a reference means. Raises ValueError for one elsewhere."""
        if not url or not url.startswith("#"):
            raise ValueError(f"it refers to another file, {(url or '')[:200]!r}, which is not read")
        element = self.named.get(url)
        if element is None or element.tag != tag:
            raise ValueError(f"it has no <{tag}> {url[:200]!r}")
        return element

    def placed_geometries(self) -> Iterator[tuple[str, np.ndarray]]:
        """The geometries that the scene's nodes use, with their placements."""
        use = self.root.find("scene/instance_visual_scene")
        if use is None:
            return
        left = [(node, np.eye(4)) for node in self.at(use.get("url"), "visual_scene").findall("node")]
        visited = 0
        while left:
            node, parent = left.pop()
            visited += 1
            limit(visited + len(left), MOST_NODES, "nodes, as often as they are used")
            placement = parent @ _placement(node)
            for used in node.findall("instance_geometry"):
                yield used.get("url", ""), placement
            children = node.findall("node")
            children += [self.at(used.get("url"), "node") for used in node.findall("instance_node")]
            left += [(child, placement) for child in children]


def _parsed(contents: bytes) -> Any:
    """The document's root, without namespaces, read within bounds of size and depth."""
    depth, count = 0, 0
    events = iterparse(io.BytesIO(contents), events=("start", "end"), forbid_dtd=True)
    for event, element in events:
        depth += 1 if event == "start" else -1
        count += event == "start"
        limit(count, MOST_ELEMENTS, "elements")
        limit(depth, MOST_DEPTH, "elements within each other")
        element.tag = element.tag.rpartition("}")[2]
    return events.root


def _placement(node: Any) -> np.ndarray:
    placement = np.eye(4)
    for child in node:
        if child.tag in ("lookat", "skew"):
            raise ValueError(f"its <{child.tag}> is not read: apply it, and export again")
        if child.tag not in ("matrix", "translate", "rotate", "scale"):
            continue
        values, step = numbers(child.text), np.eye(4)
        if child.tag == "matrix":
            step = values.reshape(4, 4)
        elif child.tag == "translate":
            step[:3, 3] = values
        elif child.tag == "scale":
            step[:3, :3] = np.diag(values.reshape(3))
        else:
            step[:3, :3] = _rotation(values[:3], np.radians(values[3]))
        placement = placement @ step
    return placement


def _rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    length = np.linalg.norm(axis)
    x, y, z = axis / length if length else axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across


def _geometry(document: _Document, geometry: Any, most: int) -> Soup:
    points: dict[str, np.ndarray] = {}
    parts, count = [], 0
    for flat in (flat for flat in geometry.findall("mesh/*") if flat.tag in FLAT):
        inputs = flat.findall("input")
        corner = next(used for used in inputs if used.get("semantic") == "VERTEX")
        url = corner.get("source", "")
        if url not in points:
            points[url] = _points(document, document.at(url, "vertices"))
        stride = 1 + max(int(used.get("offset", 0)) for used in inputs)
        triangles = _triangles(flat, stride, int(corner.get("offset", 0)))
        count += len(triangles)
        limit(count, most)
        parts.append(soup(points[url], triangles))
    return joined(parts)


def _points(document: _Document, vertices: Any) -> np.ndarray:
    """(n, 3) the positions."""
    use = next(used for used in vertices.findall("input") if used.get("semantic") == "POSITION")
    source = document.at(use.get("source"), "source")
    accessor = source.find("technique_common/accessor")
    values = numbers(document.at(accessor.get("source"), "float_array").text)
    start, stride, count = (int(accessor.get(key, 0)) for key in ("offset", "stride", "count"))
    return values[start:][: count * stride].reshape(count, stride)[:, :3]


def _triangles(flat: Any, stride: int, offset: int) -> np.ndarray:
    """(m, 3) the numbers of the corners' positions."""
    polygons = [numbers(part.text, int)[offset::stride] for part in flat.findall("p")]
    if flat.tag == "tristrips":
        return np.concatenate([np.empty((0, 3), int), *map(strip, polygons)])
    sizes = np.array([len(polygon) for polygon in polygons], int)
    corners = np.concatenate([np.empty(0, int), *polygons])
    if flat.tag == "triangles":
        return corners.reshape(-1, 3)
    return fans(corners, numbers(flat.findtext("vcount"), int) if flat.tag == "polylist" else sizes)
