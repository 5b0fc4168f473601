"""Behind the gate, whatever is measured or computed, the torque is finite and within its limits."""

import dataclasses
import re

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.safety.guards import DivergenceGuard

DT = 1e-3


class Dictated:
    """A controller that says what it is told to, whatever it sees."""

    def __init__(self, robot, says):
        self.robot, self.says = robot, says

    def init(self, measurement, theta0=None):
        return 0

    def step(self, state, measurement, goal, dt):
        return state + 1, self.says(state)


def gated(name="two_link", **limits) -> ea.GatedController:
    return ea.GatedController.for_robot(ea.CompositeController.for_robot(load(name)), DT, **limits)


def started(controller):
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    return plant, measurement, controller.init(measurement), robot.configuration(robot.target)


def run(controller, plant, state, measurement, goal, steps):
    """The state and the measurement after some steps, and every torque."""
    torques = []
    for _ in range(steps):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        torques.append(tau)
    return state, measurement, np.array(torques)


QUICK = ("two_link", "panda", "kinova")


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in ea.robots()]
)
def test_every_robot_regulates_within_the_limits_of_its_urdf(name):
    """From theta_U = 0: no fault, torque and its rate within bounds, no joint above 1.1 of its speed limit.

    Ungated, six of these robots exceed their speed limits, by up to 12 times.
    """
    robot, controller = load(name), gated(name)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 3.0, progress=False)
    gate = controller.gate
    assert record.final_state.fault is None
    assert record.settling_time() < 3
    assert np.all(np.abs(record.v) <= gate.velocity)
    assert np.all(np.abs(record.tau) <= gate.effort)
    rate = np.abs(np.diff(record.tau, axis=0, prepend=plant.reset().tau[None])) / DT
    assert np.all(rate <= gate.torque_rate * (1 + 1e-9))  # rounding of the difference
    assert len(record.theta_labels) == record.theta.shape[1] == controller.regressors.n_potential


def test_a_gate_that_has_nothing_to_do_changes_nothing():
    """With limits out of reach, the torque is the controller's to the last bit."""
    bare = ea.CompositeController.for_robot(load("two_link"))
    controller = ea.GatedController.for_robot(bare, torque_rate=np.inf, effort=1e3)
    plant, measurement, state, goal = started(controller)
    inner = bare.init(measurement)
    for _ in range(300):
        state, tau = controller.step(state, measurement, goal, DT)
        inner, expected = bare.step(inner, measurement, goal, DT)
        assert np.array_equal(tau, expected)
        measurement = plant.step(tau, DT)
    assert np.array_equal(state.theta, inner.theta)


BAD = {
    "nan": lambda m: m._replace(q=m.q * np.nan),
    "inf": lambda m: m._replace(v=m.v + np.inf),
    "shape": lambda m: m._replace(q=m.q[:1]),
    "text": lambda m: m._replace(q="none"),
    "None": lambda m: None,
    "no time": lambda m: m._replace(t=np.nan),
    "torque": lambda m: m._replace(tau=m.tau * np.nan),
    "old": lambda m: m._replace(t=0.199),
    "far": lambda m: m._replace(q=m.q + 3.0),
}
NAMES = {"old": "watchdog", "far": "jump"}


@pytest.mark.parametrize("kind", BAD)
def test_a_short_spell_is_bridged_and_a_long_one_latches(kind):
    """Ten bad samples: the last torque is held and the run goes on. Thirty: a fault with name and time."""
    controller = gated("panda")
    plant, measurement, state, goal = started(controller)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 200)
    theta = state.theta
    for steps, latched in ((10, False), (30, True)):
        after, seen, began = state, measurement, measurement.t
        for k in range(steps):
            after, tau = controller.step(after, BAD[kind](seen._replace(t=seen.t + k * DT)), goal, DT)
            assert np.isfinite(tau).all()
            assert np.all(np.abs(tau) <= controller.gate.effort)
            if k < 20:
                assert np.array_equal(tau, state.gate.tau)
        assert np.array_equal(after.theta, theta), "nothing is learned from bad samples"
        assert (after.fault is not None) == latched
    assert after.fault.name == NAMES.get(kind, "measurement")
    assert after.fault.t == pytest.approx(began + 0.02, abs=2e-3)
    assert str(after.fault).startswith(after.fault.name)


def test_a_frozen_sensor_is_noticed_while_the_arm_moves():
    """The same numbers with new time stamps, at a speed that must show, are a fault after max_age."""
    controller = gated("panda")
    plant, measurement, state, goal = started(controller)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 150)
    for k in range(30):
        state, _ = controller.step(state, measurement._replace(t=measurement.t + (k + 1) * DT), goal, DT)
    assert state.fault.name == "frozen"


def test_an_arm_at_rest_is_not_called_frozen():
    """Numbers that do not change while nothing moves are no fault."""
    robot = load("two_link")
    controller = ea.GatedController.for_robot(Dictated(robot, lambda k: np.zeros(2)))
    measurement = ea.Measurement(0.0, np.zeros(2), np.zeros(2), np.zeros(2))
    state = controller.init(measurement)
    for k in range(500):
        state, _ = controller.step(state, measurement._replace(t=k * DT), np.zeros(2), DT)
    assert state.fault is None


