"""The loop reads, steps and writes at its rate, follows goals, and goes on with what was learned."""

import dataclasses
import time

import numpy as np
import pytest
from looped import DT, Simulated, made

import eladapt as ea
from eladapt.errors import ArgumentError, StateError


def test_the_loop_regulates_at_its_rate_and_stops_the_robot():
    """Two seconds of the two-link arm: as many calls as ticks, the set-point reached, the rate kept."""
    robot, controller, plant, goal = made()
    interface = Simulated(plant)
    began = time.monotonic()
    result = ea.run_loop(controller, interface, goal, 2.0, DT)
    took = time.monotonic() - began
    assert result.ended == "duration"
    assert result.fault is None
    ticks = result.timing.ticks
    assert interface.calls[:2] == ["start", "read"]
    assert interface.calls[2:] == [*["read", "write"] * ticks, "stop", "read"]
    assert result.unstopped == ""
    assert len(result.record) == ticks
    assert ticks + result.timing.missed == pytest.approx(400, abs=1)
    assert took > 1.9, "the loop did not wait"
    assert np.abs(result.record.error[-1]).max() < 2e-3
    assert result.record.title == robot.name


def test_a_goal_may_be_a_reference_that_moves():
    """The gate and the record take it as `simulate` does; one that is broken is a fault, not a crash."""
    robot, controller, plant, goal = made()
    still, moved = np.zeros(robot.nv), np.full(robot.nv, 0.1)

    def course(t):
        return ea.Reference(robot.integrate(plant.q0, t * moved), moved, still)

    result = ea.run_loop(controller, Simulated(plant), course, 0.2, DT, shaped=False)
    record = result.record
    assert result.fault is None
    np.testing.assert_array_equal(record.goal_velocity, np.tile(moved, (len(record), 1)))
    np.testing.assert_array_equal(record.goal[-1], course(record.t[-1]).q)
    assert np.array_equal(result.state.gate.goal.v, moved)
    broken = ea.Reference(goal, "fast", still)
    result = ea.run_loop(controller, Simulated(plant), lambda t: broken, 0.2, DT, after_fault=0.05)
    assert result.fault.name == "goal"
    assert np.isnan(result.record.goal_velocity).all()
    assert np.isfinite(result.record.tau).all()


def test_a_checkpoint_carries_what_was_learned_to_the_next_run(tmp_path):
    """The next run, on a robot whose clock begins again, has the estimate and the information of the last."""
    _, controller, plant, goal = made()
    path = tmp_path / "state.npz"
    first = ea.run_loop(controller, Simulated(plant), goal, 2.0, DT, checkpoint=path, every=0.25)
    state = ea.load_state(path, controller)
    assert np.array_equal(state.theta, first.state.theta)
    second = ea.run_loop(controller, Simulated(plant), goal, 2.0, DT, state=state)
    assert second.fault is None
    assert second.record.theta_true is None, "of a real robot nothing is known"
    true = controller.regressors.theta_potential
    # the first run moved both joints, so that gravity is known to a percent from the first sample on
    assert np.abs(second.record.theta[0] - true).max() < 0.01 * np.abs(true).max()
    assert np.abs(second.record.theta[-1] - true).max() < 0.01 * np.abs(true).max()
    assert np.abs(second.record.error[-1]).max() < 2e-3
    with pytest.raises(StateError):
        ea.load_state(path, dataclasses.replace(controller, gate=made(max_age=0.5)[1].gate))


def test_a_goal_that_is_shaped_inside_a_gate_is_not_shaped_again():
    """The state is that of the controller given, whose innermost holds the reference."""
    robot, controller, plant, goal = made()
    inside = ea.GatedController.for_robot(ea.Shaped(controller.controller), DT)
    result = ea.run_loop(inside, Simulated(plant), goal, 0.1, DT)
    assert isinstance(result.state.inner.reference, ea.Reference)
    with pytest.raises(ArgumentError, match="controller: expected a controller, got Robot"):
        ea.run_loop(robot, Simulated(plant), goal, 0.1, DT)
