"""What the columns of a table are, by its header."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from eladapt.errors import ArgumentError, UnknownNameError

WORDS = {
    "t": ("t", "time", "timestamp", "stamp", "secs", "seconds"),
    "q": ("q", "pos", "position", "positions", "angle"),
    "v": ("v", "dq", "qd", "vel", "velocity", "velocities"),
    "tau": ("tau", "torque", "torques", "effort", "efforts"),
    "current": ("current", "currents"),
}
KIND = {word: name for name, words in WORDS.items() for word in words}
# A word of these, and its number right behind it.
NUMBERED = re.compile(rf"^({'|'.join(sorted(KIND, key=len, reverse=True))})(\d+)$")
SILENT = ("actual", "measured", "state", "states", "joint", "joints")
SAID = 'columns={"t": "time", "q": "q_*", "v": "dq_*", "tau": "tau_*"}'


class Chosen(NamedTuple):
    """Where t, q, v, tau and current stand, and the joints' names where the header has them."""

    of: dict[str, tuple[int, ...]]
    joint_names: tuple[str, ...]


def found_columns(header: Sequence[str], width: int) -> Chosen:
    """By the words in a header, or by their number where there is none. Raises ArgumentError."""
    if not header:
        count, rest = divmod(width - 1, 3)
        if count < 1 or rest:
            raise ArgumentError(
                f"expected a header, or columns t, q, v, tau (1 + 3 n of them), got {width} columns; "
                f"say which they are: {SAID}"
            )
        spans = (range(1 + k * count, 1 + (k + 1) * count) for k in range(3))
        return Chosen({"t": (0,), **dict(zip(("q", "v", "tau"), map(tuple, spans), strict=True))}, ())
    found: dict[str, dict[str, int]] = {}
    for k, name in enumerate(header):
        kind, joint = _meaning(name)
        if not kind or (kind == "t" and "t" in found):
            continue
        if joint in found.setdefault(kind, {}):
            raise ArgumentError(
                f"columns {header[found[kind][joint]]!r} and {name!r} both look like {kind} of "
                f"{joint or 'the same joint'}; say which it is: {SAID}"
            )
        found[kind][joint] = k
    if missing := [kind for kind in ("t", "q") if kind not in found]:
        raise ArgumentError(
            f"no column looks like {' or '.join(missing)} ({', '.join(WORDS[missing[0]])}) among "
            f"{', '.join(header)}; say which they are: {SAID}"
        )
    joints = tuple(found["q"])
    for kind in ("v", "tau", "current"):
        if kind in found and set(found[kind]) != set(joints):
            differing = sorted(set(found[kind]) ^ set(joints))
            raise ArgumentError(
                f"columns of q and {kind} are not of the same joints ({', '.join(differing)}); say which "
                f"they are: {SAID}"
            )
    of = {kind: tuple(found[kind][joint] for joint in joints) for kind in found if kind != "t"}
    counted = all(joint.isdigit() for joint in joints)
    return Chosen({"t": tuple(found["t"].values())[:1], **of}, () if counted else joints)


def mapped_columns(header: Sequence[str], width: int, columns: Mapping[str, Any]) -> Chosen:
    """As the user says. Raises ArgumentError, UnknownNameError."""
    if unknown := [name for name in columns if name not in WORDS]:
        raise UnknownNameError("quantity of columns", unknown, list(WORDS))
    of = {name: _chosen(name, given, header, width) for name, given in columns.items()}
    if missing := [name for name in ("t", "q") if not of.get(name)]:
        raise ArgumentError(f"columns: expected some for {' and '.join(missing)}; for example {SAID}")
    sizes = {name: len(which) for name, which in of.items() if name != "t"}
    if len(of["t"]) != 1 or len(set(sizes.values())) != 1:
        said = ", ".join(f"{size} of {name}" for name, size in {"t": len(of["t"]), **sizes}.items())
        raise ArgumentError(f"columns: expected one of t and as many of each other quantity, got {said}")
    return Chosen(of, ())


def _chosen(name: str, given: Any, header: Sequence[str], width: int) -> tuple[int, ...]:
    chosen: list[int] = []
    for one in [given] if isinstance(given, str | int) else list(given):
        if isinstance(one, int):
            matches = [one] if 0 <= one < width else []
        else:
            matches = [k for k, column in enumerate(header) if fnmatch.fnmatchcase(column, one)]
        if not matches:
            legal = list(header) or [f"0 to {width - 1}"]
            raise UnknownNameError(f"column of {name}", [str(one)], legal)
        chosen.extend(matches)
    return tuple(chosen)


def _meaning(column: str) -> tuple[str, str]:
    """(kind, joint) of a header's name; no kind where it has no word for one."""
    parts = [part for part in re.split(r"[^A-Za-z0-9]+", column) if part]
    for k, part in enumerate(parts):
        word = part.lower()
        if match := NUMBERED.match(word):
            return KIND[match[1]], _joint([*parts[:k], match[2], *parts[k + 1 :]])
        if word in KIND:
            return KIND[word], _joint(parts[:k] + parts[k + 1 :])
    return "", ""


def _joint(parts: Sequence[str]) -> str:
    """What is left of a column's name, without words in front that name no joint."""
    left = list(parts)
    while len(left) > 1 and left[0].lower() in SILENT:
        left = left[1:]
    return "_".join(left)
