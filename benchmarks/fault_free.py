"""Ten minutes in which nothing is wrong: moves, loads that come and go, pushes of 30 N, and noise.

A panda behind its gate, half of the time on each engine; whatever the gate names is a false alarm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from drawn import direction, posture
from fault_kinds import ROBOT
from fault_runs import DT, ENGINES, NOISE, controller

import eladapt as ea
from eladapt.robot.protocols import Plant
from eladapt.simulation.faults import Push

STRETCHES, LASTS = 20, 30.0  # [s] each, with a load of its own
HEAVIEST, PUSH, RAMP = 3.0, 30.0, 0.1  # [kg] the panda's payload, [N], [s] in which a push comes, at most
EVERY = 5.0  # [s] from push to push


class Stretch(NamedTuple):
    """How long it was undisturbed [s], the largest share of a speed limit, and the false alarm if any."""

    lasted: float
    peak: float
    alarm: ea.Fault | None


def disturbed(rng: np.random.Generator, engine: str) -> Plant:
    """An arm somewhere, with a load for some seconds and a push in each five."""
    attach = rng.uniform(1.0, 10.0)
    com = tuple(0.05 * rng.uniform() * direction(rng))
    load = ea.Payload(rng.uniform(0.5, HEAVIEST), com, attach=attach, release=attach + rng.uniform(3.0, 15.0))
    seed = int(rng.integers(2**31))
    plant = ENGINES[engine](ROBOT, posture(ROBOT, rng), noise=NOISE, payload=load, seed=seed)
    for begins in np.arange(0.0, LASTS, EVERY):
        start = begins + rng.uniform(0.5, 2.5)
        end = start + rng.uniform(0.1, 2.0)
        plant = Push(plant, PUSH * direction(rng), start=start, end=end, ramp=rng.uniform(0.0, RAMP))
    return plant


def stretch(seed: int) -> Stretch:
    """Random moves, each of which begins 1 to 4 s after the one before, until the first alarm."""
    rng = np.random.default_rng(seed)
    plant, gated = disturbed(rng, list(ENGINES)[seed % 2]), controller(jumps=False)
    measurement = plant.reset()
    state = gated.init(measurement)
    goal, until, peak = plant.q.copy(), 0.5, 0.0
    for k in range(round(LASTS / DT)):
        if k * DT >= until:
            goal, until = posture(ROBOT, rng), until + rng.uniform(1.0, 4.0)
        state, tau = gated.step(state, measurement, goal, DT)
        peak = max(peak, float(np.max(np.abs(plant.v) / ROBOT.velocity_limit)))
        if state.fault is not None:
            return Stretch(k * DT, peak, state.fault)
        measurement = plant.step(tau, DT)
    return Stretch(LASTS, peak, None)


def section(stretches: list[Stretch]) -> str:
    """What was said of them, in Markdown."""
    alarms = [s.alarm for s in stretches if s.alarm is not None]
    count = f"{len(alarms)} false alarms" if not alarms else f"**{len(alarms)} false alarms**"
    lines = [
        "## Nothing is wrong",
        "",
        f"{sum(s.lasted for s in stretches) / 60:.1f} minutes of random moves on both engines, in stretches "
        f"of {LASTS:g} s that end with an alarm; in each a load of up to {HEAVIEST:g} kg that comes and "
        f"goes, at whatever speed, and a push of {PUSH:g} N in any direction every {EVERY:g} s, which comes "
        f"and goes within 0 to {1e3 * RAMP:g} ms and lasts up to 2 s: {count}, largest share of a speed "
        f"limit {max(s.peak for s in stretches):.2f}.",
        *[f"\n- {alarm}" for alarm in alarms],
    ]
    return "\n".join(lines)
