"""``eladapt identify``: from a log to parameters, a URDF and a page."""

from __future__ import annotations

import argparse
import contextlib
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from eladapt.cli.checking import find
from eladapt.cli.saying import Outcome, say, say_table
from eladapt.errors import ArgumentError, LogWarning
from eladapt.identification.found import Identified
from eladapt.identification.identify import identify as identified
from eladapt.identification.log import Log


def identify(options: argparse.Namespace) -> Outcome:
    """Read the log, identify, write what was asked for, and say how well the parameters predict."""
    if options.out is not None and options.out.suffix.lower() not in (".urdf", ".xml"):
        raise ArgumentError(f"--out: expected a name that ends in .urdf, got {options.out.name!r}")
    if options.report is not None:
        from eladapt.display.pages import require_page

        require_page(options.report)
    robot = find(options)
    columns = _columns(options.column) or None
    gains = None if options.gains is None else [x for part in options.gains for x in part]
    log = Log.read(
        options.log, columns=columns, joint_names=options.joint or (), gains=gains, degrees=options.degrees,
        held=options.held, topic=options.topic,
    )  # fmt: skip
    with _said_once():
        found = identified(robot, log, held_out=options.held_out, progress=not options.quiet)
    written = {}
    if options.report is not None:
        written["report"] = found.report(options.report)
    lost = None  # a URDF that cannot be written loses nothing of the rest
    if options.out is not None and found.physical is not None:
        written["urdf"] = found.save_urdf(options.out)
    elif options.out is not None:
        lost = f"--out: {options.out} is not written, since there are no physical parameters; see above"
    _say(log, found)
    for path in written.values():
        say(f"wrote {path}")
    if lost is not None:
        raise ArgumentError(lost)
    return Outcome(_found(found, written))


@contextlib.contextmanager
def _said_once() -> Iterator[None]:
    """What is warned of a log stands among the notes of what is found, and is said only where nothing is."""
    caught: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
            caught[:] = [warning for warning in caught if not issubclass(warning.category, LogWarning)]
    finally:
        for warning in caught:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def _say(log: Log, found: Identified) -> None:
    say(log)
    say_table(found)
    say_table(f"\n{found.friction}")
    for said in found.merged if found.physical is not None else ():
        say(f"- {said}")


def _found(found: Identified, written: dict[str, Any]) -> dict[str, Any]:
    """For --json."""
    physical = found.physical if found.physical is not None else [None] * len(found.theta)
    columns = (found.labels, found.theta, found.std, physical)
    return {
        "robot": found.original.name,
        "joints": found.original.joint_names,
        "parameters": [
            {"label": label, "value": value, "std": std, "physical": possible}
            for label, value, std, possible in zip(*columns, strict=True)
        ],
        "untold": found.untold,
        "held_out": found.held_out,
        "errors": found.errors,
        "friction": found.friction,
        "notes": found.notes,
        "merged": found.merged,
        "written": written,
    }


def _columns(given: Sequence[str]) -> dict[str, Any]:
    """By quantity: a pattern, or the list of names and numbers that its options give together."""
    found: dict[str, list[str | int]] = {}
    for pair in given:
        quantity, _, said = pair.partition("=")
        found.setdefault(quantity, []).extend(int(x) if x.isdigit() else x for x in said.split(","))
    return {quantity: names[0] if len(names) == 1 else names for quantity, names in found.items()}
