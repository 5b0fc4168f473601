"""What a loop cannot do is refused before the robot starts, with what was given and what is legal."""

import numpy as np
import pytest
from looped import DT, Simulated, made

import eladapt as ea
from eladapt.errors import ArgumentError


def test_a_state_with_a_fault_is_refused_until_reset():
    _, controller, plant, goal = made()
    state = controller.init(plant.reset())
    state, _ = controller.step(state, plant.reset(), goal * np.nan, DT)
    with pytest.raises(ArgumentError, match=r"holds the fault goal at .* clear it"):
        ea.run_loop(controller, Simulated(plant), goal, 0.1, DT, state=state)
    result = ea.run_loop(controller, Simulated(plant), goal, 0.1, DT, state=controller.reset(state))
    assert result.fault is None


@pytest.mark.parametrize("missing", ["start", "read", "write", "stop"])
def test_an_interface_that_lacks_a_method_is_refused_before_anything_starts(missing):
    """Above all one without stop, which would be missed when the arm moves."""
    _, controller, plant, goal = made()
    interface = Simulated(plant)
    setattr(interface, missing, None)
    with pytest.raises(ArgumentError, match=rf"interface: expected .* Simulated lacks {missing}$"):
        ea.run_loop(controller, interface, goal, 0.1, DT)
    assert interface.calls == []


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (None, r"goal: expected shape \(2,\), got \(\)"),
        ([0.1, 0.2, 0.3], r"goal: expected shape \(2,\), got \(3,\)"),
        ([0.1, np.nan], "goal: expected finite numbers"),
        ("home", "goal: expected 2 numbers, got 'home'"),
        (ea.Reference(np.zeros(2), np.zeros(3), np.zeros(2)), r"goal.v: expected shape \(2,\)"),
    ],
)
def test_a_fixed_goal_that_is_none_is_refused_before_the_robot_starts(goal, said):
    """With what was given, and what a goal may be."""
    _, controller, plant, _ = made()
    interface = Simulated(plant)
    with pytest.raises(ArgumentError, match=rf"{said}.*; expected q_d \(2,\), a Reference, or a callable"):
        ea.run_loop(controller, interface, goal, 0.1, DT)
    assert interface.calls == []


def test_a_record_that_memory_does_not_hold_is_refused_before_the_robot_starts():
    """With what it would take, and what there is."""
    _, controller, plant, goal = made()
    interface = Simulated(plant)
    with pytest.raises(ArgumentError, match=r"of 2e\+11 samples takes .* GB of memory, this computer has"):
        ea.run_loop(controller, interface, goal, 1e9, DT)
    with pytest.raises(ArgumentError, match="duration: expected a finite number"):
        ea.run_loop(controller, interface, goal, 1e308, DT)
    assert interface.calls == []
