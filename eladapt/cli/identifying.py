"""``eladapt identify``: from a log to parameters, a URDF and a page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from eladapt.cli.checking import find
from eladapt.cli.saying import say, say_table
from eladapt.errors import ArgumentError
from eladapt.identification.identify import identify as identified
from eladapt.identification.log import Log


def identify(options: argparse.Namespace) -> None:
    """Read the log, identify, say how well the parameters predict, and write what was asked for."""
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
    say(log)
    for note in log.notes:
        say(f"- {note}")
    found = identified(robot, log, held_out=options.held_out, progress=sys.stderr.isatty())
    say_table(str(found))
    say_table(f"\n{found.friction}")
    for said in found.merged:
        say(f"- {said}")
    if options.out is not None:
        say(f"wrote {found.save_urdf(options.out)}")
    if options.report is not None:
        say(f"wrote {found.report(options.report)}")


def _columns(given: Sequence[str]) -> dict[str, Any]:
    """By quantity: a pattern, or the list of names and numbers that its options give together."""
    found: dict[str, list[str | int]] = {}
    for pair in given:
        quantity, _, said = pair.partition("=")
        found.setdefault(quantity, []).extend(int(x) if x.isdigit() else x for x in said.split(","))
    return {quantity: names[0] if len(names) == 1 else names for quantity, names in found.items()}
