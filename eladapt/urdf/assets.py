"""The meshes that a URDF names: opened from its own folder and the packages' alone.

A file is judged by where it really is, links resolved. Dynamics need no meshes: a robot whose meshes are
refused, or on another computer, is read all the same, and drawn without them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

PACKAGES = ("package", "model")  # schemes that name a folder below one of the package_dirs


def located(name: str, urdf: Path, package_dirs: Sequence[str | Path] = ()) -> Path:
    """The file of this name, links resolved. Raises ValueError for one that is refused, or nowhere."""
    own = sorted({urdf.parent.resolve(), urdf.resolve().parent})
    packages = [Path(folder).resolve() for folder in package_dirs]
    scheme, _, rest = name.rpartition("://")
    if scheme not in ("", "file", *PACKAGES):
        raise ValueError(f"{scheme}:// is not read; expected a path, package:// or file://")
    if not rest or "\0" in rest:
        raise ValueError("names no file")
    folders = packages or own if scheme in PACKAGES else own
    texts = dict.fromkeys((rest, unquote(rest)))
    places = [_real(Path(os.path.abspath(folder / text))) for text in texts for folder in folders]
    found = [place for place in places if _exists(place)]
    for place in found or places:
        if not any(place.is_relative_to(folder) for folder in (*own, *packages)):
            raise ValueError(
                f"lies outside the folders that files may come from, at {place}; move it below {own[0]}, or "
                "name its folder in package_dirs"
            )
    if not found:
        looked = ", ".join(sorted({str(place.parent) for place in places}))
        raise ValueError(f"there is none in {looked}; put it there, or name its folder in package_dirs")
    return found[0]


def _exists(place: Path) -> bool:
    try:
        return place.exists()
    except (OSError, ValueError):
        return False


def _real(place: Path) -> Path:
    try:
        return place.resolve()
    except (OSError, RuntimeError):  # a circle of links leads nowhere
        return place
