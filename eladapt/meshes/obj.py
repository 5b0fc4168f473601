"""Wavefront OBJ: its vertices and faces. What it says of materials, in other files, is passed over."""

from __future__ import annotations

from array import array

import numpy as np

from eladapt.meshes.soup import Soup, fans, limit, soup

MOST_LINES = 4_000_000  # of a mesh with as many triangles as it may have, and as many vertices of each kind
MOST_WORDS = 1000  # in a line: the corners of a face


def read(contents: bytes, most: int) -> Soup:
    """The faces as triangles. Raises ValueError for what is no OBJ."""
    coordinates, corners, sizes = array("d"), array("q"), array("q")
    limit(contents.count(b"\n") + contents.count(b"\r"), MOST_LINES, "lines")
    for line in contents.replace(b"\r\n", b"\n").replace(b"\\\n", b" ").splitlines():
        words = line.split(None, MOST_WORDS)
        if words[:1] == [b"v"]:
            x, y, z = map(float, words[1:4])
            coordinates.extend((x, y, z))
        elif words[:1] == [b"f"]:
            # from 1 on, or backwards from the last vertex so far
            given, so_far = [int(word.partition(b"/")[0]) for word in words[1:]], len(coordinates) // 3
            if 0 in given:
                raise ValueError("a face has vertex 0: they count from 1, or from -1 backwards")
            corners.extend(number - 1 if number > 0 else so_far + number for number in given)
            sizes.append(len(given))
            limit(len(corners) - 2 * len(sizes), most)
    triangles = fans(np.array(corners, int), np.array(sizes, int))
    return soup(np.array(coordinates).reshape(-1, 3), triangles)
