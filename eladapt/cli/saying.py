"""What the command says, in lines that no name or path from outside breaks or steers the terminal with."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eladapt.errors import printable


class Outcome(NamedTuple):
    """How a command ended: what --json prints of it, in plain types, and the exit code."""

    found: Any
    code: int = 0


def say(line: object, **options: Any) -> None:
    """Print a line, as far as it can be printed, with the options of print."""
    print(printable(str(line)), **options)


def say_table(table: object) -> None:
    """Print a text of several lines."""
    for line in str(table).split("\n"):
        say(line)


def warn(text: object) -> None:
    """A warning, on one line of stderr."""
    say(f"warning: {' '.join(str(text).split())}", file=sys.stderr)


def as_json(value: Any) -> str:
    """A value as JSON, which has neither nan nor infinity: both are null."""
    return json.dumps(_plain(value), indent=1)


def _plain(value: Any) -> Any:
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(name): _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(part) for part in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
