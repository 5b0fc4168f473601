"""Faults of a panda, each with what a gate owes: `faults.py` makes a table of them, and a test its limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from fault_kinds import (
    ALL,
    HOME,
    ROBOT,
    TARGET,
    Goals,
    Kind,
    backwards,
    clock_set,
    clock_shaken,
    dead_encoder,
    dead_motor,
    full_motor,
    jumping,
    misread,
    nan_from,
    only,
    opposite,
    pushed,
    reversed_motors,
    scaled,
    shifted,
    stronger,
    stuck_motor,
    swapped,
    swung,
)  # fmt: skip

import eladapt as ea
from eladapt.simulation.faults import BlockedJoints, FrozenSensor, Jitter, LostNumbers, Packets, WeakMotors
from eladapt.simulation.instruments import Delay

MOVING, RESTING = 0.3, 2.0  # [s] when faults begin: in the middle of the move, and at rest
NONE, REFUSED = "-", "refused"
BOTH = ("Pinocchio", "MuJoCo")


class Owed(NamedTuple):
    """What a gate owes: to name one of these faults, or NONE where the arm may go on; and its brakes.

    brakes [s]: when they are to be asked for at the latest, from when the fault begins.
    """

    named: frozenset[str]
    brakes: float = np.inf

    def or_(self, *names: str) -> Owed:
        """The same, where the fault may be told by these too."""
        return self._replace(named=self.named | set(names))


NOTHING = Owed(frozenset({NONE}))
TURNS = Owed(frozenset({"reversed", "unresponsive", "sensor", "jump", REFUSED}), 0.06)
STANDS = Owed(frozenset({"unresponsive", "sensor", "frozen", "watchdog", "jump"}), 0.06)
LOST = Owed(frozenset({"measurement", "watchdog"}), 0.06)
WRONG = Owed(frozenset({"sensor", "jump"}), 0.06)
CONTRADICTED = Owed(frozenset({"sensor", "jump"}))
GOAL = Owed(frozenset({"goal"}))
START = Owed(frozenset({REFUSED}))
BEARABLE = Owed(frozenset({NONE, "energy growth", "oscillation", "error growth", "stall", "unresponsive"}))
PASSES = BEARABLE.or_("velocity", "joint limit", "contact")


class Case(NamedTuple):
    """A fault, when it begins [s], and what a gate owes.

    jumps: the goal is the controller's as it is, from theta = 0, instead of a motion there. faster: the fault
    itself leaves the speed limits behind before any brake closes. unsaid: the arm may end off its set-point
    without a word, since nothing that is measured contradicts it, or the goal does not rest. arm: options of
    its plant.
    """

    name: str
    begins: float
    kind: Kind
    owed: Owed
    duration: float = 4.0
    arm: Mapping[str, Any] = {}
    goal: Goals = lambda _t: TARGET
    jumps: bool = False
    faster: bool = False
    unsaid: bool = False
    engines: tuple[str, ...] = BOTH


def nothing(plant: Any, _begins: float) -> Any:
    return plant


def sensors() -> list[Case]:
    """Encoders that are wrong, stand still or are noisy."""
    shaken = BEARABLE.or_("sensor", "jump")
    return [
        *(Case(f"encoder {j} of the wrong sign", 0, opposite(j), TURNS) for j in ALL),
        *(Case(f"encoder {j} counts backwards", 0, backwards(j), TURNS) for j in ALL),
        Case("encoder 1 of the wrong sign, jump", 0, opposite(1), TURNS, jumps=True),
        Case("encoder 1 of the wrong sign, moving", MOVING, opposite(1), TURNS),
        *(Case(f"velocity {j} of the wrong sign", 0, opposite(j, q=False), TURNS) for j in (1, 4, 7)),
        Case("velocities of the wrong sign", 0, opposite(*ALL, q=False), TURNS),
        Case("velocities of the wrong sign, jump", 0, opposite(*ALL, q=False), TURNS, jumps=True),
        *(
            Case(f"encoders {i} and {j} swapped", 0, swapped(i, j), TURNS)
            for i, j in ((1, 3), (2, 4), (5, 7), (1, 5))
        ),
        Case("encoders 1 and 3 swapped, jump", 0, swapped(1, 3), TURNS, jumps=True),
        Case("encoder 1 a turn off", 0, shifted(1, 2 * np.pi), START),
        Case("encoder 1 loses a turn, moving", MOVING, shifted(1, 2 * np.pi), WRONG),
        Case("encoder 7 loses a turn, at rest", RESTING, shifted(7, 2 * np.pi), WRONG),
        Case("encoder 4 jumps by 0.3 rad, at rest", RESTING, shifted(4, 0.3), WRONG),
        Case("encoder 4 jumps by 0.05 rad, at rest", RESTING, shifted(4, 0.05), CONTRADICTED),
        Case("encoder 2 off by 0.05 rad", 0, shifted(2, 0.05), NOTHING, unsaid=True),
        Case("velocities doubled", 0, scaled(2.0), CONTRADICTED),
        Case("velocities halved", 0, scaled(0.5), CONTRADICTED),
        Case("velocities zero", 0, scaled(0.0), CONTRADICTED),
        Case("velocities halved, jump", 0, scaled(0.5), WRONG, jumps=True),
        Case("velocities zero, jump", 0, scaled(0.0), WRONG, jumps=True),
        Case("encoder 4 dead, moving", MOVING, dead_encoder(4), STANDS),
        Case("encoder 1 dead, moving", MOVING, dead_encoder(1), STANDS),
        Case("encoder 7 dead, moving", MOVING, dead_encoder(7), STANDS),
        Case("encoder 4 dead, at rest", RESTING, dead_encoder(4), STANDS, 9.0),
        Case("positions, velocities frozen, moving", MOVING, FrozenSensor, STANDS),
        Case("positions, velocities frozen, at rest", RESTING, FrozenSensor, STANDS, 9.0),
        Case("measurement frozen, moving", MOVING, misread(lambda _, good: good), STANDS),
        Case("measurement frozen, at rest", RESTING, misread(lambda _, good: good), STANDS),
        Case("nan for 50 ms, moving", MOVING, lambda plant, at: LostNumbers(plant, at, at + 0.05), LOST),
        Case("nan for good, moving", MOVING, LostNumbers, LOST),
        Case("noise 1e-3 rad, 1e-2 rad/s", 0, nothing, NOTHING, arm={"noise": ea.Noise(1e-3, 1e-2)}),
        Case("noise 1e-2 rad, 1e-1 rad/s", 0, nothing, shaken, arm={"noise": ea.Noise(1e-2, 1e-1)}),
        Case("noise 1e-2 rad, 1e-3 rad/s", 0, nothing, shaken, arm={"noise": ea.Noise(1e-2, 1e-3)}),
    ]  # fmt: skip


def drives() -> list[Case]:
    """Motors that do something else than told."""

    def weak(share: float) -> Kind:
        return lambda plant, begins: WeakMotors(plant, share, start=begins)

    def late(delay: float) -> Kind:
        return lambda plant, _: Delay(plant, delay)

    def blocked(plant: Any, begins: float) -> BlockedJoints:
        return BlockedJoints(plant, ["panda_joint4"], start=begins, end=1.0)

    held = STANDS._replace(brakes=np.inf)  # its drive does what it is told
    turned, gone = TURNS.or_("velocity"), STANDS.or_("velocity", "joint limit")
    return [
        *(Case(f"motor {j} reversed", 0, reversed_motors(j), TURNS) for j in ALL),
        Case("motor 4 reversed, jump", 0, reversed_motors(4), TURNS, jumps=True),
        Case("motors reversed", 0, reversed_motors(*ALL), TURNS),
        Case("motors reversed, jump", 0, reversed_motors(*ALL), turned, jumps=True, faster=True),
        Case("motor 1 reversed, moving", MOVING, reversed_motors(1), TURNS),
        Case("motor 4 reversed, at rest", RESTING, reversed_motors(4), turned, faster=True),
        Case("torque halved", 0, stronger(0.5), BEARABLE),
        Case("torque 1.5 times", 0, stronger(1.5), BEARABLE),
        Case("torque 3 times", 0, stronger(3.0), BEARABLE),
        Case("torque 3 times, jump", 0, stronger(3.0), BEARABLE, jumps=True),
        *(Case(f"motor {j} dead, moving", MOVING, dead_motor(j), STANDS) for j in (1, 4, 7)),
        Case("motor 2 dead, at rest", RESTING, dead_motor(2), STANDS),
        Case("motor 4 stuck at its torque, moving", MOVING, stuck_motor(4), STANDS, 7.0),
        Case("motor 4 full on, at rest", RESTING, full_motor(4), gone, faster=True),
        Case("motor 7 full on, at rest", RESTING, full_motor(7), gone, faster=True),
        Case("torque saturated at 30 %", 0, weak(0.3), BEARABLE),
        Case("torque saturated at 30 %, jump", 0, weak(0.3), PASSES, jumps=True),
        Case("torque saturated at 15 %", 0, weak(0.15), PASSES),
        Case("torque 3 ms late", 0, late(3e-3), BEARABLE),
        Case("torque 6 ms late", 0, late(6e-3), BEARABLE),
        Case("joint 4 blocked for 0.7 s, moving", MOVING, blocked, held, engines=("Pinocchio",)),
    ]


def touches() -> list[Case]:
    """Loads and pushes."""

    def loaded(mass: float, attach: float = RESTING) -> dict[str, Any]:
        return {"payload": ea.Payload(mass, attach=attach)}

    return [
        Case("5 kg", 0, nothing, NOTHING, arm=loaded(5.0, 0.0)),
        Case("5 kg comes, at rest", RESTING, nothing, NOTHING, arm=loaded(5.0)),
        Case("10 kg comes, at rest", RESTING, nothing, PASSES, arm=loaded(10.0)),
        Case("20 kg comes, at rest", RESTING, nothing, PASSES, arm=loaded(20.0), faster=True),
        Case("100 N along x for 0.2 s, at rest", RESTING, pushed((100, 0, 0), 0.2), PASSES, faster=True),
        Case("100 N along y for 0.2 s, at rest", RESTING, pushed((0, 100, 0), 0.2), PASSES, faster=True),
        Case("100 N down for 0.2 s, at rest", RESTING, pushed((0, 0, -100), 0.2), PASSES, faster=True),
        Case("300 N along y for 0.2 s, at rest", RESTING, pushed((0, 300, 0), 0.2), PASSES, faster=True),
        Case("100 N along x for 0.2 s, moving", MOVING, pushed((100, 0, 0), 0.2), PASSES, faster=True),
        Case("100 N along y for 0.2 s, moving", MOVING, pushed((0, 100, 0), 0.2), PASSES, faster=True),
        Case("30 N along y for 3 s, at rest", RESTING, pushed((0, 30, 0), 3.0), NOTHING, 7.0),
        Case("30 N up for 0.5 s, moving", MOVING, pushed((0, 0, 30), 0.5), NOTHING),
        Case("hand swung by 15 cm at 0.5 Hz", RESTING, swung(0.15), PASSES, 8.0, faster=True),
        Case("hand swung by 30 cm at 0.5 Hz", RESTING, swung(0.3), PASSES, 8.0, faster=True),
    ]


def clocks() -> list[Case]:
    """Time stamps, samples and packets."""

    def spaced(least: float, most: float) -> Kind:
        return lambda plant, begins: Jitter(plant, least, most, start=begins)

    def lost(share: float) -> Kind:
        return lambda plant, begins: Packets(plant, share, start=begins)

    return [
        Case("clock set back by 1 s, moving", MOVING, clock_set(-1.0), NOTHING),
        Case("clock set back by 1 s, at rest", RESTING, clock_set(-1.0), NOTHING),
        Case("clock set forward by 10 s, moving", MOVING, clock_set(10.0), NOTHING),
        Case("clock set forward by 1 h, at rest", RESTING, clock_set(3600.0), NOTHING),
        Case("time stamps off by up to 2 ms", 0, clock_shaken, NOTHING),
        Case("samples 0.2 to 2 ms apart", 0, spaced(2e-4, 2e-3), NOTHING),
        Case("samples 1 to 8 ms apart", 0, spaced(1e-3, 8e-3), BEARABLE),
        Case("10 % of packets lost, both ways", 0, lost(0.1), NOTHING),
        Case("no packet any more, moving", MOVING, lost(1.0), STANDS),
    ]


def goals() -> list[Case]:
    """Goals and starts that no arm should have."""
    shaken = BEARABLE.or_("velocity")

    def beyond(_t: float) -> np.ndarray:
        return TARGET + 3.0 * only(2)

    outside, fast = {"q0": np.where(only(1), 3.1, HOME)}, {"v0": 0.9 * ROBOT.velocity_limit}
    near, far, slow = jumping(0.01, 0.5), jumping(0.01, 3.0), jumping(0.3, 3.0)
    return [
        Case("goal beyond joint 2's limit", 0, nothing, GOAL, goal=beyond),
        Case("goal beyond joint 2's limit, jump", 0, nothing, GOAL, goal=beyond, jumps=True),
        Case("goal of nan", 0, nothing, GOAL, goal=nan_from(0.0)),
        Case("goal of nan, moving", MOVING, nothing, GOAL, goal=nan_from(MOVING)),
        Case("goal of nan, moving, jump", MOVING, nothing, GOAL, goal=nan_from(MOVING), jumps=True),
        Case("goals 0.5 rad apart every 10 ms, jump", 0, nothing, shaken, goal=near, jumps=True, unsaid=True),
        Case("goals 3 rad apart every 10 ms, jump", 0, nothing, shaken, goal=far, jumps=True, unsaid=True),
        Case("goals 3 rad apart every 0.3 s, jump", 0, nothing, shaken, goal=slow, jumps=True, unsaid=True),
        Case("goals 3 rad apart every 0.3 s", 0, nothing, NOTHING, goal=slow, unsaid=True),
        Case("start 0.2 rad beyond joint 1's limit", 0, nothing, START, arm=outside),
        Case("start at 2 rad/s in joint 1", 0, nothing, NOTHING, arm={"v0": 2.0 * only(1)}),
        Case("start at 0.9 of all speed limits", 0, nothing, NOTHING, 6.0, arm=fast),
    ]  # fmt: skip


GROUPS: tuple[Callable[[], list[Case]], ...] = (sensors, drives, touches, clocks, goals)
CASES = {
    case.name: case for case in (Case("none", 0, nothing, NOTHING), *(c for make in GROUPS for c in make()))
}
