"""A folder of results: the configuration that they belong to, and one file of rows.

The file is numpy's own ``.npy`` of fixed-width rows: ``np.load(path, mmap_mode="r")["steady"]`` is a column,
without another package and without reading the rest. Room for all rows is taken at the start, so that a disk
that is too small is told then; each row is written to its place, the world's number, as soon as it is there,
with a checksum. So the file does not depend on the order in which worlds are done, a kill loses the rows on
their way alone, and memory does not grow with the number of worlds. (Parquet is readable only once it is
whole; of appended files there would be thousands.)
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from eladapt.errors import StressError
from eladapt.files import atomic_write
from eladapt.records.description import identity, versions
from eladapt.worlds.rows import ROW, complete
from eladapt.worlds.trials import Trials

ROWS, CONFIGURATION = "worlds.npy", "configuration.json"
BLOCK = 4096  # rows that are looked at at once
SHOWN = 5  # differences of configurations that a message lists


def configuration(trials: Trials, seed: int) -> dict[str, str]:
    """All that decides about the rows, as flat text."""
    made = trials.controller
    named = {} if hasattr(made, "step") else {"controller": f"{made.__module__}.{made.__qualname__}"}
    releases = {f"versions.{name}": release for name, release in versions().items()}
    published = {f"robot.published.{name}": str(limit) for name, limit in trials.robot.published.items()}
    return {**identity(trials), **named, **published, **releases, "seed": str(seed)}


class Folder:
    """The results of one configuration, opened to be added to; nobody else may then.

    Raises StressError for a folder of another configuration, one that is in use, or a disk without room.
    """

    def __init__(self, path: Path, settings: Mapping[str, str], worlds: int):
        self.path, self.rows_path = path, path / ROWS
        if path.exists() and not path.is_dir():
            raise StressError(f"{path}: is a file; expected a folder")
        with told(path):
            path.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(path)
            try:
                self._claim(settings)
                self.size = max(worlds, _rows_in(self.rows_path))
                if self.size > _rows_in(self.rows_path):
                    _make_room(self.rows_path, self.size)
                self._file = open(self.rows_path, "r+b")  # noqa: SIM115
                self._start = _header(self._file)[1]
            except BaseException:
                self._lock.close()
                raise

    def close(self) -> None:
        """Let others have it."""
        self._file.close()
        self._lock.close()

    def write(self, number: int, rows: np.ndarray) -> None:
        """The rows of the worlds from ``number`` on, to their places."""
        with told(self.path):
            data = np.ascontiguousarray(rows).tobytes()
            place = self._start + number * ROW.itemsize
            while data:
                written = os.pwrite(self._file.fileno(), data, place)
                data, place = data[written:], place + written

    def done(self, worlds: int) -> np.ndarray:
        """(worlds,) which of the first ones are there."""
        rows = read(self.path)
        parts = [complete(rows[k : min(k + BLOCK, worlds)]) for k in range(0, worlds, BLOCK)]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=bool)

    def _claim(self, settings: Mapping[str, str]) -> None:
        """Write the configuration where there is none; refuse another one."""
        self._lock.seek(0)
        kept = self._lock.read()
        if not kept:
            self._lock.write(json.dumps(settings, indent=1).encode())
            self._lock.flush()
            os.fsync(self._lock.fileno())
            return
        try:
            there = json.loads(kept)
            names = sorted(name for name in {*there, *settings} if there.get(name) != settings.get(name))
        except (ValueError, TypeError, AttributeError) as reason:
            raise StressError(
                f"{self._lock.name}: is no configuration of a stress test ({reason})"
            ) from reason
        if names:
            listed = "; ".join(
                f"{n}: {there.get(n, '-')} there, {settings.get(n, '-')} now" for n in names[:SHOWN]
            )
            more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            raise StressError(
                f"{self.path}: has the results of another configuration, which stay as they are; expected "
                f"the same, or another folder. {listed}{more}"
            )


def _locked(path: Path) -> BinaryIO:
    """The file of a folder's configuration, which nobody else has until it is closed; empty in a new folder.

    Locked before it is read or written, so that of two that begin at once one gets the folder. Raises
    StressError where it is in use, or something else's.
    """
    if (there := sorted(file.name for file in path.iterdir())) and CONFIGURATION not in there:
        listed = ", ".join(there[:3])
        raise StressError(f"{path}: expected a new folder, or one of a stress test; it has {listed}")
    # To write, since network file systems lock nothing else exclusively.
    file = open(path / CONFIGURATION, "a+b")  # noqa: SIM115 (until it is closed)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as reason:
        file.close()
        if isinstance(reason, BlockingIOError):
            raise StressError(
                f"{path}: another stress test is writing to it; wait, or take another"
            ) from None
        raise
    return file


def read(path: Path) -> np.ndarray:
    """All rows, also those that are not there yet, mapped from the file."""
    return np.load(path / ROWS, mmap_mode="r")


@contextlib.contextmanager
def told(path: Path) -> Iterator[None]:
    """What the system says against writing, as a full disk, by name; results stay."""
    try:
        yield
    except OSError as reason:
        raise StressError(
            f"{path}: {reason.strerror or reason}; the worlds that are done are kept there: mend that, and "
            "run the same again"
        ) from reason


def _make_room(path: Path, size: int) -> None:
    """A file of that many rows, with those that there were first; to a temporary name, then renamed."""
    before: Any = np.load(path, mmap_mode="r") if path.exists() else np.zeros(0, dtype=ROW)
    with atomic_write(path) as temporary, temporary.open("r+b") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": ROW.descr, "fortran_order": False, "shape": (size,)}
        )
        start = file.tell()
        _allocate(file.fileno(), start, size * ROW.itemsize)
        for k in range(0, len(before), BLOCK):
            file.write(before[k : k + BLOCK].tobytes())
        file.flush()
        os.fsync(file.fileno())


def _allocate(handle: int, start: int, size: int) -> None:
    """Take room for zeros; where the system cannot take it, the file is only that long."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(handle, start, size)
    else:
        os.truncate(handle, start + size)


def _rows_in(path: Path) -> int:
    """How many rows the file has, 0 where it is not there. Raises StressError for another's file."""
    if not path.exists():
        return 0
    with path.open("rb") as file:
        return _header(file)[0]


def _header(file: Any) -> tuple[int, int]:
    """How many rows a file has, and where they begin."""
    try:
        np.lib.format.read_magic(file)
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    except ValueError as reason:
        raise StressError(f"{file.name}: is no file of worlds ({reason}); take another folder") from reason
    if dtype != ROW or len(shape) != 1:
        raise StressError(f"{file.name}: has other columns than this release writes; take another folder")
    return int(shape[0]), file.tell()
