"""Logs from files: tables of text, .npz, records, and ROS 2 bags."""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import ArgumentError, EladaptError, LogError, UnknownNameError, require_vector
from eladapt.files import open_regular, read_bytes
from eladapt.identification.log import Log
from eladapt.identification.log_headers import found_columns, mapped_columns
from eladapt.records.archive import HEADER
from eladapt.records.record import Record

MOST_BYTES = 1 << 30
DELIMITERS = (",", ";", "\t", " ")
KEYS = {  # of an .npz, the first that is there
    "t": ("t", "time", "timestamp"), "q": ("q", "pos", "position"), "v": ("v", "dq", "qd", "vel", "velocity"),
    "tau": ("tau", "torque", "effort"), "current": ("current",),
}  # fmt: skip


def read_log(
    path: str | Path,
    *,
    columns: Mapping[str, Any] | None = None,
    joint_names: Sequence[str] = (),
    gains: float | Sequence[float] | np.ndarray | Mapping[str, float] | None = None,
    degrees: bool = False,
    held: bool = False,
    topic: str | None = None,
) -> Log:
    """A log from a file.

    .csv, .tsv, .txt: one sample a row; the delimiter (comma, semicolon, tab, blanks) is found. With a header,
    its names say what a column is: a word for time (t, time, timestamp), position (q, pos, position),
    velocity (v, dq, qd, vel, velocity), torque (tau, torque, effort) or current, and what is left names the
    joint, as in ``q3``, ``dq[3]``, ``actual_qd_3``, ``/joint_states/position/elbow``. Without one they are t,
    then all q, all v and all tau. ``columns`` says it otherwise: {"t": ..., "q": ..., "v": ..., "tau": ...},
    each a list of header names or numbers from 0, or a pattern such as "actual_q_*"; v may be left out.
    A cell that is empty or nan makes its sample be left out; any other text is an error with its line; a last
    line that is cut short is left out. The notes of the log say what was.

    .npz: arrays t, q, v (or dq, qd), tau (or torque, effort), and joint_names. A record of `Record.save`: its
    true motion. A folder or .mcap, .db3, .bag: sensor_msgs/JointState messages (extra ``ros``), of ``topic``
    where there are several; those that lack joints which others have are left out.

    joint_names: of the columns, where the file does not say. gains: torque by current [N m/A], a number, one
    a joint, or by name; then the current takes the torque's place. degrees: positions and velocities are in
    degrees. held: see `Log`.

    Raises LogError, naming the file, and the line where there is one; FileNotFoundError.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(2, "no such log", str(path))
    suffix = path.suffix.lower()
    try:
        if path.is_dir() or suffix in (".mcap", ".db3", ".bag"):
            from eladapt.identification.bags import read_bag

            given = read_bag(path, topic, joint_names)
        elif suffix == ".npz":
            if _is_record(path):
                return Log.from_record(Record.load(path))
            given = _read_npz(path)
        else:
            given = _read_text(path, columns)
        return _log(given, joint_names, gains, degrees, held)
    except LogError:
        raise
    except EladaptError as reason:
        raise LogError(f"{path}: {reason}") from reason


def _log(given: dict[str, Any], joint_names: Sequence[str], gains: Any, degrees: bool, held: bool) -> Log:
    names = tuple(joint_names) or tuple(given.get("joint_names", ()))
    tau, notes = given.get("tau"), list(given.get("notes", ()))
    if gains is not None:
        tau = given["current"] if given.get("current") is not None else tau
    if tau is None:
        raise ArgumentError(
            "expected torques; there are currents only: say what torque a current makes, gains= [N m/A] "
            "by joint (or learn them, `current_gains`)"
            if given.get("current") is not None
            else "expected torques or currents, found neither; say which columns they are (columns=)"
        )
    if gains is not None:
        n = np.shape(tau)[1]
        if isinstance(gains, Mapping):
            if unknown := [name for name in names if name not in gains]:
                raise UnknownNameError("joint of gains", unknown, list(gains))
            gains = [gains[name] for name in names]
        tau = tau * require_vector("gains", np.broadcast_to(gains, (n,)), n)
        notes.append("torques are currents times the gains given")
    unit = np.pi / 180 if degrees else 1.0
    v = given.get("v")
    return Log(given["t"], given["q"] * unit, None if v is None else v * unit, tau, names, held, tuple(notes))


def _read_text(path: Path, columns: Mapping[str, Any] | None) -> dict[str, Any]:
    lines = read_bytes(path, MOST_BYTES).decode("utf-8-sig", "replace").splitlines()
    numbered = [
        (number, line) for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("%")
    ]
    if not numbered:
        raise LogError(f"{path}: it is empty")
    header, delimiter = _header(numbered)
    if header:
        numbered = numbered[1:]
    if not numbered:
        raise LogError(f"{path}: it has a header, and no samples")
    width = len(_cells(numbered[0][1], delimiter))
    chosen = mapped_columns(header, width, columns) if columns else found_columns(header, width)
    table, notes = _numbers(path, numbered, delimiter, width)
    found: dict[str, Any] = {"notes": notes, "joint_names": chosen.joint_names}
    for name, which in chosen.of.items():
        found[name] = table[:, which[0]] if name == "t" else table[:, list(which)]
    return found


def _header(numbered: Sequence[tuple[int, str]]) -> tuple[list[str], str]:
    """The names of the first line, none where it is a sample, and the delimiter."""
    first, second = numbered[0][1].lstrip("#").strip(), numbered[min(1, len(numbered) - 1)][1]
    counts = {mark: second.count(mark) for mark in DELIMITERS}
    delimiter = next((mark for mark in DELIMITERS if counts[mark]), " ")
    cells = _cells(first, delimiter)
    return ([] if all(_is_number(cell) for cell in cells) else [cell.strip() for cell in cells]), delimiter


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    return next(csv.reader([line], delimiter=delimiter))


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _numbers(
    path: Path, numbered: Sequence[tuple[int, str]], delimiter: str, width: int
) -> tuple[np.ndarray, list[str]]:
    """(N, width) and notes. Raises LogError with the line that is no sample."""
    try:
        table = np.loadtxt(
            [line for _, line in numbered], delimiter=None if delimiter == " " else delimiter, ndmin=2
        )
        return table, []
    except ValueError:
        pass  # line by line, to say which
    rows: list[list[float]] = []
    notes: list[str] = []
    for number, line in numbered:
        cells = _cells(line, delimiter)
        wrong = next((cell for cell in cells if not _is_number(cell.strip())), None)
        if wrong is None and len(cells) == width:
            rows.append([float(cell) if cell.strip() else np.nan for cell in cells])
        elif number == numbered[-1][0] and rows:
            notes.append(f"line {number}, the last one, is cut short, and was left out")
        elif wrong is not None:
            raise LogError(f"{path}, line {number}: expected numbers, got {wrong!r}")
        else:
            raise LogError(f"{path}, line {number}: expected {width} columns, as before, got {len(cells)}")
    return np.array(rows), notes


def _is_record(path: Path) -> bool:
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            return f"{HEADER}.npy" in archive.namelist()
    except zipfile.BadZipFile:
        return False


def _read_npz(path: Path) -> dict[str, Any]:
    if path.stat().st_size > MOST_BYTES:
        raise LogError(f"{path}: expected at most {MOST_BYTES} bytes")
    try:
        with open_regular(path) as file, np.load(file, allow_pickle=False) as archive:
            there = {key.lower(): key for key in archive.files}
            found = {
                name: np.array(archive[there[key]])
                for name, keys in KEYS.items()
                if (key := next((key for key in keys if key in there), None))
            }
            names = archive[there["joint_names"]] if "joint_names" in there else ()
    except (ValueError, OSError, zipfile.BadZipFile, KeyError) as reason:
        raise LogError(f"{path}: not an .npz of arrays, or a damaged one ({reason})") from reason
    if missing := [f"{name} ({' or '.join(KEYS[name])})" for name in ("t", "q") if name not in found]:
        raise LogError(f"{path}: lacks {', '.join(missing)}; it has {', '.join(there) or 'nothing'}")
    return {**found, "joint_names": tuple(map(str, _iterated(names)))}


def _iterated(names: Any) -> Iterable[Any]:
    return np.atleast_1d(names) if np.size(names) else ()
