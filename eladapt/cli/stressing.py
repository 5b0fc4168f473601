"""``eladapt stress``: random worlds, in how many an arm's controller fails, and a page about it."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

from eladapt.cli.checking import find
from eladapt.cli.saying import Outcome, say, say_table
from eladapt.errors import ArgumentError, EladaptError, StressError, needing
from eladapt.files import atomic_write
from eladapt.worlds.stress import stress as tested

FAILED = 3  # the exit code where worlds failed
PER_WORKER = 4  # batches on their way


def stress(options: argparse.Namespace) -> Outcome:
    """Run what is missing in the folder, print the summary, write it and the page."""
    if options.jobs is not None and options.cluster is not None:
        raise ArgumentError("--jobs: expected without --cluster, whose workers do the work")
    robot = find(options)
    with _executor(options.cluster) as (executor, window):
        result = tested(
            robot, worlds=options.worlds, seed=options.seed, executor=executor, out=options.out,
            dt=options.dt, jobs=options.jobs, batch=options.batch, window=window,
            progress=sys.stderr.isatty(),
        )  # fmt: skip
    summary = result.summary()
    say_table(summary)
    with atomic_write(options.out / "summary.txt") as temporary:
        temporary.write_text(f"{summary}\n")
    written: list[Path] = [options.out / "worlds.npy", options.out / "summary.txt"]
    try:
        written.append(result.report(options.out / "stress.html"))
    except EladaptError as reason:  # without Bokeh
        say(f"warning: {reason}", file=sys.stderr)
    say(f"wrote {', '.join(map(str, written))}")
    good = int(result.good.sum())
    found = {"worlds": result.worlds, "good": good, "written": written}
    return Outcome(found, 0 if good == result.worlds else FAILED)


@contextlib.contextmanager
def _executor(address: str | None) -> Iterator[tuple[Executor | None, int | None]]:
    """That of a dask cluster, with how many batches to send at once; None for processes of one's own."""
    if address is None:
        yield None, None
        return
    with needing("--cluster needs dask.distributed", "cluster"):
        from distributed import Client
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as reason:
        raise StressError(
            f"--cluster: no scheduler answers at {address} ({reason}); expected tcp://HOST:PORT of `dask "
            "scheduler`"
        ) from reason
    with client:
        workers = sum(client.nthreads().values())
        if not workers:
            raise StressError(
                f"--cluster: the scheduler at {address} has no workers; start `dask worker {address}`"
            )
        yield client.get_executor(), PER_WORKER * workers
