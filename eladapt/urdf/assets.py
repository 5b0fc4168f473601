"""The files that a URDF names, meshes and textures: from its own folder and the packages' alone.

A file is judged by where it really is, links resolved. One that does not exist is no fault as long as it
would lie inside: dynamics need no meshes. A shape that is drawn is read by Pinocchio, which says what it
cannot find.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element

from eladapt.errors import Finding
from eladapt.urdf.numbers import parts

NAMING = ("mesh", "texture")
PACKAGES = ("package", "model")  # schemes that name a folder below one of the package_dirs


def file_findings(root: Element, urdf: Path, package_dirs: Sequence[str | Path] = ()) -> Iterator[Finding]:
    """Every file that is named and lies outside the allowed folders, or that no reader knows to find."""
    own = {urdf.parent.resolve(), urdf.resolve().parent}
    packages = [Path(folder).resolve() for folder in package_dirs]
    named = [
        *parts(root),
        *((f'material "{m.get("name", "")}"', t) for m in root.findall("material") for t in m),
    ]
    for label, part in named:
        name = part.get("filename")
        if part.tag not in NAMING or name is None:
            continue
        yield from _judged(label, name, sorted(own), packages)


def _judged(label: str, name: str, own: list[Path], packages: list[Path]) -> Iterator[Finding]:
    value = f'filename="{name}"'
    scheme, _, rest = name.rpartition("://")
    if scheme not in ("", "file", *PACKAGES):
        remedy = "Copy the file beside the URDF and give its path from there"
        yield Finding(
            label, value, f"{scheme}:// is not read; expected a path, package:// or file://", remedy
        )
        return
    if not rest or "\0" in rest:
        yield Finding(label, value, "names no file", "Give the path of a file, or remove the element")
        return
    folders = packages or own if scheme in PACKAGES else own
    for text in sorted({rest, unquote(rest)}):
        places = [Path(os.path.abspath(folder / text)) for folder in folders]
        found = [place for place in places if _exists(place)] or places
        for place in found:
            real = _real(place)
            if not any(real.is_relative_to(folder) for folder in (*own, *packages)):
                problem = f"lies outside the folders that files may come from, at {real}"
                remedy = f"Move it below {own[0]}, or name its folder in package_dirs"
                yield Finding(label, value, problem, remedy)
                return


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
