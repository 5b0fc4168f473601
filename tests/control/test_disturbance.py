"""The semi-implicit law knows what holds the arm, and pays nothing for it where nothing does."""

import dataclasses

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.control.disturbance import DisturbanceEstimate
from eladapt.errors import ArgumentError

DT = 1e-3


def move(controller: ea.CompositeController, duration: float, dt: float = DT, **unknown) -> ea.Record:
    """Home to target with true gravity known, and what else there is unknown."""
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), **unknown)
    theta = controller.regressors.theta_potential
    goal = robot.configuration(robot.target)
    return ea.simulate(controller, plant, goal, duration, dt, theta0=theta, progress=False)


def explicit(controller: ea.CompositeController) -> ea.CompositeController:
    law = dataclasses.replace(controller.control, evaluation="explicit")
    return dataclasses.replace(controller, control=law, disturbance=None)


def test_a_constant_push_is_found_with_the_memory_as_time_constant():
    """After one memory 63 % of it, after ten all, whatever the step."""
    push = np.array([1.0, -3.0])
    for dt in (1e-3, 1e-2):
        block = DisturbanceEstimate(0.1)
        d = block.init(2)
        for k in range(1, round(1 / dt) + 1):
            d = block.step(d, 5.0 + push, np.full(2, 5.0), dt)
            if k == round(0.1 / dt):
                np.testing.assert_allclose(d, (1 - np.exp(-1)) * push, rtol=1e-12)
        np.testing.assert_allclose(d, push, rtol=1e-4)


def test_velocity_makes_the_prediction_include_the_push(rng):
    """M (w - v) = H (law + d) is the law's own equation from the velocity that the block returns."""
    robot = load("panda")
    law = ea.CompositeController.for_robot(robot).control
    for _ in range(20):
        mass = robot.mass_matrix(robot.random_configuration(rng))
        e1, v, d = rng.normal(size=(3, 7)) * np.array([[0.1], [0.1], [5.0]])
        start = DisturbanceEstimate().velocity(d, v, mass, DT)
        end = ea.control.finite_time.semi_implicit_state(law, e1, start, mass, DT)
        change, pull = mass @ (end.e2 - v), DT * (law.law(*end) + d)
        np.testing.assert_allclose(change, pull, atol=1e-9 * np.abs(DT * d).max())


def test_friction_leaves_no_more_than_the_law_itself_would():
    """Stuck by 1 N m, every joint of the ur5 stops within (f/P)^(1/a), where the law itself pushes with f;
    blind, the law believes that it arrives, and the first joint stops twenty times as far away."""
    controller = ea.CompositeController.for_robot(load("ur5"))
    law, friction = controller.control, ea.Friction(coulomb=1.0)
    bound = (1.0 / law.P) ** (1 / law.a)
    blind = dataclasses.replace(controller, disturbance=None)
    assert np.all(np.abs(move(controller, 3.0, friction=friction).error[-1]) <= bound)
    assert np.any(np.abs(move(blind, 3.0, friction=friction).error[-1]) > 10 * bound)


def test_it_costs_nothing_where_the_model_is_right():
    """Arrival to rounding, without ripple, on the paper's arm at the paper's step."""
    controller = ea.CompositeController.for_robot(load("two_link"), 5e-4)
    metrics = move(controller, 4.0, 5e-4).metrics()
    assert metrics.steady_error < 1e-12
    assert metrics.chatter < 1e-6, "the paper: 0.015 N m"


@pytest.mark.slow
@pytest.mark.parametrize(
    "unknown", [{}, {"payload": 2.0}, {"noise": ea.Noise(1e-4, 1e-3)}], ids=["nothing", "2 kg", "noise"]
)
def test_panda_against_explicit_evaluation(unknown):
    """At 1 kHz: a hundredth of the ripple at most, or with noise 0.6 of the torque's deviation, and no larger
    an error, though neither the load nor the noise is told."""
    controller = ea.CompositeController.for_robot(load("panda"))
    ours, theirs = move(controller, 3.0, **unknown), move(explicit(controller), 3.0, **unknown)
    last = ours.t > 2
    assert ours.metrics().steady_error <= theirs.metrics().steady_error
    if "noise" in unknown:
        assert ours.tau[last].std(axis=0).max() <= 0.6 * theirs.tau[last].std(axis=0).max()
    else:
        assert np.ptp(ours.tau[last], axis=0).max() <= 1e-2 * np.ptp(theirs.tau[last], axis=0).max()


def test_memory_follows_the_horizon():
    controller = ea.CompositeController.for_robot(load("panda"), delay=5e-3)
    assert controller.disturbance.memory == pytest.approx(5 * controller.control.horizon)
    assert ea.CompositeController.for_robot(load("panda")).disturbance.memory == 0.03


def test_it_is_refused_where_it_would_not_be_used():
    controller = ea.CompositeController.for_robot(load("two_link"))
    law = dataclasses.replace(controller.control, evaluation="explicit")
    with pytest.raises(ArgumentError, match=r"disturbance: .* semi-implicitly"):
        dataclasses.replace(controller, control=law)
    with pytest.raises(ArgumentError, match="memory"):
        DisturbanceEstimate(0)
    assert ea.CompositeController.for_robot(load("two_link"), friction=True).disturbance is None
