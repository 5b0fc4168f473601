"""Joints that are held still: which they are, what of them no longer matters, and what moves all the same."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

from eladapt.errors import UnknownNameError
from eladapt.urdf.tree import MIMIC, MOVING, child_value, coupled_joints

SEVERAL = ("floating", "planar")  # of several degrees of freedom: held, they are fixed joints


def held_joints(root: Element, patterns: Iterable[str]) -> tuple[str, ...]:
    """The joints that are to be held, in the file's order.

    In what is no joint's name ``*`` matches any characters, and "mimic" means all moving joints that follow
    another one. Raises UnknownNameError.
    """
    given = [patterns] if isinstance(patterns, str) else list(patterns)
    movable = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
    names = [joint.get("name", "") for joint in movable]
    chosen: set[str] = set()
    unknown = []
    for pattern in given:
        if pattern in names:
            chosen.add(pattern)
        elif pattern == MIMIC:
            chosen.update(coupled_joints(movable))
        elif found := fnmatch.filter(names, pattern):
            chosen.update(found)
        else:
            unknown.append(pattern)
    if unknown:
        raise UnknownNameError("joint", unknown, names)
    return tuple(name for name in names if name in chosen)


def hold(root: Element, names: Iterable[str]) -> None:
    """Settle what no longer matters of these joints, in place.

    One of several degrees of freedom becomes fixed, at its origin. The others follow none and need no
    effort and no velocity; their range stays, which says where they are held.
    """
    names = set(names)
    for joint in root.findall("joint"):
        if joint.get("name", "") not in names:
            continue
        for mimic in joint.findall(MIMIC):
            joint.remove(mimic)
        if joint.get("type") in SEVERAL:
            joint.set("type", "fixed")
        limits = joint.findall("limit") or [SubElement(joint, "limit")]
        for limit in limits:
            limit.set("effort", "0")
            limit.set("velocity", "0")


def moving_links(root: Element, held: Iterable[str]) -> list[Element]:
    """The links that move with a joint that is not held, in the file's order; ``root``: a tree."""
    held = set(held)
    above = {}
    for joint in root.findall("joint"):
        parent, child = (child_value(joint, end, "link", "") for end in ("parent", "child"))
        above[child] = parent, joint.get("type") in MOVING and joint.get("name") not in held
    moving = []
    for link in root.findall("link"):
        name, moves = link.get("name", ""), False
        while name in above and not moves:
            name, moves = above[name]
        if moves:
            moving.append(link)
    return moving
