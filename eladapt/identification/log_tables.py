"""Tables of text: their delimiter, header and samples."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import LogError
from eladapt.files import read_bytes
from eladapt.identification.log_headers import (
    Chosen,
    echoed_columns,
    found_columns,
    is_number,
    mapped_columns,
)

MOST_BYTES = 1 << 30
DELIMITERS = (";", "\t", ",", " ")
COMMENTS = ("#", "%")
SHOWN = 40  # characters of a line that is no sample

Line = tuple[int, str]  # its number, and its text


def read_table(path: Path, columns: Mapping[str, Any] | None) -> dict[str, Any]:
    """t, q, v, tau and current, as far as there are columns of them, joint_names and notes.

    Raises LogError, ArgumentError.
    """
    lines = [(number, line) for number, line in enumerate(_text(path).splitlines(), 1) if line.strip()]
    leading = next((k for k, (_, line) in enumerate(lines) if not line.startswith(COMMENTS)), len(lines))
    above, lines = lines[:leading], [line for line in lines[leading:] if not line[1].startswith(COMMENTS)]
    if not lines:
        raise LogError(f"{path}: it is empty")
    delimiter = _delimiter(lines[-1][1] if len(lines) < 3 else lines[2][1])
    header, notes = _cells(lines[0][1], delimiter), []
    if not any(map(is_number, header)):
        lines = lines[1:]
        if lines and not any(map(is_number, _cells(lines[0][1], delimiter))):
            number, said = lines.pop(0)
            notes.append(f"line {number} below the header is no sample, and was left out: {said[:SHOWN]}")
    else:  # a header may be a comment: as many names as there are columns
        width, header = len(header), []
        if above and len(named := _cells(above[-1][1].lstrip("".join(COMMENTS)), delimiter)) == width:
            header = named
    if not lines:
        raise LogError(f"{path}: it has a header, and no samples")
    first = _cells(lines[0][1], delimiter)
    chosen = _chosen(header, first, columns)
    found: dict[str, Any] = {"notes": notes, "joint_names": chosen.joint_names}
    wanted = sorted({k for which in chosen.of.values() for k in which})
    table = _numbers(path, lines, delimiter, len(first), wanted, notes)
    for name, which in chosen.of.items():
        part = table[:, [wanted.index(k) for k in which]]
        found[name] = part[:, 0] if name in ("t", "nanoseconds") else part
    if "nanoseconds" in found:
        found["t"] = found["t"] - found["t"][0] + 1e-9 * found.pop("nanoseconds")
    return found


def _text(path: Path) -> str:
    whole = read_bytes(path, MOST_BYTES)
    if whole.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return whole.decode("utf-16", "replace")
    if b"\0" in whole[:4096]:
        raise LogError(
            f"{path}: it is no text; expected a table (.csv, .tsv, .txt), .npz, a record, or a ROS bag "
            "(.mcap, .db3, .bag or its folder)"
        )
    return whole.decode("utf-8-sig", "replace")


def _chosen(header: Sequence[str], first: Sequence[str], columns: Mapping[str, Any] | None) -> Chosen:
    if columns:
        return mapped_columns(header, len(first), columns)
    return (echoed_columns(first) if not header else None) or found_columns(header, len(first))


def _delimiter(line: str) -> str:
    """The one that makes the most numbers of a line."""
    return max(DELIMITERS, key=lambda mark: sum(map(is_number, _cells(line, mark))))


def _cells(line: str, delimiter: str) -> list[str]:
    """Of a line; decimal commas become points where commas do not part the cells."""
    if delimiter != ",":
        line = line.replace(",", ".")
    if delimiter == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]


def _numbers(
    path: Path, lines: Sequence[Line], delimiter: str, width: int, wanted: Sequence[int], notes: list[str]
) -> np.ndarray:
    """(N, len(wanted)) of these columns. Raises LogError with the line that is no sample."""
    table = _loaded([line for _, line in lines], delimiter, width, wanted)
    if table is not None:
        return table
    rows: list[list[float]] = []
    for number, line in lines:  # to say which is wrong
        cells = _cells(line, delimiter)
        some = [cells[k] if k < len(cells) else "" for k in wanted]
        wrong = next((cell for cell in some if cell and not is_number(cell)), None)
        if wrong is None and len(cells) == width:
            rows.append([float(cell) if cell else np.nan for cell in some])
        elif number == lines[-1][0] and rows:
            notes.append(f"line {number}, the last one, is cut short, and was left out")
        elif wrong is not None:
            raise LogError(f"{path}, line {number}: expected numbers, got {wrong!r}")
        else:
            raise LogError(f"{path}, line {number}: expected {width} columns, as before, got {len(cells)}")
    return np.array(rows)


def _loaded(lines: list[str], delimiter: str, width: int, wanted: Sequence[int]) -> np.ndarray | None:
    """All lines at once, where they are all of one form; None where they are not."""
    if delimiter != ",":
        lines = [line.replace(",", ".") for line in lines]
    quoted = any('"' in line for line in lines)
    if quoted or any(
        (len(line.split()) if delimiter == " " else line.count(delimiter) + 1) != width for line in lines
    ):
        return None
    try:
        return np.loadtxt(lines, delimiter=None if delimiter == " " else delimiter, usecols=wanted, ndmin=2)
    except ValueError:
        return None