SAYS = {
    "nan": (lambda k: np.array([np.nan, 0.0]) if k > 3 else np.zeros(2), "torque"),
    "inf": (lambda k: np.array([np.inf, 0.0]) if k > 3 else np.zeros(2), "torque"),
    "shape": (lambda k: np.zeros(3) if k > 3 else np.zeros(2), "torque"),
    "raises": (lambda k: 1 / 0 if k > 3 else np.zeros(2), "controller"),
}


@pytest.mark.parametrize("kind", SAYS)
def test_what_a_controller_gets_wrong_never_leaves(kind):
    """Torque that is no torque, or an exception, is a fault; what leaves is finite and the arm is held."""
    says, name = SAYS[kind]
    controller = ea.GatedController.for_robot(Dictated(load("two_link"), says))
    plant, measurement, state, goal = started(controller)
    state, measurement, torques = run(controller, plant, state, measurement, goal, 2000)
    assert state.fault.name == name
    assert state.inner == 4, "the step that failed is not remembered"
    assert np.isfinite(torques).all()
    assert np.all(np.abs(torques) <= controller.gate.effort)
    # a URDF that the arm agrees with: gravity is exact, and the spring brings it back to where it was
    assert np.abs(measurement.v).max() < 1e-3


def test_a_fault_stays_until_reset_and_the_first_one_counts():
    """Good samples do not clear a fault, other faults do not rename it; reset puts the controller back."""
    controller = gated("two_link")
    plant, measurement, state, goal = started(controller)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 300)
    state, _ = controller.step(state, measurement, np.full(2, np.nan), DT)
    first = state.fault
    assert first.name == "goal"
    state, measurement, _ = run(controller, plant, state, measurement, goal, 500)
    state, _ = controller.step(state, None, goal, DT)
    assert state.fault == first
    learned = state.theta
    state = controller.reset(state, measurement)
    assert state.fault is None
    assert np.array_equal(state.theta, learned)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 2500)
    assert state.fault is None
    assert np.abs(measurement.q - goal).max() < 1e-3
    afresh = controller.reset(state, measurement, forget=True)
    assert np.array_equal(afresh.parameters, state.trusted)
    assert not afresh.inner.information.triangle[:, -1].any()


@pytest.mark.parametrize("back", [0.1, 100.0])
def test_a_reset_goes_on_after_the_robots_clock_was_set_back(back):
    """No later sample is old, the gate's own clock never goes back, and the arm arrives."""
    controller = gated("two_link")
    plant, measurement, state, goal = started(controller)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 300)
    state, _ = controller.step(state, measurement, np.full(2, np.nan), DT)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 200)
    plant.t -= back
    measurement = measurement._replace(t=measurement.t - back)
    before, state = state.measurement.t, controller.reset(state, measurement)
    assert state.fault is None
    assert state.measurement.t > before
    state, measurement, _ = run(controller, plant, state, measurement, goal, 2500)
    assert state.fault is None
    assert np.abs(measurement.q - goal).max() < 1e-3


def test_what_acts_from_outside_is_seen_through_whatever_stands_around():
    """A shaped, gated controller's state says what the innermost one's does, and lacks what that lacks."""
    robot = load("panda")
    bare = ea.CompositeController.for_robot(robot, DT)
    for inner, told in ((bare, True), (KnownGravityPD(robot, bare.control), False)):
        controller = ea.Shaped(ea.GatedController.for_robot(inner, DT))
        plant, measurement, state, goal = started(controller)
        state, *_ = run(controller, plant, state, measurement, goal, 50)
        assert hasattr(state, "external") == told
        if told:
            assert state.external.any()
            assert state.external is state.inner.inner.external


def test_a_limit_on_contact_asks_for_a_controller_that_feels():
    """One that says nothing of what acts from outside would never be stopped by it."""
    robot = load("ur5")
    blind = KnownGravityPD(robot, ea.CompositeController.for_robot(robot).control)
    controller = ea.GatedController.for_robot(blind, DT, contact=3.0)
    with pytest.raises(ArgumentError, match=r"contact: expected a controller whose state .*KnownGravityPD"):
        started(controller)


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova"])
def test_the_fallback_stops_a_moving_arm_that_has_learned_nothing(name):
    """A fault 50 ms after the start, gravity unknown: the arm comes to rest within its range."""
    controller = gated(name)
    plant, measurement, state, goal = started(controller)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 50)
    assert np.abs(measurement.v).max() > 0.1
    state = state._replace(gate=controller.gate.latch(state.gate, "controller", "the test says so"))
    state, measurement, torques = run(controller, plant, state, measurement, goal, 2000)
    assert np.abs(measurement.v).max() < 1e-3
    assert np.all(np.abs(torques) <= controller.gate.effort)
    position = controller.robot.coordinates(measurement.q)
    assert np.all((controller.gate.lower < position) & (position < controller.gate.upper))


