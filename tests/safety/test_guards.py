"""What shows that a loop comes apart is named, and what looks like it is not."""

import numpy as np
import pytest
from shared import load

from eladapt.safety.guards import DivergenceGuard

DT = 1e-3


def test_a_swing_that_does_not_end_is_named():
    """A guard that sees a joint swing at 5 Hz about a goal that rests names it within two seconds, and not
    one that dies away."""
    robot, guard, still = load("two_link"), DivergenceGuard(), np.zeros(2)

    def named(decay):
        state = guard.init(still, 2)
        for k in range(2000):
            t = k * DT
            v = np.array([0.5 * np.exp(-decay * t) * np.cos(10 * np.pi * t), 0.0])
            state = guard.step(state, still, still, still, v, np.zeros(2), DT)
            if alarm := guard.alarm(state, still, v, robot):
                return alarm.name
        return None

    assert named(0.0) == "oscillation"
    assert named(2.0) is None


@pytest.mark.parametrize(("acceleration", "named"), [(-20.0, "stall"), (5.0, None)])
def test_a_joint_that_gets_faster_against_its_full_torque_is_named(acceleration, named):
    """After 0.1 s, for what it carries is too heavy; not one that full torque slows down, however long."""
    robot, guard, still = load("two_link"), DivergenceGuard(), np.zeros(2)
    state, alarm, k = guard.init(still, 2), None, 0
    while alarm is None and k < 400:
        v = np.array([-2.5 + acceleration * k * DT, 0.0])
        state = guard.step(state, still, still, still, v, np.array([1.0, 0.0]), DT)
        alarm, k = guard.alarm(state, still, v, robot), k + 1
    assert (alarm.name if alarm else None) == named
    assert alarm is None or 0.1 <= k * DT < 0.11
