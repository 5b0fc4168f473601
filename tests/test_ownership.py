"""What leaves a step, and what came in, may be written to: nothing that stays is the same memory."""

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD, adaptive_pd, indirect
from eladapt.simulation.faults import FrozenSensor, Jitter, LostNumbers, Packets, WeakMotors
from eladapt.simulation.instruments import Delay, Encoders, FilteredVelocity, NoisyReadings

DT, STEPS = 1e-3, 60


def composite():
    return ea.CompositeController.for_robot(load("two_link"))


def gated():
    return ea.GatedController.for_robot(composite())


def spoil(*given):
    """Write to every array."""
    for value in given:
        for array in value if isinstance(value, tuple) else (value,):
            if isinstance(array, np.ndarray):
                array[:] = np.nan


class Careless:
    """A controller of a user's own: the torque that it returns is its memory, and it writes to its inputs."""

    def __init__(self):
        self.robot = load("two_link")

    def init(self, measurement, theta0=None):
        measurement.q[:] = np.nan
        return np.zeros(self.robot.nv)

    def step(self, state, measurement, goal, dt):
        q_d = goal.q if isinstance(goal, ea.Reference) else goal
        state += 1e-3 * (self.robot.difference(measurement.q, q_d) - measurement.v)
        spoil(measurement, goal)
        return state, state


CONTROLLERS = {
    "composite": composite,
    "adaptive PD": lambda: adaptive_pd(composite()),
    "indirect": lambda: indirect(composite()),
    "gated": gated,
    "shaped": lambda: ea.Shaped(composite()),
    "shaped, gated": lambda: ea.Shaped(gated()),
    "Slotine-Li": lambda: ea.SlotineLi.for_robot(load("two_link")),
    "terminal sliding": lambda: ea.TerminalSliding.for_robot(load("two_link")),
    "known gravity": lambda: KnownGravityPD(load("two_link"), composite().control),
    "paper C1": lambda: ea.paper.controller("C1"),
    "paper C2": lambda: ea.paper.controller("C2"),
    "paper C4": lambda: ea.paper.controller("C4"),
}


def swing(robot, t, moving):
    """A goal, in arrays of its own."""
    x, one = np.array(robot.target), np.ones(robot.nv)
    if not moving:
        return robot.configuration(x)
    return ea.Reference(robot.configuration(x + 0.1 * np.sin(5 * t)), 0.5 * np.cos(5 * t) * one, 0 * one)


def torques(controller, spoiling, moving, lost=()):
    """What is commanded in a move, and whether a gate latched; ``lost``: steps whose sample is nan."""
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    first, theta0 = plant.reset(), np.ones(len(getattr(controller, "regressors", ())) or 1)
    measurement, given = first.copy(), () if isinstance(controller, KnownGravityPD) else (theta0,)
    state, sent = controller.init(measurement, *given), []
    for k in range(STEPS):
        if spoiling:
            spoil(measurement, *given)
        measurement, goal = first.copy(), swing(robot, first.t, moving)
        if k in lost:
            measurement.q[:] = np.nan
        state, tau = controller.step(state, measurement, goal, DT)
        sent.append(tau.copy())
        first = plant.step(tau.copy(), DT)
        if spoiling:
            spoil(goal, tau)
    return np.array(sent), getattr(state, "fault", None)


@pytest.mark.parametrize("moving", [False, True], ids=["set-point", "moving goal"])
@pytest.mark.parametrize("kind", CONTROLLERS)
def test_torque_measurement_goal_and_theta0_may_be_written_to_after_a_step(kind, moving):
    """Each set to nan as soon as the step has returned: the torques are as if nobody had, bit for bit."""
    expected, _ = torques(CONTROLLERS[kind](), False, moving)
    found, _ = torques(CONTROLLERS[kind](), True, moving)
    assert np.isfinite(expected).all()
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("kind", ["gated", "shaped, gated"])
@pytest.mark.parametrize(("lost", "latches"), [(range(20, 25), False), (range(20, STEPS), True)])
def test_the_gate_s_memory_is_its_own_while_it_bridges_and_brakes(kind, lost, latches):
    """The torque that is held without a measurement, and the fallback's after a fault."""
    expected, fault = torques(CONTROLLERS[kind](), False, False, lost)
    found, _ = torques(CONTROLLERS[kind](), True, False, lost)
    assert (fault is not None) == latches
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("around", [ea.GatedController.for_robot, ea.Shaped])
def test_a_controller_inside_that_writes_to_its_inputs_spoils_nothing_around_it(around):
    """What a gate or a shaped reference remembers stays finite, and so does what leaves."""
    controller = around(Careless())
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement = plant.reset()
    state = controller.init(measurement.copy())
    for _ in range(STEPS):
        state, tau = controller.step(state, measurement.copy(), robot.configuration(robot.target), DT)
        kept = [*state.measurement[1:], *state.gate.goal] if hasattr(state, "gate") else state.reference
        assert all(np.isfinite(part).all() for part in kept)
        measurement = plant.step(tau.copy(), DT)
    assert getattr(state, "fault", None) is None