def test_guards_name_what_diverges():
    """Joint limits, speed, a swing that grows, an error that grows and a stall each have their fault."""
    robot = load("two_link")

    def fault(says, steps=3000, *, q0=(0.0, 0.0), plant_options=None, **limits):
        controller = ea.GatedController.for_robot(Dictated(robot, says), DT, **limits)
        plant = ea.PinocchioPlant(robot, np.array(q0), **(plant_options or {}))
        measurement = plant.reset()
        state = controller.init(measurement)
        for _ in range(steps // 50):
            state, measurement, _ = run(controller, plant, state, measurement, np.array(q0), 50)
            if state.fault:
                break
        return state.fault

    def push(k):
        return np.array([8.0, 0.0])

    def swing(k):
        return np.array([0.05 * np.exp(2e-3 * k) * np.sin(2e-2 * k), 0.0])

    assert fault(push, velocity=2.0, barrier=None, lower=-50, upper=50).name == "velocity"
    assert fault(push, lower=-0.3, upper=0.3, barrier=None).name == "joint limit"
    assert fault(push).name == "error growth"
    assert fault(swing).name == "energy growth"
    stuck = {"friction": ea.Friction(coulomb=1e3)}
    assert fault(lambda k: np.full(2, 1e3), 200, plant_options=stuck).name == "unresponsive"
    # so slowly that friction may be what holds it, until all torque is spent
    creeping = {"plant_options": stuck, "guard": DivergenceGuard(stall=0.1), "effort": 1.0}
    assert fault(lambda k: np.full(2, 2e-4 * k), 6000, **creeping).name == "stall"


def test_the_barrier_keeps_speed_and_range_against_a_controller_that_does_not():
    """Half of all torque to and fro: joints reach half their speed limits, none passes it or its range."""
    robot = load("panda")
    limit = 0.5 * robot.effort_limit
    controller = ea.GatedController.for_robot(
        Dictated(robot, lambda k: limit * np.sin(2 * np.pi * k / 1600)),
        guard=DivergenceGuard(error_margin=10, stall=1e3, growths=1e3),
    )
    plant, measurement, state, goal = started(controller)
    speeds, positions = [], []
    for _ in range(3200):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        speeds.append(np.abs(measurement.v))
        positions.append(robot.coordinates(measurement.q))
    assert state.fault is None
    assert np.all(np.max(speeds, axis=0) > 0.5 * robot.velocity_limit)
    assert np.all(speeds <= robot.velocity_limit)
    assert np.all((robot.lower <= positions) & (positions <= robot.upper))


def test_a_controller_without_regressors_falls_back_on_the_urdfs_gravity():
    """Any law with init and step can stand behind a gate."""
    robot = load("ur5")
    law = ea.CompositeController.for_robot(robot).control
    controller = ea.GatedController.for_robot(KnownGravityPD(robot, law))
    plant, measurement, state, goal = started(controller)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 100)
    state, _ = controller.step(state, measurement, None, DT)
    state, measurement, _ = run(controller, plant, state, measurement, goal, 1500)
    assert np.abs(measurement.v).max() < 1e-3


def test_what_does_not_fit_is_refused():
    robot = load("two_link")
    gate = ea.TorqueGate.for_robot(robot)
    with pytest.raises(UnknownNameError, match="legal names: effort"):
        ea.TorqueGate.for_robot(robot, efort=1.0)
    for name, value in (
        ("effort", np.inf), ("torque_rate", 0), ("lower", np.nan), ("max_age", 0), ("contact", -1),
    ):  # fmt: skip
        with pytest.raises(ArgumentError, match=name):
            dataclasses.replace(gate, **{name: value})
    for name in ("effort", "torque_rate", "horizon", "slack", "bridging", "closing"):
        with pytest.raises(ArgumentError, match=name):
            dataclasses.replace(gate.fallback, **{name: 0.0})
    for name in ("least", "against", "silent", "rotor", "contradiction", "still"):
        with pytest.raises(ArgumentError, match=name):
            dataclasses.replace(gate.belief, **{name: -1.0})
    for name, value in (("contact", "a lot"), ("torque_rate", [1.0]), ("lower", "low"), ("max_age", "old")):
        with pytest.raises(ArgumentError, match=f"{name}: expected .*, got {re.escape(repr(value))}"):
            ea.TorqueGate.for_robot(robot, **{name: value})
    with pytest.raises(ArgumentError, match=r"controller: .* CompositeController\.for_robot"):
        ea.GatedController.for_robot(robot)
    with pytest.raises(ArgumentError, match=r"controller: .* int lacks robot, init, step"):
        ea.GatedController.for_robot(3)
    with pytest.raises(ArgumentError, match="lower < upper"):
        dataclasses.replace(gate, lower=1.0, upper=0.0)
    with pytest.raises(ArgumentError, match="controller's joints"):
        ea.GatedController(ea.CompositeController.for_robot(load("ur5")), gate)
    controller = gated()
    _, measurement, state, goal = started(controller)
    for dt in (0, -1e-3, np.nan, "fast"):
        with pytest.raises(ArgumentError, match="dt"):
            controller.step(state, measurement, goal, dt)
    with pytest.raises(ArgumentError, match=r"measurement\.q"):
        controller.init(measurement._replace(q=measurement.q * np.nan))
