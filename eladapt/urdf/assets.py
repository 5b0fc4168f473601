"""The files that a URDF names, meshes and textures: from its own folder and the packages' alone.

A file is judged by where it really is, links resolved. One that does not exist is no fault as long as it
would lie inside: dynamics need no meshes. Those that are drawn are opened where they were judged to be.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote
from xml.etree.ElementTree import Element

from eladapt.errors import Finding, MeshError
from eladapt.urdf.numbers import parse, parts

NAMING = ("mesh", "texture")
PACKAGES = ("package", "model")  # schemes that name a folder below one of the package_dirs


class Folders(NamedTuple):
    """Where files may come from: the URDF's own folder, links to it resolved or not, and the packages'."""

    own: list[Path]
    packages: list[Path]

    @classmethod
    def of(cls, urdf: Path, package_dirs: Sequence[str | Path] = ()) -> Folders:
        own = {urdf.parent.resolve(), urdf.resolve().parent}
        return cls(sorted(own), [Path(folder).resolve() for folder in package_dirs])

    def refusal(self, name: str) -> tuple[str, str] | None:
        """What is wrong with the file of this name, and what to do; None if it may be opened."""
        scheme, rest = _split(name)
        if scheme not in ("", "file", *PACKAGES):
            remedy = "Copy the file beside the URDF and give its path from there"
            return f"{scheme}:// is not read; expected a path, package:// or file://", remedy
        if not rest or "\0" in rest:
            return "names no file", "Give the path of a file, or remove the element"
        for spelling in self._spellings(name):
            for place in [place for place in spelling if _exists(place)] or spelling:
                if not any(place.is_relative_to(folder) for folder in (*self.own, *self.packages)):
                    problem = f"lies outside the folders that files may come from, at {place}"
                    return problem, f"Move it below {self.own[0]}, or name its folder in package_dirs"
        return None

    def located(self, name: str) -> Path:
        """The file of this name, links resolved. Raises MeshError for one that is refused or nowhere."""
        if refusal := self.refusal(name):
            raise MeshError(f'"{name}": {". ".join(refusal)}')
        places = [place for spelling in self._spellings(name) for place in spelling]
        for place in places:
            if _exists(place):
                return place
        looked = ", ".join(sorted({str(place.parent) for place in places}))
        remedy = "Put it there, or name its folder in package_dirs (--package-dir)"
        raise MeshError(f'"{name}": there is none in {looked}. {remedy}')

    def _spellings(self, name: str) -> list[list[Path]]:
        """Where the file may be, links resolved, for its name as it is and without percent signs."""
        scheme, rest = _split(name)
        folders = self.packages or self.own if scheme in PACKAGES else self.own
        texts = dict.fromkeys((rest, unquote(rest)))
        return [[_real(Path(os.path.abspath(folder / text))) for folder in folders] for text in texts]


class MeshUse(NamedTuple):
    """A mesh as a URDF names it."""

    filename: str
    scale: tuple[float, ...]  # (3,)


def file_findings(root: Element, urdf: Path, package_dirs: Sequence[str | Path] = ()) -> Iterator[Finding]:
    """Every file that is named and lies outside the allowed folders, or that no reader knows to find."""
    folders = Folders.of(urdf, package_dirs)
    materials = [(f'material "{m.get("name", "")}"', t) for m in root.findall("material") for t in m]
    for label, part in (*parts(root), *materials):
        name = part.get("filename")
        if part.tag in NAMING and name is not None and (refusal := folders.refusal(name)):
            yield Finding(label, f'filename="{name}"', *refusal)


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


def _split(name: str) -> tuple[str, str]:
    scheme, _, rest = name.rpartition("://")
    return scheme, rest


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
