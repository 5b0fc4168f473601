"""Random worlds: in how many each arm is good, what fails, and what a thousand cores would take.

The careful controller (gate, shaped goals, told what commissioning tells) with the default distributions.
Rows are kept in --folder, so a run that is stopped goes on where it was, and more --worlds are added.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest
from table import markdown, write

import eladapt as ea
from eladapt.worlds.rows import ROW, row_of

ARMS = ("panda", "ur5", "xarm7", "kinova", "talos_left_arm")
SIZES = (100, 1000, 10_000)  # worlds of which the coordinating process is measured
TASKS = 1000  # through dask's scheduler, without work
HEAD = [
    "arm", "worlds", "good", "95 % confidence", "failures", "settled [s], 99 %", "steady [rad], 99 %",
    "while moving [rad], median", "99 %", "gravity error / effort, 99 %",
]  # fmt: skip


class Instant(Executor):
    """Has every row at once: what is left is what the coordinating process does."""

    def submit(self, call: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        seeds = arguments[1] if len(arguments) > 1 else ()
        future.set_result(b"".join(row_of({"seed": seed, "good": True}).tobytes() for seed in seeds))
        return future


def idle(_job: bytes, seeds: list[int]) -> bytes:
    """A worker's answer without its work."""
    return bytes(ROW.itemsize * len(seeds))


def arm_row(result: ea.Stress) -> list[object]:
    """One line of the table."""
    rows, good = result.rows, int(np.count_nonzero(result.good))
    sure = binomtest(good, result.worlds).proportion_ci(0.95, method="exact")
    of = result.quantiles()
    failures = ", ".join(f"{count} {cause}" for cause, count in result.causes.items())
    return [
        result.trials.robot.name, len(rows), f"{good} ({good / len(rows):.1%})",
        f"{sure.low:.1%} to {sure.high:.1%}", failures or "none", f"{of['settling'][2]:.2f}",
        f"{of['steady'][2]:.1e}", f"{of['tracking'][0]:.1e}", f"{of['tracking'][2]:.1e}",
        f"{of['gravity_error'][2]:.1e}",
    ]  # fmt: skip


def coordinator(worlds: int) -> tuple[float, float]:
    """[MB] at most, and [worlds/s], of the process that sends worlds and writes rows."""
    program = f"import stress; stress.only_coordinate({worlds})"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=Path(__file__).parent, capture_output=True, check=True
    )
    kilobytes, seconds = map(float, done.stdout.split())
    return kilobytes / 1e3, worlds / seconds


def only_coordinate(worlds: int) -> None:
    """Prints the most memory [kB] and the time [s]."""
    robot = ea.Robot.load("panda")
    ea.stress(robot, worlds=1, executor=Instant(), progress=False)  # imports, limits
    begun = time.perf_counter()
    ea.stress(robot, worlds=worlds, executor=Instant(), progress=False)
    seconds = time.perf_counter() - begun
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, seconds)


def dask_times(arm: str, worlds: int) -> tuple[list[float], float]:
    """[s] of some worlds on one and on two dask workers, and the rate of empty tasks [1/s]."""
    from distributed import Client, LocalCluster

    robot, seconds, rate = ea.Robot.load(arm), [], 0.0
    rows: list[bytes] = []
    for workers in (1, 2):
        options: dict[str, Any] = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
        with LocalCluster(host="127.0.0.1", **options) as cluster, Client(cluster) as client:
            executor = client.get_executor()
            ea.stress(
                robot, worlds=2 * workers, seed=1, executor=executor, progress=False
            )  # imports, kernels
            begun = time.perf_counter()
            result = ea.stress(robot, worlds=worlds, executor=executor, window=4 * workers, progress=False)
            seconds.append(time.perf_counter() - begun)
            rows.append(np.ascontiguousarray(result.rows).tobytes())
            job, begun = bytes(25_000), time.perf_counter()
            for future in [executor.submit(idle, job, [k]) for k in range(TASKS)]:
                future.result()
            rate = TASKS / (time.perf_counter() - begun)
    if rows[0] != rows[1]:
        raise SystemExit("rows of one worker and of two differ")
    return seconds, rate


def cluster_said(arm: str, worlds: int) -> str:
    """Efficiency, and the scheduler's own rate."""
    (one, two), rate = dask_times(arm, worlds)
    return (
        f"## A cluster of two\n\n{worlds} worlds of {arm} by dask.distributed: {one:.1f} s on one worker, "
        f"{two:.1f} s on two, efficiency {one / two / 2:.2f}; the same rows bit for bit. Tasks without work: "
        f"{rate:.0f} a second through scheduler and client."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help="each NAME, or NAME=WORLDS")
    parser.add_argument("--worlds", type=int, default=100, help="of arms that say no number (default: 100)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="of the rows (default: a temporary one)")
    parser.add_argument("--cluster-worlds", type=int, default=0, help="of panda, for dask; 0 leaves it out")
    parser.add_argument("--output", default="stress", help="in benchmarks/results, or a path without .md")
    options = parser.parse_args()
    parts = [
        "Failures by the name of what the gate or the criteria said; the share with its 95 % confidence by "
        "Clopper and Pearson. More worlds: `python benchmarks/stress.py --worlds 10000 --folder FOLDER`."
    ]
    with tempfile.TemporaryDirectory() as temporary:
        folder, rows = options.folder or Path(temporary), []
        for asked in options.arms:
            arm, _, number = asked.partition("=")
            robot, worlds = ea.Robot.load(arm), int(number or options.worlds)
            result = ea.stress(robot, worlds=worlds, jobs=options.jobs, out=folder / arm)
            rows.append(arm_row(result))
            failures = result.failures()
            if failures:
                listed = "\n".join(f"- {one.seed}: {one.cause}: {one.said}" for one in failures)
                parts.append(f"## Failures of {arm}\n\n{listed}")
    measured = [(size, *coordinator(size)) for size in SIZES]
    table = [[f"{size:,}", f"{memory:.0f}", f"{rate:,.0f}"] for size, memory, rate in measured]
    head = ["worlds", "most memory [MB]", "worlds a second"]
    parts.append(
        f"## The process that sends worlds and writes rows\n\n{markdown(head, table)}\nIts workers take no "
        "time here; what is left is sending, checking and writing, one world at a time."
    )
    if options.cluster_worlds:
        parts.append(cluster_said("panda", options.cluster_worlds))
    write(options.output, "Random worlds", HEAD, rows, "\n\n".join(parts))


if __name__ == "__main__":
    main()
