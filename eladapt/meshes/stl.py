"""STL, in both its forms: three corners a triangle."""

from __future__ import annotations

import re

import numpy as np

from eladapt.meshes.soup import Soup, limit, numbers

HEAD = 84  # bytes before the first triangle of the binary form, the last four of them their number
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
CORNER = re.compile(r"^[ \t]*vertex\s+(\S+\s+\S+\s+\S+)", re.MULTILINE | re.IGNORECASE)


def read(contents: bytes, most: int) -> Soup:
    """The triangles. Raises ValueError for what is no STL."""
    declared = int.from_bytes(contents[HEAD - 4 : HEAD], "little")
    size = HEAD + FACET.itemsize * declared
    if len(contents) != size and contents.lstrip()[:5].lower() == b"solid":
        limit(contents.lower().count(b"vertex") // 3, most)
        corners = numbers(" ".join(CORNER.findall(contents.decode("utf-8", "replace")))).reshape(-1, 3)
    else:
        limit(declared, most)
        if len(contents) < size:
            raise ValueError(f"it is too short for its {declared} triangles")
        corners = np.frombuffer(contents, FACET, declared, HEAD)["corners"].astype(float).reshape(-1, 3)
    return Soup(corners, np.arange(len(corners)).reshape(-1, 3))
