"""What a controller tells of its arm is physical while it learns, and it controls as well as before."""

import dataclasses
from concurrent.futures import Future, ProcessPoolExecutor

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.identification.physical import PhysicalBodies

DT = 2e-3


class Later:
    """An executor that answers when it is told to."""

    def __init__(self):
        self.open = []

    def submit(self, function, *arguments):
        future = Future()
        self.open.append((future, function, arguments))
        return future

    def answer(self):
        for future, function, arguments in self.open:
            future.set_result(function(*arguments))
        self.open.clear()


def noisy(name, **options):
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot, DT, position_noise=1e-4, velocity_noise=1e-3)
    start = robot.configuration(robot.home)
    plant = ea.PinocchioPlant(robot, start, noise=ea.Noise(1e-4, 1e-3))
    return robot, controller, ea.Physical(controller, **options), plant


def mass_matrix(regressors, q, theta):
    still = np.zeros(regressors.robot.nv)
    rest = regressors.torque(q, still, still) @ theta
    return np.array([regressors.torque(q, still, e) @ theta - rest for e in np.eye(len(still))])


@pytest.mark.parametrize("name", ["two_link", "ur5", "panda"])
@pytest.mark.parametrize("theta0", ["urdf", "zero"])
def test_what_it_tells_is_physical_from_the_first_sample_on(name, theta0):
    robot, controller, physical, plant = noisy(name)
    rng = np.random.default_rng(0)
    postures = [robot.random_configuration(rng) for _ in range(5)]
    least = []

    def look(t, q, goal, state):
        if round(t / DT) % 25 == 0:
            for posture in postures:
                told = mass_matrix(controller.regressors, posture, state.physical)
                least.append(np.linalg.eigvalsh(told)[0])

    goal = robot.configuration(robot.target)
    record = ea.simulate(
        ea.Shaped(physical), plant, goal, 4.0, DT, theta0=theta0, observer=look, progress=False
    )
    assert min(least) > 0
    assert record.settling_time(2e-3) < 4.0


@pytest.mark.slow
def test_gravity_in_other_postures_is_not_made_of_noise():
    """After a move in noise and a load that came: a fifth of the error that learning alone leaves."""
    wrong, robot = [], load("panda")
    start, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    motion = ea.move(robot, start, goal)
    for kept in (False, True):
        controller = ea.CompositeController.for_robot(robot, position_noise=1e-4, velocity_noise=1e-3)
        plant = ea.PinocchioPlant(
            robot, start, noise=ea.Noise(1e-4, 1e-3), payload=ea.Payload(1.0, attach=1.5)
        )
        used = ea.Physical(controller) if kept else controller
        record = ea.simulate(used, plant, motion, 4.0, progress=False)
        rng = np.random.default_rng(0)
        postures = [robot.random_configuration(rng) for _ in range(20)]
        errors = [controller.regressors.gravity(q) @ record.theta_error[-1] for q in postures]
        wrong.append(np.abs(errors).max())
    assert wrong[1] < 0.2 * wrong[0]


def test_a_run_that_goes_on_from_a_saved_state_is_the_same(tmp_path):
    robot, _, physical, plant = noisy("two_link")
    goal, state, tau = robot.configuration(robot.target), None, np.zeros(2)
    measurements, states = [plant.reset()], []
    state = physical.init(measurements[0])
    for _ in range(100):
        state, tau = physical.step(state, measurements[-1], goal, DT)
        states.append(state)
        measurements.append(plant.step(tau, DT))
    waits = next(k for k, state in enumerate(states) if state.waiting)
    path = ea.save_state(tmp_path / "state.npz", physical, states[waits])
    again = ea.load_state(path, physical)
    for k in range(waits + 1, 100):
        again, tau = physical.step(again, measurements[k], goal, DT)
    assert np.array_equal(again.parameters, states[-1].parameters)
    assert np.array_equal(again.physical, states[-1].physical)


def test_an_answer_counts_when_it_is_there():
    """Theta moves by what it was found to be off by when it was asked about, not to where it was."""
    executor = Later()
    robot, controller, physical, _ = noisy("two_link", period=0.02, lag=0.01, executor=executor)
    q = robot.configuration(robot.home)

    def sample(k):
        return ea.Measurement(k * DT, q, np.zeros(2), robot.gravity(q))

    state = physical.init(sample(0), np.full(len(controller.regressors), -1.0))  # bodies of negative mass
    for k in range(1, 30):
        before = state
        state, _ = physical.step(state, sample(k), q, DT)
    assert len(executor.open) == 1, "one question at a time"
    assert np.array_equal(state.physical, before.physical)
    question, _ = state.question, executor.answer()
    alone, _ = controller.step(state.inner, sample(30), q, DT)
    state, _ = physical.step(state, sample(30), q, DT)
    assert state.parameters == pytest.approx(alone.parameters + (state.physical - question), abs=1e-12)
    assert mass_matrix(controller.regressors, q, state.physical)[1, 1] > 0


def test_a_loop_survives_its_executor():
    """Shut down: the controller's own parameters, to the last digit, and no error in the loop."""
    executor = ProcessPoolExecutor(1)
    executor.shutdown()
    robot, controller, physical, _ = noisy("two_link", period=0.02, lag=0.01, executor=executor)
    q = robot.configuration(robot.home)
    first = ea.Measurement(0.0, q, np.zeros(2), robot.gravity(q))
    state, alone = physical.init(first), controller.init(first)
    for k in range(1, 30):
        sample = first._replace(t=k * DT)
        state, tau = physical.step(state, sample, q, DT)
        alone, right = controller.step(alone, sample, q, DT)
        assert np.array_equal(tau, right)
    assert np.array_equal(state.parameters, alone.parameters)
    assert not state.waiting


def test_another_process_finds_the_same():
    controller = noisy("ur5")[1]
    bodies = PhysicalBodies(controller.regressors)
    theta, triangle = controller.regressors.theta - 0.3, np.eye(len(controller.regressors))
    here = bodies.nearest(theta, triangle)[1]
    with ProcessPoolExecutor(1) as pool:
        there = pool.submit(bodies.nearest, theta, triangle).result()[1]
    assert np.array_equal(here, there)


def test_it_stands_inside_a_gate_and_around_nothing_else():
    robot, controller, physical, plant = noisy("ur5")
    gated = ea.GatedController.for_robot(physical, DT)
    record = ea.simulate(ea.Shaped(gated), plant, robot.configuration(robot.target), 0.5, DT, progress=False)
    assert record.faults == ()
    assert record.final_state.physical.shape == (len(controller.regressors),)
    for wrong in (gated, ea.Shaped(controller), robot):
        with pytest.raises(ArgumentError, match="expected a CompositeController"):
            ea.Physical(wrong)
    for options in ({"period": 0}, {"lag": 1.0}):
        with pytest.raises(ArgumentError, match=next(iter(options))):
            dataclasses.replace(physical, **options)
