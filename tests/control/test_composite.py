"""The composite controller regulates arms that it knows no gravity of, and is a pure function."""

import dataclasses

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.gains.extremes import extremes


def move(name: str, duration: float = 4.0, theta0="zero") -> ea.Record:
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    return ea.simulate(controller, plant, goal, duration, theta0=theta0, progress=False)


def off(record: ea.Record, robot: ea.Robot) -> float:
    """Largest error of the gravity torque at the end, of the largest gravity torque."""
    reg = ea.Regressors(robot, joint_terms=("rotor", "viscous", "coulomb", "offset"))
    psi = reg.gravity(record.q[-1])
    return float(np.abs(psi @ record.theta_error[-1]).max() / extremes(robot).gravity.max())


@pytest.mark.parametrize("name", ["two_link", "panda", "ur5", "kinova", "asr_twodof"])
def test_regulates_without_knowledge_of_gravity(name):
    """From theta = 0, gains from the URDF: below 1e-3 rad within 4 s, within 1e-6 rad later, without
    ripple."""
    record = move(name)
    metrics = record.metrics()
    assert metrics.settling_time < 4
    assert metrics.steady_error < 1e-6
    assert metrics.chatter < 1e-6
    assert np.all(np.abs(record.tau) <= record.effort_limit)


def test_learns_gravity_where_it_moved():
    """Panda, from theta = 0: gravity within 1 % of its largest torque after one move."""
    assert off(move("panda"), load("panda")) < 0.01


@pytest.mark.parametrize("name", ["two_link", "panda", "kinova"])
def test_follows_a_moving_reference(name):
    """Sines in all joints, from theta = 0: within 1e-5 rad after three seconds; a goal without its velocity
    is followed hundredths of a radian late."""
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot)
    home, w = robot.home, 2 * np.pi * 0.3

    def sines(t: float) -> ea.Reference:
        swing = 0.25 * np.array([1 - np.cos(w * t), w * np.sin(w * t), w * w * np.cos(w * t)])
        ones = np.ones(robot.nv)
        return ea.Reference(robot.configuration(home + swing[0]), swing[1] * ones, swing[2] * ones)

    plant = ea.PinocchioPlant(robot, robot.configuration(home))
    record = ea.simulate(controller, plant, sines, 4.0, theta0="zero", progress=False)
    assert np.abs(record.error[record.t > 3]).max() < 1e-5
    late = ea.simulate(controller, plant, lambda t: sines(t).q, 4.0, theta0="zero", progress=False)
    assert np.abs(late.error[late.t > 3]).max() > 1e-2


def test_a_goal_at_rest_is_the_set_point_law_to_the_letter(rng):
    """tau = law(e1, v) + Psi theta_U (278) with the paper's parameters, and theta' of (318)'s direct term; a
    reference at rest and its q_d are one goal."""
    robot = load("panda")
    derived = ea.CompositeController.for_robot(robot, joint_terms=())
    controller = dataclasses.replace(derived, disturbance=None, joints=None, effort_limit=np.inf)
    q, goal = robot.random_configuration(rng), robot.random_configuration(rng)
    v, theta = rng.normal(size=7), rng.normal(size=len(controller.regressors))
    measurement = ea.Measurement(0.0, q, v, np.zeros(7))
    state = controller.init(measurement, theta)
    _, tau = controller.step(state, measurement, goal, 1e-3)
    _, same = controller.step(state, measurement, ea.Reference(goal, np.zeros(7), np.zeros(7)), 1e-3)
    np.testing.assert_array_equal(tau, same)
    e1, psi = robot.difference(goal, q), controller.regressors.gravity(q)
    expected = controller.control.torque(e1, v, robot.mass_matrix(q), 1e-3) + psi @ state.theta
    np.testing.assert_allclose(tau, expected, rtol=1e-12)  # rounding of a sum of 12 products
    law = dataclasses.replace(controller.law, indirect=False)
    direct = dataclasses.replace(controller, law=law)
    after, _ = direct.step(direct.init(measurement, theta), measurement._replace(t=1e-3), goal, 1e-3)
    drive = law.gamma1 * law.d1 * np.tanh(e1) + (law.gamma1 + law.gamma2) * v
    moved = theta[-len(state.theta) :] - 1e-3 * law.Gamma * psi.T @ drive
    np.testing.assert_allclose(after.theta, moved, rtol=1e-12)


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (ea.Reference(np.zeros(3), np.zeros(2), np.zeros(2)), r"goal.q: expected shape \(2,\)"),
        (ea.Reference(np.zeros(2), np.zeros(1), np.zeros(2)), r"goal.v: expected shape \(2,\)"),
        (ea.Reference(np.zeros(2), np.zeros(2), np.array([0, np.inf])), "goal.a: expected finite"),
    ],
)
def test_a_reference_that_is_none_is_named(loop, goal, said):
    _, controller, plant = loop
    measurement = plant.reset()
    with pytest.raises(ArgumentError, match=said):
        controller.step(controller.init(measurement), measurement, goal, 1e-3)


def test_a_reference_off_the_unit_circle_is_named():
    robot = load("kinova")
    controller = ea.CompositeController.for_robot(robot)
    measurement = ea.PinocchioPlant(robot, robot.configuration(robot.home)).reset()
    goal = ea.Reference(2 * robot.configuration(robot.home), np.zeros(robot.nv), np.zeros(robot.nv))
    with pytest.raises(ArgumentError, match=r"goal.q: continuous joint .* expects \(cos, sin\)"):
        controller.step(controller.init(measurement), measurement, goal, 1e-3)


