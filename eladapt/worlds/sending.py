"""Worlds sent to an executor, few at a time, and what comes back; a process that dies loses none."""

from __future__ import annotations

import functools
import pickle
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait

from eladapt.errors import ArgumentError, StressError
from eladapt.worlds.rows import row_of
from eladapt.worlds.trials import Trials

DIED = "process died"
Batch = Sequence[int]  # seeds


def packed(trials: Trials) -> bytes:
    """As it goes to other processes. Raises ArgumentError for what does not, such as a lambda."""
    try:
        return pickle.dumps(trials)
    except Exception as reason:
        raise ArgumentError(
            f"controller: expected one that can be pickled, got one that cannot ({reason}); functions and "
            "classes must stand at the top of a module, not be a lambda"
        ) from reason


@functools.lru_cache(maxsize=1)
def unpacked(job: bytes) -> Trials:
    """The trials, once a process: they know the robot's limits and facts by then."""
    trials: Trials = pickle.loads(job)
    return trials


def rows_of(job: bytes, seeds: Batch) -> bytes:
    """What a worker does: the rows of these worlds, 0.6 kB each."""
    trials = unpacked(job)
    return b"".join(trials.row(seed).tobytes() for seed in seeds)


def ready(job: bytes) -> bool:
    """Whether a worker finds all that the trials need: eladapt, and the controller's module."""
    unpacked(job)
    return True


def results(
    job: bytes, batches: Iterable[Batch], executor: Executor | None, jobs: int | None, window: int
) -> Iterator[tuple[Batch, bytes]]:
    """The batches and their rows, in the order in which they are done; at most ``window`` are on their way.

    executor: None for a pool of ``jobs`` processes, which is made anew when one of them dies. Batches that
    came back without rows are tried once more at the end, world by world and alone; a world that kills its
    process then, too, is a row that says so. Raises StressError when the executor itself does not work.
    """
    left, suspects = iter(batches), list[int]()
    while True:
        pool = ProcessPoolExecutor(jobs) if executor is None else executor
        try:
            _require_ready(pool, job)
            yield from _sent(pool, job, left, window, suspects)
            break
        except RuntimeError as reason:  # as of one that was shut down
            if executor is not None or not isinstance(reason, BrokenExecutor):
                raise _broken(reason) from reason
        finally:
            if executor is None:
                pool.shutdown(cancel_futures=True)
    for seed in suspects:
        yield (seed,), _alone(job, seed, executor)


def _sent(
    pool: Executor, job: bytes, batches: Iterator[Batch], window: int, suspects: list[int]
) -> Iterator[tuple[Batch, bytes]]:
    """Until there are no more batches, or the pool takes no more: then those on their way are suspects, and
    its RuntimeError says so."""
    waiting: dict[Future[bytes], Batch] = {}
    broken: RuntimeError | None = None
    try:
        for batch in batches:
            try:
                waiting[pool.submit(rows_of, job, batch)] = batch
            except RuntimeError as reason:
                suspects += batch
                broken = reason
                break
            if len(waiting) >= window:
                yield from _taken(waiting, suspects)
        while waiting:
            yield from _taken(waiting, suspects)
    finally:
        for future in waiting:
            future.cancel()
    if broken is not None:
        raise broken


def _taken(waiting: dict[Future[bytes], Batch], suspects: list[int]) -> Iterator[tuple[Batch, bytes]]:
    """Those that are done, off the list."""
    done, _ = wait(waiting, return_when=FIRST_COMPLETED)
    for future in done:
        batch = waiting.pop(future)
        if future.cancelled() or future.exception() is not None:
            suspects += batch
        else:
            yield batch, future.result()


def _alone(job: bytes, seed: int, executor: Executor | None) -> bytes:
    """The row of a world whose batch came back without rows."""
    if executor is None:
        with ProcessPoolExecutor(1) as pool:
            return _row_or_death(pool, job, seed)
    row = _row_or_death(executor, job, seed)
    _require_ready(executor, job)  # else the world was not to blame
    return row


def _row_or_death(pool: Executor, job: bytes, seed: int) -> bytes:
    try:
        return pool.submit(rows_of, job, (seed,)).result()
    except Exception as reason:
        said = f"the process that simulated it died: {type(reason).__name__}: {reason}"
        return row_of({"seed": seed, "cause": DIED, "said": said}).tobytes()


def _require_ready(pool: Executor, job: bytes) -> None:
    """Raises StressError where no worker can do it."""
    try:
        pool.submit(ready, job).result()
    except Exception as reason:
        raise _broken(reason) from reason


def _broken(reason: Exception) -> StressError:
    return StressError(
        f"executor: does not simulate worlds ({type(reason).__name__}: {reason}); expected workers that have "
        "eladapt and the controller's module. What is done is kept: mend that, and run the same again"
    )
