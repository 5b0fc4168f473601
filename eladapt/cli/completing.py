"""``eladapt completion``: what a shell reads to complete commands, options and robots."""

from __future__ import annotations

import argparse
from pathlib import Path

from eladapt.cli.saying import Outcome, say_table
from eladapt.errors import needing
from eladapt.robot import library

SHELLS = ("bash", "zsh")
ROBOT = {  # a robot of the library, or a file
    "bash": '_eladapt_robot() {{ compgen -W "{names}" -- "$1"; compgen -f -- "$1"; }}',
    "zsh": "_eladapt_robot() {{ compadd {names}; _files; }}",
}


def completion(options: argparse.Namespace) -> Outcome:
    """Print the script for a shell. Raises EladaptError where shtab is not installed."""
    with needing("shell completion needs shtab", "completion"):
        import shtab
    for action in _actions(options.whole):
        if action.dest == "robot":
            action.complete = dict.fromkeys(ROBOT, "_eladapt_robot")  # type: ignore[attr-defined]
        elif action.metavar == "FOLDER":
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    names = " ".join(library.robots())
    preamble = ROBOT[options.shell].format(names=names)
    script = shtab.complete(options.whole, shell=options.shell, preamble=preamble)
    say_table(script)
    return Outcome({"shell": options.shell, "script": script})


def _actions(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """Of a parser and of its commands."""
    found = []
    for action in parser._actions:
        found.append(action)
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                found += _actions(command)
    return found
