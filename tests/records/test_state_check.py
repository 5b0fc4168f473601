"""A state that its controller could not have had is refused, and the field named."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import StateError
from eladapt.records.state_check import require_state_of

DT = 1e-3
CONTROLLERS = {
    "composite": lambda robot: ea.CompositeController.for_robot(robot),
    "gated": lambda robot: ea.GatedController.for_robot(ea.CompositeController.for_robot(robot)),
    "shaped": lambda robot: ea.Shaped(
        ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, joint_terms=()))
    ),
    "Slotine-Li": lambda robot: ea.SlotineLi.for_robot(robot),
    "terminal sliding": lambda robot: ea.TerminalSliding.for_robot(robot),
    "paper C2": lambda robot: ea.paper.controller("C2"),
    "paper C3": lambda robot: ea.paper.controller("C3"),
}


def run(controller, steps, load=None, lost=()):
    """The state after so many steps of a move; ``lost``: steps whose sample is nan."""
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=load)
    measurement = plant.reset()
    state, goal = controller.init(measurement), robot.configuration(robot.target)
    for k in range(steps):
        given = measurement._replace(q=np.nan * measurement.q) if k in lost else measurement
        state, tau = controller.step(state, given, goal, DT)
        measurement = plant.step(tau, DT)
    return state


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_states_at_rest_in_a_move_and_after_a_load_came_pass(kind):
    """Before a load is noticed, the time of the last change is -inf; behind the gate it is noticed."""
    controller = CONTROLLERS[kind](load("ur5"))
    states = [run(controller, steps, ea.Payload(2.0, attach=0.4)) for steps in (0, 1, 600)]
    for state in states:
        assert require_state_of(controller, state) is state
    if kind == "gated":
        assert [state.change.noticed for state in states] == [0, 0, 1]


@pytest.mark.parametrize("kind", ["gated", "shaped"])
def test_states_without_a_measurement_and_after_a_fault_pass(kind, tmp_path):
    """What the gate holds only then: why it distrusts, the fault, where it holds the arm; through a file."""
    controller = CONTROLLERS[kind](load("kinova"))
    for steps, latched in ((110, False), (140, True), (180, True)):
        state = run(controller, steps, lost=range(100, 160))
        assert (state.fault is not None) == latched
        back = ea.load_state(ea.save_state(tmp_path / "state.npz", controller, state), controller)
        assert back.fault == state.fault


def fields(state, place="state"):
    """All leaves of a state, each with its place and a function that puts something else there."""
    for name in state._fields:
        value = getattr(state, name)
        if hasattr(value, "_fields"):
            for deeper, leaf, put in fields(value, f"{place}.{name}"):
                yield deeper, leaf, lambda new, name=name, put=put: state._replace(**{name: put(new)})
        else:
            yield f"{place}.{name}", value, lambda new, name=name: state._replace(**{name: new})


def wrong(value):
    """What such a field can never hold."""
    yield {"text": 1} if isinstance(value, str) else "text"
    if isinstance(value, str):
        yield 1.0
        return
    yield ea.Measurement(0.0, value, value, value)
    if isinstance(value, np.ndarray):
        yield np.full(value.shape, np.nan) if value.size else np.zeros(1)
        yield value.astype(complex)
        yield value.astype(np.float32)
        yield np.append(value.ravel(), 0.0)
        yield 0.0
    elif isinstance(value, bool):
        yield 1.0
    elif isinstance(value, int):
        yield -1
        yield float(value)
        yield True
    else:
        yield float("nan")
        yield np.zeros(1)
        yield complex(1.0)


@pytest.mark.parametrize("kind", ["gated", "Slotine-Li", "terminal sliding", "paper C2"])
def test_every_field_is_looked_at(kind):
    """In each leaf of a state in turn, after a fault where there is a gate: nan, another shape, another type.
    The message names the leaf."""
    controller = CONTROLLERS[kind](load("kinova"))
    state = run(controller, 60, lost=range(20, 60) if kind == "gated" else ())
    tried = 0
    for place, value, put in fields(state):
        if value is None or isinstance(value, tuple):
            continue
        for bad in wrong(value):
            with pytest.raises(StateError, match=rf"^{place}[:.\[]"):
                require_state_of(controller, put(bad))
            tried += 1
    assert tried > 50


def test_what_a_none_may_become_is_said_by_its_type():
    """An anchor of the fallback is a configuration, which on an arm with continuous joints is no velocity."""
    controller = CONTROLLERS["gated"](load("kinova"))
    robot, state = controller.robot, run(controller, 60, lost=range(20, 60))
    gate = state.gate
    assert gate.hold.anchor.shape == (robot.nq,) != (robot.nv,)
    for bad in (gate.hold._replace(anchor=np.zeros(robot.nv)), gate.hold._replace(offset=np.zeros(robot.nq))):
        with pytest.raises(StateError, match=r"state\.gate\.hold\.(anchor|offset): expected an array"):
            require_state_of(controller, state._replace(gate=gate._replace(hold=bad)))


def test_a_switch_that_a_file_would_turn_is_refused():
    """A guard that bears any error, a detector that is not there, a count of parameters that is another."""
    controller = CONTROLLERS["gated"](load("two_link"))
    state = run(controller, 20)
    inner, gate = state.inner, state.gate
    strange = ea.safety.gate.Fault("jump", 0.0, 1)
    deaf = gate._replace(guard=gate.guard._replace(asked=np.full(2, np.inf)))
    for place, bad in (
        ("gate.guard.asked", state._replace(gate=deaf)),
        ("inner.change", state._replace(inner=inner._replace(change=None))),
        ("inner.n_potential", state._replace(inner=inner._replace(n_potential=10**9))),
        ("inner", state._replace(inner=gate)),
        (
            "gate.fault.message",
            state._replace(gate=gate._replace(fault=strange)),
        ),
    ):
        with pytest.raises(StateError, match=rf"^state\.{place}: expected"):
            require_state_of(controller, bad)


def test_the_file_is_named(tmp_path):
    """As a file that was written after the memory was corrupted is met."""
    controller = CONTROLLERS["gated"](load("two_link"))
    state = run(controller, 5)
    spoiled = state._replace(gate=state.gate._replace(tau=np.full(2, np.nan)))
    path = ea.save_state(tmp_path / "bad.npz", controller, spoiled)
    with pytest.raises(StateError, match=r"bad\.npz: not a state of .*state\.gate\.tau: expected finite"):
        ea.load_state(path, controller)
