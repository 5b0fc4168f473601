"""How links and joints of a URDF hang together: names, kinds, limits, one tree, and who follows whom."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from xml.etree.ElementTree import Element

from eladapt.errors import Finding
from eladapt.urdf.numbers import label_of, parse

MOVING = ("revolute", "continuous", "prismatic")
MIMIC = "mimic"
SHORTEST_AXIS = 1e-6


def names(root: Element) -> Iterator[Finding]:
    """Names that are missing or given twice, and a robot without links or joints."""
    if not root.get("name"):
        yield Finding("<robot>", "no name", "a robot needs a name", 'Write <robot name="...">')
    for name, times in Counter(element.get("name", "") for element in root.findall("material")).items():
        if times > 1:
            yield Finding(f'material "{name}"', f"{times} times", "names must differ", "Keep one of them")
    for tag in ("link", "joint"):
        names = Counter(element.get("name", "") for element in root.findall(tag))
        if not names:
            yield Finding("<robot>", f"no <{tag}>", "expected links with joints between", f"Add a <{tag}>")
        for name, times in names.items():
            if not name:
                yield Finding(f"<{tag}>", "no name", f"a {tag} needs a name", f'Write <{tag} name="...">')
            elif times > 1:
                yield Finding(f'{tag} "{name}"', f"{times} times", "names must differ", "Rename the others")


def joints(root: Element) -> Iterator[Finding]:
    """Joints of a kind, between links, about an axis or in a range that cannot be."""
    links = {link.get("name", "") for link in root.findall("link")}
    for joint in root.findall("joint"):
        label, kind = label_of(joint), joint.get("type", "")
        if kind not in (*MOVING, "fixed"):
            problem = f"expected {', '.join(MOVING)} or fixed"
            remedy = "Lock the joint (locked=, --lock), fix it, or split it into these; the base is fixed"
            yield Finding(label, f'type="{kind}"', problem, remedy)
        for end in ("parent", "child"):
            if (name := child_value(joint, end, "link", "")) not in links:
                problem, remedy = "no link has this name", f"Name one of {listed(sorted(links))}"
                yield Finding(f"{label} <{end}>", f'link="{name}"', problem, remedy)
        axis = parse(text := child_value(joint, "axis", "xyz", "1 0 0"), 3)
        if kind in MOVING and axis and math.hypot(*axis) < SHORTEST_AXIS:
            yield Finding(
                f"{label} <axis>", f'xyz="{text}"', "it has no direction", 'Give one, such as "0 0 1"'
            )
        if kind in ("revolute", "prismatic"):
            yield from _range(joint, f"{label} <limit>")


def _range(joint: Element, label: str) -> Iterator[Finding]:
    lower, upper = child_value(joint, "limit", "lower", "0"), child_value(joint, "limit", "upper", "0")
    low, high = parse(lower), parse(upper)
    if joint.find("limit") is None:
        remedy = "Add one, or lock the joint; an effort, a velocity or a range of 0 means that it is not set"
        yield Finding(label, "missing", f"a {joint.get('type')} joint needs it", remedy)
    elif low and high and low[0] > high[0]:
        value = f'lower="{lower}" upper="{upper}"'
        yield Finding(label, value, "lower exceeds upper", "Swap them, or mend one")


def tree(root: Element) -> Iterator[Finding]:
    """Whatever keeps links and joints from being one tree on one base."""
    links = list(dict.fromkeys(name for link in root.findall("link") if (name := link.get("name"))))
    parents: dict[str, str] = {}
    joints: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        child = child_value(joint, "child", "link", "")
        parents.setdefault(child, child_value(joint, "parent", "link", ""))
        joints.setdefault(child, []).append(joint.get("name", ""))
    for child, names in joints.items():
        if len(names) > 1:
            value, remedy = f"child of joints {listed(names)}", "Keep one of these joints, to leave a tree"
            yield Finding(f'link "{child}"', value, "a link with two parents closes a loop", remedy)
    bases = [link for link in links if link not in parents]
    misspelt = not {*parents, *parents.values()} <= set(links)  # leaves a link alone; it is reported as such
    if len(bases) > 1 and not misspelt:
        problem, remedy = (
            "expected one link without a parent",
            "Join the others to it, if only by fixed joints",
        )
        yield Finding("<robot>", f"base links {listed(bases)}", problem, remedy)
    settled: set[str] = set()
    for link in parents:
        trail: list[str] = []
        while link in parents and link not in settled:
            settled.add(link)
            trail.append(link)
            link = parents[link]
        if link in trail:
            value = f"links {listed(trail[trail.index(link) :])}"
            yield Finding(
                "<robot>", value, "each is below the next, in a cycle", "Remove a joint between them"
            )


def mimics(root: Element) -> Iterator[Finding]:
    """Joints that follow none, or each other in a circle, and those that would be left without a torque."""
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    leaders = {
        name: child_value(joint, MIMIC, "joint", "")
        for name, joint in joints.items()
        if joint.find(MIMIC) is not None
    }
    coupled = coupled_joints(joints.values())
    for name, leader in leaders.items():
        label = f'joint "{name}" <{MIMIC}>'
        if leader not in joints:
            remedy = f"Name one of {listed(sorted(joints))}"
            yield Finding(label, f'joint="{leader}"', "no joint has this name", remedy)
            continue
        trail = [name]
        while leader in leaders and leader not in trail:
            trail.append(leader)
            leader = leaders[leader]
        if leader not in trail and name in coupled:
            value, problem = f"mimics {leaders[name]!r}", "a coupled joint has no torque of its own"
            remedy = f"Lock {listed(coupled)}, or all that are coupled: locked=[{MIMIC!r}]"
            yield Finding(f'joint "{name}"', value, problem, remedy)
        elif leader in trail and name == min(trail[trail.index(leader) :]):  # a circle is one fault
            value = f"joints {listed(trail[trail.index(leader) :])}"
            yield Finding(label, value, "each follows the next, in a circle", "Let one of them follow none")


def coupled_joints(joints: Iterable[Element]) -> list[str]:
    """The names of those of these joints that move as another one does."""
    return [j.get("name", "") for j in joints if j.get("type") in MOVING and j.find(MIMIC) is not None]


def child_value(element: Element, tag: str, key: str, default: str) -> str:
    """What an element's child of that tag says, else the default."""
    child = element.find(tag)
    return default if child is None else child.get(key, default)


def listed(names: Iterable[str], most: int = 8) -> str:
    """``"a", "b" and 3 more``."""
    names = list(names)
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(f'"{name}"' for name in names[:most]) + rest