def test_where_theta_starts_is_asked_by_name_or_number(loop):
    """By name, the whole theta, or theta_U with the URDF's for the rest; all else is refused."""
    _, controller, plant = loop
    measurement, reg = plant.reset(), controller.regressors
    np.testing.assert_array_equal(controller.init(measurement).parameters, reg.theta)
    np.testing.assert_array_equal(controller.init(measurement, "zero").parameters, 0)
    whole = np.arange(len(reg), dtype=float)
    np.testing.assert_array_equal(controller.init(measurement, whole).parameters, whole)
    gravity = controller.init(measurement, np.full(reg.n_potential, 7.0))
    np.testing.assert_array_equal(gravity.theta, 7)
    np.testing.assert_array_equal(gravity.parameters[: -reg.n_potential], reg.theta[: -reg.n_potential])
    with pytest.raises(UnknownNameError, match="legal names: urdf, zero"):
        controller.init(measurement, "cad")
    with pytest.raises(ArgumentError, match=rf"theta_U \({reg.n_potential},\), got shape \(1,\)"):
        controller.init(measurement, [1.0])


@pytest.fixture(scope="module")
def loop():
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    return robot, controller, plant


def test_step_is_pure(loop):
    """The same state and measurement give the same result, and leave the state as it was."""
    robot, controller, plant = loop
    measurement = plant.reset()
    state, goal = controller.init(measurement), robot.configuration(robot.target)
    for _ in range(20):
        state, tau = controller.step(state, measurement, goal, 1e-3)
        measurement = plant.step(tau, 1e-3)
    before = [np.array(a, copy=True) for a in (state.theta, state.filters.omega, state.information.triangle)]
    first, one = controller.step(state, measurement, goal, 1e-3)
    second, other = controller.step(state, measurement, goal, 1e-3)
    assert np.array_equal(one, other)
    assert np.array_equal(first.theta, second.theta)
    after = (state.theta, state.filters.omega, state.information.triangle)
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


def test_a_repeated_sample_advances_nothing(loop):
    """The first step after init, and a packet that comes twice, are the same sample."""
    robot, controller, plant = loop
    measurement = plant.reset()
    state, goal = controller.init(measurement), robot.configuration(robot.target)
    again, _ = controller.step(state, measurement, goal, 1e-3)
    assert again is state


def test_applied_torque_counts_not_the_commanded_one():
    """An arm whose torque is clipped far below the command still learns its gravity."""
    robot = load("two_link")
    limit = np.array([5.2, 0.85])
    derived = ea.CompositeController.for_robot(robot)
    controller = ea.CompositeController(
        derived.regressors, derived.regression, derived.extension, derived.mixing, derived.law,
        derived.control, effort_limit=limit,
    )  # fmt: skip
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    record = ea.simulate(controller, plant, goal, 4.0, theta0="zero", progress=False)
    clipped = np.mean(np.any(np.abs(record.tau) == limit, axis=1))
    assert clipped > 0.002, "the limit never mattered"
    assert off(record, robot) < 0.01
    assert record.settling_time() < 4


@pytest.mark.parametrize(
    ("field", "bad", "said"),
    [
        ("q", np.zeros(3), r"measurement.q: expected shape \(2,\)"),
        ("v", np.array([0.0, np.nan]), "measurement.v: expected finite"),
        ("tau", np.array([np.inf, 0.0]), "measurement.tau: expected finite"),
        ("t", np.nan, "measurement.t"),
        ("t", -1.0, "measurement.t: expected 0.0 s or later"),
    ],
)
def test_bad_measurements_are_named(loop, field, bad, said):
    robot, controller, plant = loop
    measurement = plant.reset()
    state = controller.init(measurement)
    with pytest.raises(ArgumentError, match=said):
        controller.step(state, measurement._replace(**{field: bad}), robot.configuration([0, 0]), 1e-3)


@pytest.mark.parametrize(
    ("goal", "dt", "said"), [([1.0], 1e-3, "goal"), ([np.nan, 0], 1e-3, "goal"), ([0, 0], 0, "dt")]
)
def test_bad_goals_and_steps_are_named(loop, goal, dt, said):
    _, controller, plant = loop
    measurement = plant.reset()
    with pytest.raises(ArgumentError, match=said):
        controller.step(controller.init(measurement), measurement, np.array(goal), dt)


def test_parts_that_do_not_fit_are_refused(loop):
    _, derived, _ = loop
    parts = [derived.regressors, derived.regression, derived.extension, derived.mixing, derived.law]
    with pytest.raises(ArgumentError, match="c = b"):
        ea.CompositeController(*parts, ea.FiniteTimePD(3, 2, r1=1.2))
    with pytest.raises(ArgumentError, match=r"P: expected a scalar or shape \(2,\)"):
        ea.CompositeController(*parts, ea.FiniteTimePD([3, 2, 1], 2))
    law = ea.CompositeLaw(Gamma=[1, 2])
    with pytest.raises(ArgumentError, match="one common value"):
        ea.CompositeController(*parts[:4], law, derived.control)
    for limit in (0.0, [1.0], "a lot"):
        with pytest.raises(ArgumentError, match="effort_limit: expected positive numbers, one for all"):
            dataclasses.replace(derived, effort_limit=limit)
    with pytest.raises(ArgumentError, match="theta0"):
        derived.init(loop[2].reset(), theta0=[1.0])
