"""A gate keeps what it owes on every fault of the table, and says nothing where nothing is wrong.

The limits are those of the table: a name that is true of the fault, brakes asked for within 60 ms of one with
which no torque can be trusted and within 10 ms of passing a speed limit, no joint beyond 1.3 times its limit
but where the fault itself leaves more, an arm that comes to rest, nothing silent.
"""

import math
from concurrent.futures import ProcessPoolExecutor

import fault_free
import pytest
from fault_cases import BOTH, CASES
from fault_runs import PEAK, Outcome, allowed, misses, run

# What the gate does not do yet.
KNOWN = {
    "motor 1 dead, moving": "named after 121 ms: it coasts, and its torque grows slowly",
    "motor 4 stuck at its torque, moving": "named after 102 ms",
    "motor 7 dead, moving": "named after 107 to 120 ms: it needs no torque to move on",
    "goal beyond joint 2's limit": "the gate sees the one that Shaped takes in its place, with a warning",
}
# Of 20 stretches; 10 are measured, and rounding on another machine may make one or two more.
FALSE_ALARMS = 12

# One of each kind, which all end soon.
FAST = (
    "encoder 7 counts backwards", "velocity 7 of the wrong sign", "encoders 5 and 7 swapped",
    "encoder 1 loses a turn, moving", "velocities zero, jump", "positions, velocities frozen, moving",
    "nan for good, moving", "motor 4 reversed", "motor 4 dead, moving", "100 N along x for 0.2 s, moving",
    "clock set back by 1 s, moving", "goal of nan, moving",
)  # fmt: skip


def kept(name, engine):
    case = CASES[name]
    if engine not in case.engines:
        pytest.skip(f"{engine}'s plant cannot have it")
    outcome, most = run(case, engine), allowed(case, engine)
    missed = misses(case, outcome, most)
    assert not missed, f"{sorted(missed)} of {outcome}, peak allowed {most:.2f}, owed {case.owed}"


@pytest.mark.parametrize("name", FAST)
def test_one_of_each_kind_is_named_braked_and_slow_enough(name):
    kept(name, "Pinocchio")


@pytest.mark.parametrize(
    ("changed", "missed"),
    [
        ({}, set()),
        ({"name": "goal"}, {"name"}),
        ({"after": -0.1}, {"name"}),
        ({"brakes": 0.061}, {"brakes"}),
        ({"passed": 0.01, "brakes": 0.021}, {"brakes"}),
        ({"passed": 0.01, "brakes": 0.02}, set()),
        ({"peak": PEAK + 0.01}, {"peak"}),
        ({"rest": math.nan}, {"rest"}),
        ({"name": "-", "after": math.nan, "brakes": math.nan}, {"name", "brakes", "silent"}),
    ],
)
def test_what_a_gate_misses_is_found(changed, missed):
    """Each limit by itself, from the outcome of a motor that dies and a gate that does all it owes."""
    good = Outcome("unresponsive", 0.05, 0.06, math.nan, 0.5, 0.1, False, "", "panda_joint4")
    assert misses(CASES["motor 4 dead, moving"], good._replace(**changed), PEAK) == missed


@pytest.mark.slow
@pytest.mark.parametrize("engine", BOTH)
@pytest.mark.parametrize("name", CASES)
def test_every_fault_is_named_braked_and_slow_enough(name, engine):
    """But those of which it is known, and told in the table, that they are not."""
    if name in KNOWN:
        pytest.xfail(KNOWN[name])
    kept(name, engine)


@pytest.mark.slow
def test_moves_loads_and_pushes_are_no_faults():
    """Ten minutes in all, half a minute each: no more stretches end in an alarm than the table says."""
    with ProcessPoolExecutor() as pool:
        alarms = [found.alarm for found in pool.map(fault_free.stretch, range(fault_free.STRETCHES))]
    assert sum(alarm is not None for alarm in alarms) <= FALSE_ALARMS, alarms
