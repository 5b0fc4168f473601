"""Where a number comes from that nobody typed in: a rule with its value, and a table of them."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

WIDE = 100  # characters of a line


class Rule(NamedTuple):
    """Where a gain or a limit comes from."""

    gain: str
    value: str
    rule: str
    active: str  # the limit that was active, or how the gain was given


def rules_table(rules: Sequence[Rule]) -> str:
    """Name and value of each, and below them the rule and what limited it, within `WIDE` characters."""
    margin = " " * (2 + max(len(rule.gain) for rule in rules))
    lines = []
    for gain, value, rule, active in rules:
        parts = [value, rule, f"here: {active}" if active else ""]
        wrapped = [textwrap.wrap(part, WIDE - len(margin), break_long_words=False) for part in parts]
        first, *rest = [line for part in wrapped for line in part]
        lines += [gain.ljust(len(margin)) + first, *(margin + line for line in rest)]
    return "\n".join(lines)


def shown(value: Any) -> str:
    """A number, or a vector, with three digits."""
    array = np.asarray(value, dtype=float)
    return f"[{', '.join(f'{x:.3g}' for x in array)}]" if array.ndim else f"{array:.3g}"
