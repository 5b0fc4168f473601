"""The numbers of a URDF: which attributes hold them, how many, and what is wrong with those that do not."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

from eladapt.errors import Finding

DECIMAL = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)


class Number(NamedTuple):
    """A numeric attribute: how many numbers it holds, whether it may be missing, and its bounds.

    Beyond size_limit it is no robot's, and squares and products overflow without a word.
    """

    attribute: str
    size: int = 1
    required: bool = False
    least: float = -math.inf
    size_limit: float = math.inf


NUMBERS = {
    "origin": (Number("xyz", 3, size_limit=1e4), Number("rpy", 3, size_limit=1e4)),
    "mass": (Number("value", required=True, least=0.0, size_limit=1e6),),
    "inertia": tuple(
        Number(key, required=True, size_limit=1e9) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    ),
    "axis": (Number("xyz", 3, required=True, size_limit=1e6),),
    "limit": (
        Number("lower"),
        Number("upper"),
        Number("effort", required=True, least=0.0),
        Number("velocity", required=True, least=0.0),
    ),
    "dynamics": (
        Number("damping", least=0.0, size_limit=1e9),
        Number("friction", least=0.0, size_limit=1e9),
        Number("armature", least=0.0, size_limit=1e9),  # of no standard: a rotor's inertia behind its gear
    ),
    "mimic": (Number("multiplier"), Number("offset")),
    "box": (Number("size", 3),),
    "cylinder": (Number("radius"), Number("length")),
    "sphere": (Number("radius"),),
    "mesh": (Number("scale", 3),),
}
ONCE = ("inertial", "mass", "inertia", "origin", "parent", "child", "axis", "limit", "dynamics")
LINK_PARTS = ("inertial", "visual", "collision")


def parse(text: str, size: int = 1) -> tuple[float, ...] | None:
    """The finite numbers in ``text``, as Pinocchio's reader takes them (blanks only between several)."""
    words = [word for word in text.split(" ") if word] if size > 1 else [text]
    if len(words) != size or not all(DECIMAL.fullmatch(word) for word in words):
        return None
    values = tuple(float(word) for word in words)
    return values if all(map(math.isfinite, values)) else None


def label_of(element: Element) -> str:
    """How messages name a link or joint."""
    return f'{element.tag} "{element.get("name", "")}"'


def parts(root: Element) -> Iterator[tuple[str, Element]]:
    """Each link and joint and the elements inside that dynamics or display read, with a label."""
    for top in (*root.findall("link"), *root.findall("joint")):
        yield label_of(top), top
        inside = [(label_of(top), part) for part in top if top.tag == "joint" or part.tag in LINK_PARTS]
        while inside:
            label, part = inside.pop(0)
            label = f"{label} <{part.tag}>"
            yield label, part
            inside += [(label, child) for child in part]


def number_findings(root: Element) -> Iterator[Finding]:
    """What is missing, repeated, not a finite number or below its least value, in every link and joint."""
    for label, part in parts(root):
        yield from _elements(label, part)
        for number in NUMBERS.get(part.tag, ()):
            yield from _attribute(label, part.get(number.attribute), number)


def _elements(label: str, part: Element) -> Iterator[Finding]:
    counts = Counter(child.tag for child in part)
    for tag in ONCE:
        if counts[tag] > 1:
            problem = "expected one; the reader takes the first and drops the rest"
            yield Finding(f"{label} <{tag}>", f"{counts[tag]} times", problem, "Merge them, or keep one")
    if part.tag == "inertial":
        for tag in ("mass", "inertia"):
            if not counts[tag]:
                remedy = "Add it, or remove <inertial> if the link has no mass"
                yield Finding(f"{label} <{tag}>", "missing", "needed beside the other", remedy)
    if part.tag == "dynamics" and not {"damping", "friction"} & part.attrib.keys():
        yield Finding(label, "empty", "expected damping or friction", "Give one, or remove the element")


def _attribute(label: str, text: str | None, number: Number) -> Iterator[Finding]:
    expected = "a finite number" if number.size == 1 else f"{number.size} finite numbers"
    if text is None:
        if number.required:
            yield Finding(label, f"no {number.attribute}", f"expected {expected}", f"Add {number.attribute}")
        return
    value, values = f'{number.attribute}="{text}"', parse(text, number.size)
    if values is None:
        remedy = "Write decimals such as 0.5 or 1e-3, with blanks only between them"
        yield Finding(label, value, f"expected {expected}", remedy)
    elif min(values) < number.least:
        yield Finding(label, value, f"expected at least {number.least:g}", "Check its sign and unit")
    elif max(map(abs, values)) > number.size_limit:
        yield Finding(label, value, f"expected at most {number.size_limit:g} in size", "Check its unit")
