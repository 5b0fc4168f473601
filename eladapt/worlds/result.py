"""What a stress test found: counts, quantiles, failures with their likely causes, and any world again."""

from __future__ import annotations

import functools
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.records.record import Record
from eladapt.worlds.explanations import Explanation, explanations, unusual
from eladapt.worlds.folder import read
from eladapt.worlds.rows import FACTORS, MEASURES, text
from eladapt.worlds.trials import Trials
from eladapt.worlds.world import World

QUANTILES = (0.5, 0.95, 0.99, 1.0)
SUMMED = ("settling", "steady", "tracking", "overshoot", "speed", "torque", "saturated", "gravity_error")
LISTED = 20  # failures in a summary


class Failure(NamedTuple):
    """A world in which the controller failed."""

    seed: int
    cause: str
    said: str  # with its figures
    likely: str  # what of the world may explain it, "" if nothing stands out


@dataclass(frozen=True, eq=False)
class Stress:
    """The rows of a stress test, and what they say. ``print(result)`` sums up.

    rows: (N,) by column, see `eladapt.worlds.rows`: seeds, the worlds in numbers, and how they went.
    """

    trials: Trials
    path: Path  # the folder
    first: int  # the seed of its first world
    worlds: int
    temporary: Any = None  # what removes the folder with this object, None where it stays

    def __repr__(self) -> str:
        return f"Stress({self.trials.robot.name!r}: {self._good_said})"

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """(N,), one a world, mapped from the file, not in memory."""
        return read(self.path)[: self.worlds]

    @property
    def good(self) -> np.ndarray:
        """(N,) which were good."""
        return np.asarray(self.rows["good"])

    @property
    def causes(self) -> dict[str, int]:
        """How many failed of what, most first."""
        return dict(Counter(map(text, self.rows["cause"][~self.good])).most_common())

    @functools.cached_property
    def explanations(self) -> list[Explanation]:
        """What tells failed from good worlds, strongest first."""
        return explanations(self.rows, ~self.good)

    def failures(self, most: int | None = None) -> list[Failure]:
        """The first ones, or all."""
        found = []
        for k in np.flatnonzero(~self.good)[:most]:
            row = self.rows[k]
            cause = text(row["cause"])
            found.append(Failure(int(row["seed"]), cause, text(row["said"]), self._likely(cause, row)))
        return found

    def quantiles(self) -> dict[str, np.ndarray]:
        """(4,) `QUANTILES` of each measure over all worlds that ended; nan where none did."""
        found = {}
        for name in SUMMED:
            known = self.rows[name][~np.isnan(self.rows[name])]
            known = np.sort(known)
            at = [min(int(np.ceil(q * len(known))), len(known)) - 1 for q in QUANTILES]
            found[name] = known[at] if len(known) else np.full(len(QUANTILES), np.nan)
        return found

    def world(self, seed: int) -> World:
        """One of the worlds. Raises ArgumentError for a seed that is none of them."""
        whole = isinstance(seed, int | np.integer)
        if not whole or not self.first <= seed < self.first + self.worlds:
            last = self.first + self.worlds - 1
            raise ArgumentError(f"seed: expected one of a world, {self.first} to {last}, got {seed!r}")
        return self.trials.world(seed)

    def replay(self, seed: int) -> Record:
        """The full record of a world, simulated again: bit for bit what its row is about.

        Raises ArgumentError for a seed that is none of the worlds, and, as it did then, SimulationError, with
        the record so far, for a run that ended early.
        """
        self.world(seed)
        return self.trials.record(seed)

    def report(self, path: str | Path) -> Path:
        """Write the page, see `eladapt.display.stress_report`; returns its path."""
        from eladapt.display.stress_report import stress_report

        return stress_report(self, path)

    def summary(self) -> str:
        """How many were good, what failed, what explains it, and quantiles."""
        robot = self.trials.robot.name
        lines = [f"{robot}: {self._good_said}"]
        lines += [f"  {count:,} {cause}" for cause, count in self.causes.items()]
        if self.explanations:
            lines.append("what tells failed worlds from good ones (1: wholly, 0: not at all):")
            lines += [
                f"  {one.strength:.2f} {'more' if one.larger else 'less'} {FACTORS[one.factor]}"
                for one in self.explanations
            ]
        lines.append(f"{'':36} median    95 %     99 %     largest")
        for name, values in self.quantiles().items():
            lines.append(f"  {MEASURES[name]:34}" + " ".join(f"{value:<8.2g}" for value in values))
        failures = self.failures(LISTED)
        lines += [
            f"world {one.seed}: {one.cause}: {one.said}" + f"; {one.likely}" * bool(one.likely)
            for one in failures
        ]
        if (more := int(np.count_nonzero(~self.good)) - len(failures)) > 0:
            lines.append(f"and {more:,} more: failures() lists them")
        return "\n".join(lines)

    __str__ = summary

    @property
    def _good_said(self) -> str:
        return f"{np.count_nonzero(self.good):,} of {self.worlds:,} good"

    def _likely(self, cause: str, row: np.void) -> str:
        return unusual(self.rows, row, self._of_cause(cause) or self.explanations)

    def _of_cause(self, cause: str) -> list[Explanation]:
        """What tells the failures of one cause from good worlds."""
        known: dict[str, list[Explanation]] = self.__dict__.setdefault("_explained", {})
        if cause not in known:
            same = self.rows["cause"] == cause.encode("ascii")
            known[cause] = explanations(self.rows[same | self.good], same[same | self.good])
        return known[cause]
