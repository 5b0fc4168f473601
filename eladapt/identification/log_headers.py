"""What the columns of a table are, by its header."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from eladapt.errors import ArgumentError, UnknownNameError

WORDS = {
    "t": ("t", "time", "timestamp", "stamp", "sec", "secs", "seconds"),
    "nanoseconds": ("nanosec", "nanosecs", "nsec", "nsecs", "nanoseconds"),  # beside whole seconds
    "q": ("q", "pos", "position", "positions", "angle"),
    "v": ("v", "dq", "qd", "vel", "velocity", "velocities"),
    "tau": ("tau", "torque", "torques", "effort", "efforts"),
    "current": ("current", "currents"),
}
KIND = {word: name for name, words in WORDS.items() for word in words}
# A word of these, and its number right behind it.
NUMBERED = re.compile(rf"^({'|'.join(sorted(KIND, key=len, reverse=True))})(\d+)$")
SILENT = ("field", "actual", "measured", "state", "states", "joint", "joints")
ASKED = ("target", "desired", "command", "commanded", "cmd", "reference", "ref", "setpoint", "goal")
SAID = 'columns={"t": "time", "q": "q_*", "v": "dq_*", "tau": "tau_*"}'
STAMPS = ("t", "nanoseconds")
SHOWN = 12  # names of a header that an error shows


class Chosen(NamedTuple):
    """Where t, q, v, tau and current stand, and the joints' names where the header has them."""

    of: dict[str, tuple[int, ...]]
    joint_names: tuple[str, ...]


class _Column(NamedTuple):
    """What a name says: the kind of its numbers, of which joint, and whether they were only asked for."""

    kind: str
    joint: str
    asked: bool = False


