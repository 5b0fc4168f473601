"""Faults of a panda behind its gate: what is named, when the brakes are asked for, how fast it becomes.

`Shaped(GatedController.for_robot(CompositeController.for_robot(panda)))`, every gain and limit derived, at 1
kHz from home to the target of the library, with noise; on both engines. Then what is got over, and ten
minutes in which nothing is wrong.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import fault_free
import fault_recoveries
from fault_cases import BOTH, CASES, MOVING, RESTING
from fault_runs import ARRIVED, BRAKES, LIMIT, NOISE, PASSED, PEAK, STILL, Outcome, allowed, misses, run
from table import write
from tqdm import tqdm


class Row(NamedTuple):
    """A case on an engine: what became of it, the peak that physics leaves, what is missed."""

    outcome: Outcome
    most: float
    missed: set[str]


def row(job: tuple[str, str]) -> Row | None:
    """None where an engine cannot have the fault."""
    name, engine = job
    case = CASES[name]
    if engine not in case.engines:
        return None
    outcome, most = run(case, engine), allowed(case, engine)
    return Row(outcome, most, misses(case, outcome, most))


def number(value: float, digits: int = 3) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def cells(found: Row | None) -> list[str]:
    """The columns of an engine, what is missed in bold."""
    if found is None:
        return [""] * 5
    o, missed = found.outcome, found.missed
    said = {
        "name": o.name, "after": number(o.after), "brakes": number(o.brakes), "peak": number(o.peak, 2),
        "rest": number(o.rest, 2),
    }  # fmt: skip
    return [f"**{text}**" if what in missed else text for what, text in said.items()]


def line(name: str, rows: list[Row | None]) -> list[str]:
    """A row of the table."""
    case, there = CASES[name], [found for found in rows if found is not None]
    missed = set().union(*(found.missed for found in there))
    leaves = ", ".join(f"{found.most:.2f}" for found in there)
    remark = f"the fault itself leaves {leaves}" if case.faster else ""
    remark = "nothing measured contradicts it, or the goal does not rest" if case.unsaid else remark
    columns = [cell for found in rows for cell in cells(found)]
    return [
        f"**{name}**" if missed else name, *columns, "**yes**" if "silent" in missed else "no", remark,
    ]  # fmt: skip


def notes(missing: int) -> str:
    return (
        f"{len(CASES)} faults, {missing} of which miss something (bold). Faults begin at {MOVING} s in the "
        f'middle of the move, at {RESTING:g} s at rest, or with the start. "jump": the goal is the '
        "controller's at once and its gravity unknown, instead of a motion there from the URDF's. Noise "
        f"{NOISE.position:g} rad and {NOISE.velocity:g} rad/s; brakes rub with 1.3 times the effort limits "
        f"{1e3 * BRAKES.closing:g} ms after they are asked for. Times are "
        "from when the fault began; refused: the start is. At rest: below "
        f"{STILL:g} rad/s. A row misses when the name is not true of the fault, when brakes come later than "
        "60 ms after a fault with which no torque can be trusted or than "
        f"{1e3 * PASSED:g} ms after a joint passed {LIMIT:g} times its speed limit (at which the gate says "
        f"so), when a joint becomes faster than {PEAK:g} times its limit, when a fault is named and the arm "
        "does not come to rest, and when it is silent: nothing is named, though a fault is there that must "
        f"be, a limit is passed or the arm is not within {ARRIVED:g} rad of its set-point in the end. What "
        "the fault itself leaves is the peak of the same run with brakes that are told to close "
        f"{1e3 * PASSED:g} ms after the limit is passed, whatever the gate says; on Pinocchio's and MuJoCo's "
        "plant."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    with ProcessPoolExecutor(parser.parse_args().jobs) as pool:

        def over(function: Callable[[Any], Any], jobs: Iterable[Any], what: str) -> Iterator[Any]:
            jobs = list(jobs)
            return tqdm(pool.map(function, jobs), total=len(jobs), unit=what, disable=None)

        jobs = [(name, engine) for name in CASES for engine in BOTH]
        rows = []
        for job, found in zip(jobs, over(row, jobs, "run"), strict=True):
            rows.append(found)
            if found is not None and found.missed:
                tqdm.write(f"{', '.join(job)} misses {', '.join(sorted(found.missed))}: {found.outcome}")
        recovered = list(over(fault_recoveries.named, fault_recoveries.NAMES, "run"))
        stretches = list(over(fault_free.stretch, range(fault_free.STRETCHES), "stretch"))
    recoveries = dict(zip(fault_recoveries.NAMES, recovered, strict=True))
    recoveries["process killed, resumed from its saved state"] = fault_recoveries.killed()
    pairs = dict(zip(CASES, zip(rows[::2], rows[1::2], strict=True), strict=True))
    missing = sum(any(found is not None and found.missed for found in pair) for pair in pairs.values())
    columns = ["named", "after [s]", "brakes after [s]", "peak speed / limit", "at rest after [s]"]
    head = ["fault", *(f"{engine}: {column}" for engine in BOTH for column in columns), "silent", "remark"]
    text = "\n\n".join(
        [notes(missing), fault_free.section(stretches), fault_recoveries.section(recoveries)]
    )  # fmt: skip
    lines = [line(name, list(pair)) for name, pair in pairs.items()]
    write("faults", "Faults in closed loop on the panda", head, lines, text)


if __name__ == "__main__":
    main()
