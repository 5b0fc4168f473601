"""``eladapt identify``: from a log to parameters, a URDF and a page."""

from __future__ import annotations

import argparse
import sys

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
    columns = dict(pair.partition("=")[::2] for pair in options.column) or None
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
