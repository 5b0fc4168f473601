"""Logs from files: tables of text, .npz, records, and ROS 2 bags."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eladapt.errors import ArgumentError, EladaptError, LogError, UnknownNameError, require_vector
from eladapt.files import open_regular
from eladapt.identification.log import Log
from eladapt.identification.log_tables import MOST_BYTES, read_table
from eladapt.records.archive import HEADER
from eladapt.records.record import Record

KEYS = {  # of an .npz, the first that is there
    "t": ("t", "time", "timestamp"), "q": ("q", "pos", "position"), "v": ("v", "dq", "qd", "vel", "velocity"),
    "tau": ("tau", "torque", "effort"), "current": ("current",),
}  # fmt: skip


TODAY = 1e9, 4e9  # [s] since 1970, in which logs are made: from 2001 to 2096
EPOCH = ((1e9, "nanoseconds"), (1e6, "microseconds"), (1e3, "milliseconds"), (1.0, "seconds"))


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

    .csv, .tsv, .txt: one sample a row; the delimiter (comma, semicolon, tab, blanks) is found; unless it is
    the comma, commas are decimal. With a header, its names say what a column is: a word for time (t, time,
    timestamp), position (q, pos, position), velocity (v, dq, qd, vel, velocity), torque (tau, torque, effort)
    or current, and what is left names the joint, as in ``q3``, ``dq[3]``, ``actual_qd_3``,
    ``/joint_states/position/elbow``; numbered joints are taken in the order of their numbers. What was asked
    for (target, desired, command) counts only where nothing of its kind was measured. Other columns may hold
    anything. Without a header they are t, then all q, all v and all tau, or as ``ros2 topic echo --csv``
    writes them. ``columns`` says it otherwise: {"t": ..., "q": ..., "v": ..., "tau": ...}, each a list of
    header names or numbers from 0, or a pattern such as "actual_q_*", whose star stands for the joint; v may
    be left out. Lines that begin with # or % are comments; a line of units below the header is left out, and
    so is a last line that is cut short. A cell that is empty or nan makes its sample be left out; any other
    text is an error with its line. The notes of the log say what was. Stamps since 1970, in seconds,
    milli-, micro- or nanoseconds, are counted from the first one on.

    .npz: arrays t, q, v (or dq, qd), tau (or torque, effort), and joint_names. A record of `Record.save`: its
    true motion. A folder or .mcap, .db3, .bag: sensor_msgs/JointState messages (extra ``ros``), of ``topic``
    where there are several; those that lack joints which others have are left out.

    joint_names: of the columns, where the file does not say; of a bag, which joints. gains: torque by current
    [N m/A], a number, one a joint, or by name; then the current takes the torque's place. degrees: positions
    and velocities of joints that turn are in degrees. held: see `Log`.

    Raises LogError, naming the file, and the line where there is one; FileNotFoundError.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(2, "no such log", str(path))
    suffix = path.suffix.lower()
    try:
        table = {"columns": columns}
        if path.is_dir() or suffix in (".mcap", ".db3", ".bag"):
            _require_no(path, table, "a bag, whose messages say what a number is")
            from eladapt.identification.bags import read_bag

            given = read_bag(path, topic, joint_names)
        elif suffix == ".npz":
            _require_no(path, {**table, "topic": topic}, "an .npz, whose arrays have names")
            if _is_record(path):
                made = {"joint_names": joint_names, "gains": gains, "degrees": degrees}
                _require_no(path, made, "a record, in SI units")
                return Log.from_record(Record.load(path))
            given = _read_npz(path)
        else:
            _require_no(path, {"topic": topic}, "a table, not a bag")
            given = read_table(path, columns)
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
        tau = tau * require_vector("gains", np.full(n, gains) if np.ndim(gains) == 0 else gains, n)
        notes.append("torques are currents times the gains given")
    t = _seconds(np.asarray(given["t"], dtype=float), notes)
    return Log(t, given["q"], given.get("v"), tau, names, held, tuple(notes), degrees)


def _seconds(t: np.ndarray, notes: list[str]) -> np.ndarray:
    """Stamps of a clock that counts from 1970, in whatever unit, from the first on; others as they are."""
    for unit, name in EPOCH:
        if t.ndim == 1 and t.size and unit * TODAY[0] < t[0] < unit * TODAY[1]:
            notes.append(f"stamps are {name} since 1970, and were counted from the first on")
            return (t - t[0]) / unit
    return t


def _require_no(path: Path, options: Mapping[str, Any], why: str) -> None:
    """Raises ArgumentError for options that would not count."""
    if given := [name for name, value in options.items() if value]:
        raise ArgumentError(f"{', '.join(given)}: {path.name} is {why}; leave it out")


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
