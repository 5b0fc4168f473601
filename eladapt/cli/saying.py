"""What the command says, in lines that no name or path from outside breaks or steers the terminal with."""

from __future__ import annotations

from typing import Any

from eladapt.errors import printable


def say(line: object, **options: Any) -> None:
    """Print a line, as far as it can be printed, with the options of print."""
    print(printable(str(line)), **options)


def say_table(table: object) -> None:
    """Print a text of several lines."""
    for line in str(table).split("\n"):
        say(line)
