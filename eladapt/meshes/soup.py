"""Triangles as a file has them, and what the readers of several formats share."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Soup(NamedTuple):
    """Triangles by the numbers of their corners. Every vertex is some triangle's; equal ones may differ."""

    vertices: np.ndarray  # (n, 3)
    triangles: np.ndarray  # (m, 3) of 0 to n - 1


class BoundError(ValueError):
    """More than a mesh may have."""


def limit(count: int, most: int, what: str = "triangles") -> None:
    """Raises BoundError for a count above ``most``."""
    if count > most:
        raise BoundError(f"it has more than {most} {what}")


def soup(vertices: np.ndarray, triangles: np.ndarray) -> Soup:
    """The triangles with those of the vertices (k, 3) that they use. Raises ValueError for others."""
    used, corners = np.unique(triangles, return_inverse=True)
    if used.size and not (used[0] >= 0 and used[-1] < len(vertices)):
        raise ValueError(f"a triangle has a corner that is none of the {len(vertices)} vertices")
    return Soup(np.asarray(vertices[used.astype(int)], dtype=float), corners.reshape(-1, 3))


def joined(parts: Sequence[Soup]) -> Soup:
    """One soup of several."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = [np.empty((0, 3)), *(part.vertices for part in parts)]
    triangles = [part.triangles + start for part, start in zip(parts, starts, strict=False)]
    return Soup(np.concatenate(vertices), np.concatenate([np.empty((0, 3), int), *triangles]))


def fans(corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Polygons of ``sizes`` corners each, one after the other in ``corners``, as triangles from the first."""
    starts = np.cumsum(sizes) - sizes
    each = np.maximum(sizes - 2, 0)
    second = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each) + np.repeat(starts, each) + 1
    return corners[np.stack([np.repeat(starts, each), second, second + 1], axis=1)]


def strip(corners: np.ndarray) -> np.ndarray:
    """A strip, in which each corner makes a triangle with the two before it, as triangles of one sense."""
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def placed(part: Soup, matrix: np.ndarray) -> Soup:
    """The soup in the frame in which its own is at matrix (4, 4)."""
    return Soup(part.vertices @ matrix[:3, :3].T + matrix[:3, 3], part.triangles)


def numbers(text: str | None, kind: type = float) -> np.ndarray:
    """The numbers in a text with blanks between. Raises ValueError for anything else in it."""
    text = (text or "").strip()
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # what numpy says where it stops half-way
        try:
            return np.fromstring(text, kind, sep=" ") if text else np.empty(0, kind)
        except DeprecationWarning:
            raise ValueError(f"expected numbers with blanks between, got {text[:40]!r} and more") from None
