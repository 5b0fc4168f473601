"""Where a number comes from that nobody typed in: a rule with its value, and a table of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np


class Rule(NamedTuple):
    """Where a gain or a limit comes from."""

    gain: str
    value: str
    rule: str
    active: str  # the limit that was active, or how the gain was given


def rules_table(rules: Sequence[Rule]) -> str:
    """One line a rule, in columns."""
    cells = [Rule._fields, *rules]
    widths = [max(len(row[k]) for row in cells) for k in range(3)]
    lines = ["  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[3]]) for row in cells]
    return "\n".join(line.rstrip() for line in lines)


def shown(value: Any) -> str:
    """A number, or a vector, with three digits."""
    array = np.asarray(value, dtype=float)
    return f"[{', '.join(f'{x:.3g}' for x in array)}]" if array.ndim else f"{array:.3g}"
