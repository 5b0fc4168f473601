"""Whether the masses of a URDF lie where an arm of its size can have them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

from eladapt.urdf.holding import moving_links
from eladapt.urdf.numbers import NUMBERS, label_of, parse
from eladapt.urdf.tree import child_value

SHORTEST = 1.0  # [m] a link may be that long, wherever the joints are: those of a pendulum are in one place


def misplaced_masses(root: Element, held: Sequence[str] = ()) -> Iterator[str]:
    """Each moving link whose mass lies farther from it than the arm is long, and what may be meant.

    The mass lies |c| from the link's frame, and sqrt(tr I / 2m), the root mean square, from its centre c. The
    arm is as long as its longest chain of joint origins. Of 75 published files three exceed that, each by
    moments of inertia that are placeholders. ``root``: as it was checked.
    """
    span = _span(root)
    for link in moving_links(root, held):
        inertial = link.find("inertial")
        if inertial is None or (mass := _numbers(inertial.find("mass"))[0]) <= 0:
            continue
        ixx, _, _, iyy, _, izz = _numbers(inertial.find("inertia"))
        centre = math.hypot(*_origin(inertial))
        spread = math.sqrt(max(0.0, (ixx + iyy + izz) / (2 * mass)))
        if centre > max(SHORTEST, span):
            yield (
                f"{label_of(link)}: its centre of mass is {centre:.4g} m from its frame; "
                f"the arm's joints span {span:.3g} m. Is its <origin> in mm?"
            )
        if spread > max(SHORTEST, span):
            yield (
                f"{label_of(link)}: moments of inertia {ixx:g}, {iyy:g} and {izz:g} kg m^2 with {mass:g} kg "
                f"put its mass {spread:.3g} m from its centre; the arm's joints span {span:.3g} m. "
                "Are they in kg mm^2 or g mm^2, or a placeholder?"
            )


def _span(root: Element) -> float:
    """[m] the longest sum of distances from joint to joint, fixed ones included, from the base outwards."""
    parents = {}
    for joint in root.findall("joint"):
        parents[child_value(joint, "child", "link", "")] = (
            child_value(joint, "parent", "link", ""),
            math.hypot(*_origin(joint)),
        )
    longest = 0.0
    for link in parents:
        reach = 0.0
        while link in parents:
            link, step = parents[link]
            reach += step
        longest = max(longest, reach)
    return longest


def _origin(element: Element) -> Sequence[float]:
    return parse(child_value(element, "origin", "xyz", "0 0 0"), 3) or (0.0, 0.0, 0.0)


def _numbers(element: Element | None) -> list[float]:
    """The attributes of an element whose numbers are all required, in the order of `NUMBERS`."""
    if element is None:
        return []
    return [float(element.get(number.attribute, "nan")) for number in NUMBERS[element.tag]]
