"""The meshes that a URDF names: opened from its own folder and the packages' alone.

A file is judged by where it really is, links resolved, and opened there. Dynamics need no meshes: a robot
whose meshes are refused, or on another computer, is read all the same, and drawn without them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote
from xml.etree.ElementTree import Element

from eladapt.errors import MeshError
from eladapt.urdf.numbers import parse

PACKAGES = ("package", "model")  # schemes that name a folder below one of the package_dirs


class Folders(NamedTuple):
    """Where files may come from: the URDF's own folder, links to it resolved or not, and the packages'."""

    own: list[Path]
    packages: list[Path]

    @classmethod
    def of(cls, urdf: Path | None, package_dirs: Sequence[str | Path] = ()) -> Folders:
        """urdf: None for a file that is not there any more, and so opens no folder."""
        own = set() if urdf is None else {urdf.parent.resolve(), urdf.resolve().parent}
        return cls(sorted(own), [Path(folder).resolve() for folder in package_dirs])

    def located(self, name: str) -> Path:
        """The file of this name, links resolved. Raises MeshError for one that is refused or nowhere."""
        scheme, _, rest = name.rpartition("://")
        if scheme not in ("", "file", *PACKAGES):
            remedy = "Copy the file beside the URDF and give its path from there"
            raise _refusal(name, f"{scheme}:// is not read; expected a path, package:// or file://", remedy)
        if not rest or "\0" in rest:
            raise _refusal(name, "names no file", "Give the path of a file, or remove the element")
        folders = self.packages or self.own if scheme in PACKAGES else self.own or self.packages
        if not folders:
            problem = "the robot file that names it is not there any more"
            raise _refusal(name, problem, "Name the folder of its meshes in package_dirs (--package-dir)")
        opened = [*self.own, *self.packages, *self._linked(rest)]
        texts = dict.fromkeys((rest, unquote(rest)))  # as it is, and without percent signs
        places = [_real(Path(os.path.abspath(folder / text))) for text in texts for folder in folders]
        found = [place for place in places if _exists(place)]
        for place in found or places:
            if not any(place.is_relative_to(folder) for folder in opened):
                problem = f"lies outside the folders that files may come from, at {place}"
                remedy = f"Move it below {opened[0]}, or name its folder in package_dirs (--package-dir)"
                raise _refusal(name, problem, remedy)
        if not found:
            looked = ", ".join(sorted({str(place.parent) for place in places}))
            remedy = "Put it there, or name its folder in package_dirs (--package-dir)"
            raise _refusal(name, f"there is none in {looked}", remedy)
        return found[0]

    def _linked(self, rest: str) -> list[Path]:
        """Where links directly in the package_dirs lead whose name begins ``rest``: package folders, as a
        workspace has them."""
        name = rest.partition("/")[0]
        if name in ("", ".", ".."):
            return []
        return [_real(link) for folder in self.packages if (link := folder / name).is_symlink()]


class MeshUse(NamedTuple):
    """A mesh as a URDF names it."""

    filename: str
    scale: tuple[float, ...]  # (3,)


def set_meshes_aside(root: Element) -> dict[str, MeshUse]:
    """Make boxes of all meshes and leave textures out, in place, so that a reader opens no file.

    Returns the meshes of the visuals by the names that Pinocchio gives their shapes.
    """
    uses = {}
    for link in root.findall("link"):
        for number, visual in enumerate(link.findall("visual")):
            form = visual.find("geometry/*")
            if form is not None and form.tag == "mesh":
                scale = parse(form.get("scale", "1 1 1"), 3) or (1.0, 1.0, 1.0)
                uses[f"{link.get('name')}_{number}"] = MeshUse(form.get("filename", ""), scale)
    for mesh in list(root.iter("mesh")):
        mesh.tag, mesh.attrib = "box", {"size": "1 1 1"}
    for material in root.iter("material"):
        for texture in material.findall("texture"):
            material.remove(texture)
            if material.find("color") is None:
                material.append(material.makeelement("color", {"rgba": "1 1 1 1"}))
    return uses


def _refusal(name: str, problem: str, remedy: str) -> MeshError:
    return MeshError(f'"{name}": {problem}. {remedy}')


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