PLANTS = {
    "Pinocchio": lambda plant: plant,
    "encoders": Encoders,
    "filtered": lambda plant: FilteredVelocity(plant, 5e-3),
    "readings": lambda plant: NoisyReadings(plant, ea.Noise(1e-4, 1e-3)),
    "delay": lambda plant: Delay(plant, 3 * DT),
    "lost numbers": lambda plant: LostNumbers(plant, 0.02, 0.03),
    "frozen": lambda plant: FrozenSensor(plant, 0.02, 0.03),
    "packets": lambda plant: Packets(plant, 0.3, 0.3),
    "jitter": lambda plant: Jitter(plant, 5e-4, 2e-3),
    "weak motors": lambda plant: WeakMotors(plant, 0.1),
}


def seen(plant, spoiling):
    """All measurements under a swinging torque, while the caller writes to what comes and what goes."""
    measurement, rows = plant.reset(), []
    for k in range(STEPS):
        rows.append(np.concatenate([[measurement.t], *measurement[1:]]))
        tau = np.sin(0.3 * k + np.arange(plant.robot.nv)) * plant.robot.effort_limit / 4
        if spoiling:
            spoil(measurement)
        measurement = plant.step(tau, DT)
        if spoiling:
            spoil(tau)
    return np.array(rows)


@pytest.mark.parametrize("kind", PLANTS)
def test_what_a_plant_measures_and_is_given_may_be_written_to(kind):
    """All measurements after are as if nobody had."""

    def made():
        robot = load("ur5")
        return PLANTS[kind](ea.PinocchioPlant(robot, robot.configuration(robot.home)))

    np.testing.assert_array_equal(seen(made(), True), seen(made(), False))


def test_what_a_mujoco_plant_measures_and_is_given_may_be_written_to():
    pytest.importorskip("mujoco")
    robot = load("ur5")
    plant = ea.MujocoPlant(robot, robot.configuration(robot.home))
    np.testing.assert_array_equal(seen(plant, True), seen(plant, False))


@pytest.mark.parametrize("kind", ["PinocchioPlant", "MujocoPlant"])
def test_a_plant_begins_where_it_was_told_to(kind):
    """Also when the arrays that said so are used again."""
    if kind == "MujocoPlant":
        pytest.importorskip("mujoco")
    robot = load("two_link")
    q0, v0 = np.array(robot.target), np.full(robot.nv, 0.5)
    plant = getattr(ea, kind)(robot, q0, v0)
    before = plant.reset()
    q0[:], v0[:] = 0.0, 0.0
    np.testing.assert_array_equal(plant.reset().q, before.q)
    np.testing.assert_array_equal(plant.reset().v, before.v)


def test_a_controller_keeps_the_gains_that_it_was_made_with():
    """An array that was given to a frozen dataclass may be used again."""
    P, limit = np.array([20.0, 10.0]), np.array([5.0, 5.0])
    control = ea.FiniteTimePD(P, D=5.0)
    limits = ea.MotionLimits.for_robot(load("two_link"), velocity=limit)
    P[:], limit[:] = 0.0, 0.0
    assert control.P.tolist() == [20.0, 10.0]
    assert limits.velocity.tolist() == [5.0, 5.0]


def test_an_observer_of_a_simulation_may_write_to_what_it_sees():
    """The run is the run without it."""
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    records = [
        ea.simulate(composite(), plant, goal, 0.05, DT, progress=False, observer=observer)
        for observer in (None, lambda _t, q, q_d, _state: spoil(q, q_d))
    ]
    assert np.array_equal(records[0].tau, records[1].tau)
    assert np.array_equal(records[0].q, records[1].q)
