"""Writes a benchmark's table, with the kind of machine that it ran on, and prints it."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eladapt.files import atomic_write
from eladapt.records.description import versions

RESULTS = Path(__file__).parent / "results"


def machine() -> str:
    """The kind of machine, not which one."""
    releases = ", ".join(f"{name} {release}" for name, release in versions().items())
    return (
        f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}, "
        f"Python {platform.python_version()}; {releases}"
    )


def markdown(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """The rows as a Markdown table."""
    cells = [[str(cell) for cell in row] for row in (head, *rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) + " |" for row in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join([*lines, ""])


def gathered(path: Path, case: Sequence[str], row: dict[str, Any] | None = None) -> list[dict[str, Any]]:
    """All rows of a file, this one added: of runs that take too long for one go.

    case: the columns that say what was run; of a case that was run again, the last row counts.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+") as file:
        file.write(json.dumps(row) + "\n" if row else "")
    rows = map(json.loads, path.read_text().splitlines())
    return list({json.dumps([row[name] for name in case]): row for row in rows}.values())


def write(
    name: str, title: str, head: Sequence[str], rows: Sequence[Sequence[object]], notes: str = ""
) -> str:
    """benchmarks/results/NAME.md as a Markdown table; returns its text."""
    text = f"# {title}\n\n{markdown(head, rows)}"
    text += (f"\n{notes.strip()}\n" if notes else "") + f"\nMachine: {machine()}.\n"
    with atomic_write(RESULTS / f"{name}.md") as temporary:
        temporary.write_text(text)
    print(text)
    return text
