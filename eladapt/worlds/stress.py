"""Thousands of random worlds, each with a row of its own in one file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from eladapt.errors import ArgumentError
from eladapt.robot.model import Robot
from eladapt.robot.protocols import BareController
from eladapt.worlds.criteria import Criteria
from eladapt.worlds.distributions import Distributions, facts
from eladapt.worlds.folder import Folder, configuration
from eladapt.worlds.result import Stress
from eladapt.worlds.rows import ROW
from eladapt.worlds.sending import Batch, packed, results
from eladapt.worlds.trials import ControllerFor, Trials, careful

MOST = 10**8  # worlds of a seed: world k of seed s has the seed s * MOST + k
LOCAL_WINDOW = 4  # batches on their way, a process


def stress(
    robot: Robot,
    controller: BareController | ControllerFor | None = None,
    worlds: int = 1000,
    seed: int = 0,
    executor: Executor | None = None,
    out: str | Path | None = None,
    distributions: Distributions | None = None,
    *,
    criteria: Criteria | None = None,
    dt: float = 1e-3,
    theta0: Any = None,
    jobs: int | None = None,
    batch: int = 1,
    window: int | None = None,
    progress: bool = True,
) -> Stress:
    """Simulate a controller in random worlds, and say in how many it fails, in which and why.

    controller: one for all worlds, or a function of (robot, told `Hardware`, dt) that makes one for each, at
    the top of a module; None for `careful`: composite controller, gate and shaped goals, told what
    commissioning tells. World k of seed s is ``distributions.world(robot, s * 10**8 + k)``. A world that
    raises or diverges is a row with the name of that, and the rest goes on. dt [s]: the step. theta0:
    where its parameters start, as `simulate` takes it.

    out: a folder for the rows, which are written as they come; with the same arguments again, what is missing
    there is done, and more ``worlds`` are added. None: a temporary one, gone with the result. executor: any
    `concurrent.futures.Executor`, which stays open, as dask's ``Client(...).get_executor()``; None for a pool
    of ``jobs`` processes, one a core by default, in which case a script needs its ``if __name__ ==
    "__main__":``. The rows do not depend on it. batch: worlds that go to a process at once; window: batches
    on their way, at least as many as workers (default: 4 a core).

    Raises ArgumentError before anything runs, and StressError for a folder of another configuration, a full
    disk, or an executor that takes no more.
    """
    worlds, seed = _whole("worlds", worlds, 1, MOST), _whole("seed", seed, 0, 9 * 10**10)
    batch = _whole("batch", batch, 1, 10**6)
    jobs = None if jobs is None else _whole("jobs", jobs, 1, 10**6)
    window = (
        LOCAL_WINDOW * (jobs or os.cpu_count() or 1) if window is None else _whole("window", window, 1, 10**9)
    )
    made: dict[str, Any] = {"distributions": distributions, "criteria": criteria}
    trials = Trials(
        robot, careful if controller is None else controller, dt=dt, theta0=theta0,
        **{name: value for name, value in made.items() if value is not None},
    )  # fmt: skip
    facts(robot)
    trials.world(seed * MOST)  # what makes no world is said now
    job = packed(trials)
    temporary = tempfile.TemporaryDirectory(prefix="eladapt-stress-") if out is None else None
    path = Path(temporary.name if temporary else out)  # type: ignore[arg-type]
    folder = Folder(path, configuration(trials, seed), worlds)
    try:
        done = folder.done(worlds)
        before = Stress(trials, path, seed * MOST, worlds, temporary)
        failed = int(np.count_nonzero(done & ~before.rows["good"]))
        with tqdm(total=worlds, initial=int(done.sum()), desc=f"{robot.name} worlds", unit="world",
                  disable=None if progress else True) as bar:  # fmt: skip
            bar.set_postfix(failed=failed)
            left = _batches(done, seed * MOST, batch)
            for seeds, data in results(job, left, executor, jobs, window) if not done.all() else ():
                rows = np.frombuffer(data, dtype=ROW)
                for each, row in zip(seeds, rows, strict=True):
                    folder.write(each - seed * MOST, row)
                failed += int(np.count_nonzero(~rows["good"]))
                bar.set_postfix(failed=failed, refresh=False)
                bar.update(len(seeds))
    finally:
        folder.close()
    return Stress(trials, path, seed * MOST, worlds, temporary)


def _batches(done: np.ndarray, first: int, size: int) -> Iterator[Batch]:
    """The seeds of worlds that are not done, ``size`` at once."""
    left = np.flatnonzero(~done)
    for k in range(0, len(left), size):
        yield [first + int(number) for number in left[k : k + size]]


def _whole(name: str, value: Any, low: int, high: int) -> int:
    """A whole number. Raises ArgumentError."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise ArgumentError(f"{name}: expected a whole number from {low} to {high}, got {value!r}")
    return int(value)
