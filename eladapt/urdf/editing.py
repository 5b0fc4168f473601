"""New inertias, friction and rotors in a URDF's text, which is otherwise kept to the letter, comments too."""

from __future__ import annotations

import codecs
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple
from xml.parsers import expat

import pinocchio as pin

from eladapt.errors import UnknownNameError, require_vector

AXES = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
DYNAMICS = ("damping", "friction", "armature")


class Edits(NamedTuple):
    """What of links and joints is to be another than in the file; plain types.

    inertials: by link, the ten parameters of its inertia about the origin of its frame (m, m c, Ixx, Ixy,
    Iyy, Ixz, Iyz, Izz), or None for a link that has none any more. dynamics: by joint, any of "damping",
    "friction" and "armature".
    """

    inertials: Mapping[str, list[float] | None] = {}
    dynamics: Mapping[str, Mapping[str, float]] = {}


class _Part(NamedTuple):
    """An element's place in the text, and where its end tag begins: its own end, if it has none."""

    start: int
    end: int
    inside: int


def inertial_text(body: pin.Inertia) -> str:
    """<inertial> of an inertia in its link's frame."""
    xyz = " ".join(repr(float(x)) for x in body.lever)
    moments = " ".join(f'{key}="{float(body.inertia[at])!r}"' for key, at in AXES.items())
    return (
        f'<inertial><origin xyz="{xyz}" rpy="0 0 0"/><mass value="{float(body.mass)!r}"/>'
        f"<inertia {moments}/></inertial>"
    )


def edited(text: bytes, edits: Edits) -> bytes:
    """The text of a URDF that has been found sound, with these edits.

    Raises UnknownNameError for links, joints and dynamics that there are not, ArgumentError for an inertia
    that is not ten numbers.
    """
    text = _plain(text)
    elements = _Elements(text)
    elements.require("link", edits.inertials)
    elements.require("joint", edits.dynamics)
    for joint, given in edits.dynamics.items():
        if unknown := [name for name in given if name not in DYNAMICS]:
            raise UnknownNameError(f"dynamics of {joint}", unknown, DYNAMICS)
    pieces: list[tuple[int, int, bytes]] = []
    for link, parameters in edits.inertials.items():
        new = (
            ""
            if parameters is None
            else inertial_text(
                pin.Inertia.FromDynamicParameters(require_vector(f"inertials of {link}", parameters, 10))
            )
        )
        if new or ("link", link, "inertial") in elements.parts:
            pieces.append(elements.replaced("link", link, "inertial", new))
    for joint, given in edits.dynamics.items():
        before = elements.attributes.get(("joint", joint, "dynamics"), {})
        least = {} if {"damping", "friction"} & before.keys() else {"damping": "0.0"}  # that readers ask for
        values = {**least, **before, **{key: repr(float(value)) for key, value in given.items()}}
        new = f"<dynamics {' '.join(f'{key}={_quoted(value)}' for key, value in values.items())}/>"
        pieces.append(elements.replaced("joint", joint, "dynamics", new))
    for start, end, piece in sorted(pieces, reverse=True):
        text = text[:start] + piece + text[end:]
    return text


class _Elements:
    """Where links and joints, their <inertial> and their <dynamics> stand in a text."""

    def __init__(self, text: bytes):
        self.text = text
        self.parts: dict[tuple[str, ...], _Part] = {}
        self.attributes: dict[tuple[str, ...], dict[str, str]] = {}
        self._path: list[tuple[tuple[str, ...], int]] = []
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._opened
        self._parser.EndElementHandler = self._closed
        self._parser.Parse(text, True)

    def require(self, tag: str, names: Iterable[str]) -> None:
        """Raises UnknownNameError for names that no element of this tag has."""
        if unknown := [name for name in names if (tag, name) not in self.parts]:
            raise UnknownNameError(
                tag, unknown, [key[1] for key in self.parts if key[0] == tag and not key[2:]]
            )

    def replaced(self, tag: str, name: str, child: str, new: str) -> tuple[int, int, bytes]:
        """(start, end, bytes): what takes the place of a child, or is put in as the last one."""
        if (tag, name, child) in self.parts:
            part = self.parts[tag, name, child]
            return part.start, part.end, new.encode()
        whole = self.parts[tag, name]
        if whole.inside < whole.end:
            return whole.inside, whole.inside, f"  {new}\n  ".encode()
        slash = self.text.rindex(b"/", whole.start, whole.end)  # <link name="..."/>
        return slash, whole.end, f">\n    {new}\n  </{tag}>".encode()

    def _opened(self, tag: str, attributes: dict[str, str]) -> None:
        key: tuple[str, ...] = ()
        if len(self._path) == 1 and tag in ("link", "joint"):
            key = (tag, attributes.get("name", ""))
        elif len(self._path) == 2 and self._path[-1][0]:
            key = (*self._path[-1][0], tag)
            self.attributes.setdefault(key, attributes)
        self._path.append((key, self._parser.CurrentByteIndex))

    def _closed(self, _tag: str) -> None:
        key, start = self._path.pop()
        if not key or key in self.parts:
            return
        end = self._tag_end(start)
        inside = end
        if not self.text.endswith(b"/>", start, end):
            inside = self._parser.CurrentByteIndex
            end = self.text.index(b">", inside) + 1
        self.parts[key] = _Part(start, end, inside)

    def _tag_end(self, start: int) -> int:
        """Behind the > of the tag that begins there, whatever stands in its quotes."""
        quote = 0
        for k in range(start, len(self.text)):
            byte = self.text[k]
            if quote:
                quote = 0 if byte == quote else quote
            elif byte in b"\"'":
                quote = byte
            elif byte == ord(">"):
                return k + 1
        return len(self.text)


def _plain(text: bytes) -> bytes:
    """In an encoding whose first half is ASCII."""
    if text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        whole = text.decode("utf-16")
        return (
            whole[whole.find("?>") + 2 :].lstrip().encode() if whole.startswith("<?xml") else whole.encode()
        )
    return text


def _quoted(value: Any) -> str:
    return '"' + str(value).replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;") + '"'
