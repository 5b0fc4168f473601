"""Many closed-loop runs at once, over processes or any executor."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from typing import Any

import numpy as np
from tqdm import tqdm

from eladapt.errors import ArgumentError, SimulationError
from eladapt.records.record import Record
from eladapt.robot.protocols import BareController, GoalCourse, Plant
from eladapt.signals import Reference
from eladapt.simulation.run import simulate


def simulate_many(
    controller: BareController | Iterable[BareController],
    plants: Plant | Iterable[Plant],
    goals: GoalCourse | Iterable[GoalCourse],
    duration: float = 5.0,
    dt: float = 1e-3,
    *,
    executor: Executor | None = None,
    theta0: Any = None,
    progress: bool = True,
    title: str = "",
) -> list[Record | SimulationError]:
    """One `simulate` for each rollout, in the order given, and bit for bit what `simulate` alone would give.

    controller, plants, goals: one for all rollouts, or a sequence with one for each; a goal is q_d (nq,), a
    `Reference`, or a callable of t that returns either. duration, dt [s], theta0, title: of every rollout.
    progress: one bar over all.

    executor: any `concurrent.futures.Executor`, which stays open; by default a pool with one process a core,
    in which case a script needs its ``if __name__ == "__main__":`` as always with processes. Every rollout
    works on a copy of its controller, plant and goal: one plant may serve many goals, and threads share
    nothing.

    A rollout that fails, even one whose process in the default pool dies, loses no other: its
    SimulationError stands in its place, with the index of the rollout in its message and the record until
    then (``error.record``, None where there was no sample), and the bar counts it. Raises ArgumentError,
    before anything runs, for sequences of different lengths and for what cannot be copied to another
    process, such as a lambda.
    """
    given: dict[str, Any] = {"controller": controller, "plants": plants, "goals": goals}
    given = {name: list(value) if isinstance(value, Iterator) else value for name, value in given.items()}
    many = {name: value for name, value in given.items() if _is_sequence(value)}
    sizes = {name: len(value) for name, value in many.items()}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{size} in {name}" for name, size in sizes.items())
        raise ArgumentError(f"rollouts: expected sequences of the same length, got {listed}")
    count = next(iter(sizes.values()), 1)
    options = {"duration": duration, "dt": dt, "theta0": theta0, "title": title, "progress": False}
    shared = _packed({name: value for name, value in given.items() if name not in many} | options, "all")
    jobs = [(shared, _packed({name: value[k] for name, value in many.items()}, str(k))) for k in range(count)]
    pool = ProcessPoolExecutor() if executor is None else executor
    results: dict[int, Record | SimulationError] = {}
    lost: list[int] = []  # their process died, or that of another one in the same pool
    futures: dict[Future[Record], int] = {}
    with tqdm(total=count, desc=title or None, unit="rollout", disable=None if progress else True) as bar:
        try:
            for k, job in enumerate(jobs):
                futures[_submitted(pool, job)] = k
            for future in as_completed(futures):
                k = futures[future]
                if executor is None and isinstance(future.exception(), BrokenExecutor):
                    lost.append(k)
                else:
                    _report(results, k, future, bar)
            for k in sorted(lost):
                with ProcessPoolExecutor(1) as alone:
                    _report(results, k, _submitted(alone, jobs[k]), bar)
        finally:
            for future in futures:
                future.cancel()
            if executor is None:
                pool.shutdown()
    return [results[k] for k in range(count)]


def _is_sequence(value: Any) -> bool:
    """Whether there is one entry a rollout: a (nq,) goal of numbers is one goal, a Reference too."""
    if isinstance(value, Reference) or hasattr(value, "step") or not isinstance(value, Sequence | np.ndarray):
        return False
    return not (len(value) and np.isscalar(value[0]))


def _packed(arguments: dict[str, Any], which: str) -> bytes:
    try:
        return pickle.dumps(arguments)
    except Exception as reason:
        raise ArgumentError(
            f"rollout {which}: expected a controller, plant and goal that can be pickled, got one that "
            f"cannot ({reason}); functions and classes must stand at the top of a module, not be a lambda"
        ) from reason


def _rollout(shared: bytes, own: bytes) -> Record:
    arguments = pickle.loads(shared) | pickle.loads(own)
    return simulate(arguments.pop("controller"), arguments.pop("plants"), arguments.pop("goals"), **arguments)


def _submitted(pool: Executor, job: tuple[bytes, bytes]) -> Future[Record]:
    """The rollout's future; one that has failed where the pool is broken already."""
    try:
        return pool.submit(_rollout, *job)
    except BrokenExecutor as reason:
        failed: Future[Record] = Future()
        failed.set_exception(reason)
        return failed


def _report(results: dict[int, Record | SimulationError], k: int, future: Future[Record], bar: Any) -> None:
    """Enter what became of rollout k, and show it."""
    try:
        results[k] = future.result()
    except Exception as reason:
        message, record = f"{type(reason).__name__}: {reason}", None
        if isinstance(reason, SimulationError):
            message, record = str(reason), reason.record
        results[k] = error = SimulationError(f"rollout {k}: {message}", record)
        error.__cause__ = reason
        bar.set_postfix(failed=sum(isinstance(result, SimulationError) for result in results.values()))
    bar.update()