def is_number(cell: str) -> bool:
    """Whether a cell of a table is one."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def found_columns(header: Sequence[str], width: int) -> Chosen:
    """By the words in a header, or by their number where there is none. Raises ArgumentError.

    What was asked for (target, desired, command) counts only where nothing of its kind was measured.
    """
    if not header:
        count, rest = divmod(width - 1, 3)
        if count < 1 or rest:
            raise ArgumentError(
                f"expected a header, or columns t, q, v, tau (1 + 3 n of them), got {width} columns; "
                f"say which they are: {SAID}"
            )
        spans = (range(1 + k * count, 1 + (k + 1) * count) for k in range(3))
        return Chosen({"t": (0,), **dict(zip(("q", "v", "tau"), map(tuple, spans), strict=True))}, ())
    meanings = [_meaning(name) for name in header]
    measured = {column.kind for column in meanings if not column.asked}
    found: dict[str, dict[str, int]] = {}
    for k, (name, (kind, joint, asked)) in enumerate(zip(header, meanings, strict=True)):
        if not kind or (asked and kind in measured) or (kind in STAMPS and kind in found):
            continue
        if joint in found.setdefault(kind, {}):
            raise ArgumentError(
                f"columns {header[found[kind][joint]]!r} and {name!r} both look like {kind} of "
                f"{joint or 'the same joint'}; say which it is: {SAID}"
            )
        found[kind][joint] = k
    if missing := [kind for kind in ("t", "q") if kind not in found]:
        shown = ", ".join(header[:SHOWN]) + (f" and {len(header) - SHOWN} more" if header[SHOWN:] else "")
        raise ArgumentError(
            f"no column looks like {' or '.join(missing)} ({', '.join(WORDS[missing[0]])}) among {shown}; "
            f"say which they are: {SAID}"
        )
    stamps = _stamps(header, found)
    return _aligned({kind: found[kind] for kind in found if kind not in STAMPS}, stamps)


def _stamps(header: Sequence[str], found: Mapping[str, Mapping[str, int]]) -> dict[str, tuple[int, ...]]:
    """The column of t, and that of the nanoseconds behind its whole seconds."""
    (t,) = found["t"].values()
    stamps: dict[str, tuple[int, ...]] = {"t": (t,)}
    seconds = re.split(r"[^A-Za-z]+", header[t].lower())[-1]
    if "nanoseconds" in found and seconds in ("sec", "secs", "seconds"):
        stamps["nanoseconds"] = tuple(found["nanoseconds"].values())
    return stamps


def echoed_columns(cells: Sequence[str]) -> Chosen | None:
    """Of a JointState as ``ros2 topic echo --csv`` writes it: sec, nanosec, frame, n names, q, v and tau.

    None of other lines.
    """
    count, rest = divmod(len(cells) - 3, 4)
    names = tuple(cells[3 : 3 + count])
    if count < 1 or rest or any(map(is_number, (*cells[2:3], *names))):
        return None
    spans = (tuple(range(3 + k * count, 3 + (k + 1) * count)) for k in (1, 2, 3))
    of = dict(zip(("q", "v", "tau"), spans, strict=True))
    return Chosen({"t": (0,), "nanoseconds": (1,), **of}, names)


def mapped_columns(header: Sequence[str], width: int, columns: Mapping[str, Any]) -> Chosen:
    """As the user says. Raises ArgumentError, UnknownNameError."""
    if not isinstance(columns, Mapping):
        raise ArgumentError(f"columns: expected which they are by quantity, as {SAID}, got {columns!r}")
    if unknown := [name for name in columns if name not in WORDS]:
        raise UnknownNameError("quantity of columns", unknown, list(WORDS))
    of = {name: _chosen(name, given, header, width) for name, given in columns.items()}
    if missing := [name for name in ("t", "q") if not of.get(name)]:
        raise ArgumentError(f"columns: expected some for {' and '.join(missing)}; for example {SAID}")
    stamps, sizes = ({name: len(of[name]) for name in of if (name in STAMPS) == one} for one in (True, False))
    if set(stamps.values()) != {1} or len(set(sizes.values())) != 1:
        said = ", ".join(f"{size} of {name}" for name, size in {**stamps, **sizes}.items())
        raise ArgumentError(f"columns: expected one of t and as many of each other quantity, got {said}")
    return _paired(columns, header, of)


def _paired(columns: Mapping[str, Any], header: Sequence[str], of: dict[str, tuple[int, ...]]) -> Chosen:
    """Patterns with one star each are of the same joints, which the star names; lists are as they stand."""
    given = {name: columns[name] for name in of if name not in STAMPS}
    if not all(
        isinstance(one, str) and one.count("*") == 1 and not set(one) & set("?[") for one in given.values()
    ):
        return Chosen(of, ())
    found = {}
    for name, pattern in given.items():
        before, behind = map(len, pattern.split("*"))
        stars = {k: header[k][before : len(header[k]) - behind] for k in of[name]}
        found[name] = {_joint(_parts(star)): k for k, star in stars.items()}
    if any(len(found[name]) != len(of[name]) for name in found):
        return Chosen(of, ())
    return _aligned(found, {name: of[name] for name in of if name in STAMPS})


def _aligned(found: Mapping[str, Mapping[str, int]], stamps: Mapping[str, tuple[int, ...]]) -> Chosen:
    """Columns by kind and joint, in one order of joints: that of q, or by number. Raises ArgumentError."""
    joints = tuple(found["q"])
    if counted := all(joint.isdigit() for joint in joints):
        joints = tuple(sorted(joints, key=int))
    for kind, columns in found.items():
        if differing := sorted(set(columns) ^ set(joints)):
            raise ArgumentError(
                f"columns of q and {kind} are not of the same joints ({', '.join(differing)}); say which "
                f"they are: {SAID}"
            )
    of = {kind: tuple(columns[joint] for joint in joints) for kind, columns in found.items()}
    return Chosen({**stamps, **of}, () if counted else joints)


def _chosen(name: str, given: Any, header: Sequence[str], width: int) -> tuple[int, ...]:
    chosen: list[int] = []
    for one in given if isinstance(given, Sequence) and not isinstance(given, str) else [given]:
        if isinstance(one, int):
            matches = [one] if 0 <= one < width else []
        else:
            matches = [k for k, column in enumerate(header) if fnmatch.fnmatchcase(column, str(one))]
        if not matches:
            legal = list(header) or [f"0 to {width - 1}"]
            raise UnknownNameError(f"column of {name}", [str(one)], legal)
        chosen.extend(matches)
    return tuple(chosen)


def _meaning(column: str) -> _Column:
    """No kind where a header's name has no word for one."""
    parts = _parts(column)
    asked = any(part.lower() in ASKED for part in parts)
    parts = [part for part in parts if part.lower() not in ASKED]
    if any(part.lower() in WORDS["nanoseconds"] for part in parts):
        return _Column("nanoseconds", "")
    for k, part in enumerate(parts):
        word = part.lower()
        if match := NUMBERED.match(word):
            return _Column(KIND[match[1]], _joint([*parts[:k], match[2], *parts[k + 1 :]]), asked)
        if word in KIND:
            return _Column(KIND[word], _joint(parts[:k] + parts[k + 1 :]), asked)
    return _Column("", "")


def _parts(name: str) -> list[str]:
    return [part for part in re.split(r"[^A-Za-z0-9]+", name) if part]


def _joint(parts: Sequence[str]) -> str:
    """What is left of a column's name, without words in front that name no joint.

    "joint" does so only before a number, or as a topic, joint_states, whatever stands before that.
    """
    left = list(parts)
    lower = [part.lower() for part in left]
    for k in range(1, len(left) - 1):
        if lower[k - 1] == "joint" and lower[k] in ("state", "states"):
            left = left[k + 1 :]
            break
    while len(left) > 1 and left[0].lower() in SILENT:
        if left[0].lower() in ("joint", "joints") and not left[1].isdigit():
            break
        left = left[1:]
    return "_".join(left)
