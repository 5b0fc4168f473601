"""The compiled line: the same controller as its blocks one after the other, wherever it applies."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError

DT = 1e-3
# The gates are a logistic of a logarithm in the blocks and a quotient in the line; sums differ in their
# order. Triangles have entries up to 1e3, whose last digit is 1e-13.
ROUNDING = 1e-11


def pair(robot: ea.Robot) -> tuple[ea.CompositeController, ea.CompositeController]:
    """A controller with the line, and the same without; with half the torque, so that some is clipped."""
    limit = 0.5 * np.where(np.isfinite(robot.effort_limit), robot.effort_limit, 20.0)
    line, blocks = (
        dataclasses.replace(ea.CompositeController.for_robot(robot, DT, compiled=True), effort_limit=limit)
        for _ in range(2)
    )
    blocks.__dict__["_line"] = None
    assert line._line is not None
    return line, blocks


def assert_same(one: ea.ControllerState, two: ea.ControllerState) -> None:
    """All but directions that nothing tells apart: those of equal singular values, or of none yet."""
    for name, take in {
        "y": lambda s: s.filters.y,
        "omega": lambda s: s.regression.omega,
        "triangle": lambda s: s.information.triangle,
        "prior": lambda s: s.information.prior,
        "innovation": lambda s: s.information.innovation,
        "gates": lambda s: s.mixed.delta,
        "their integral": lambda s: s.excitation.integral,
        "theta": lambda s: s.theta,
        "disturbance": lambda s: s.disturbance,
        "steps": lambda s: s.change.steps,
        "level": lambda s: s.change.level,
        "theta before": lambda s: s.change.theta_before,
    }.items():
        value, expected = np.asarray(take(one)), np.asarray(take(two))
        scale = 1 + np.abs(expected).max()
        np.testing.assert_allclose(value, expected, rtol=0, atol=ROUNDING * scale, err_msg=name)


@pytest.mark.parametrize("name", ["two_link", "panda", "kinova", "talos_left_arm"])
def test_a_step_of_the_line_is_a_step_of_the_blocks(name):
    """From the same state, along a move that runs into effort limits, meets a load and misses samples."""
    robot = load(name)
    line, blocks = pair(robot)
    load_at = ea.Payload(1.0, (0.0, 0.0, 0.05), attach=0.6)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=load_at)
    measurement, goal = plant.reset(), robot.configuration(robot.target)
    state, noticed, clipped, t = line.init(measurement), 0, 0, 0.0
    for k in range(900):
        one, tau = line.step(state, measurement, goal, DT)
        two, expected = blocks.step(state, measurement, goal, DT)
        np.testing.assert_allclose(tau, expected, rtol=0, atol=ROUNDING * (1 + np.abs(expected).max()))
        if k % 7 == 0 or one.change.noticed > noticed:
            assert_same(one, two)
        noticed, state = one.change.noticed, one
        clipped += int(np.any(np.abs(tau) >= line.effort_limit))
        measurement = plant.step(tau, DT)
        t += DT if k % 300 else 6 * DT  # some samples got lost
        measurement = measurement._replace(t=t)
    assert noticed >= 1, "the load was to be noticed"
    assert clipped >= 1, "some torque was to be clipped"


@pytest.mark.parametrize(
    "other",
    [
        lambda c: dataclasses.replace(c, detector=None),
        lambda c: dataclasses.replace(c, disturbance=None),
        lambda c: dataclasses.replace(c, mixing=ea.Determinant()),
        lambda c: dataclasses.replace(c, mixing=ea.Directional()),
        lambda c: dataclasses.replace(c, extension=ea.Kreisselmeier(compiled=True)),
        lambda c: dataclasses.replace(c, law=dataclasses.replace(c.law, bounds=np.full(4, 30.0))),
        lambda c: dataclasses.replace(c, regression=ea.ForceBalance(c.regressors, 20.0, compiled=False)),
        lambda c: dataclasses.replace(
            c, disturbance=None, control=dataclasses.replace(c.control, evaluation="explicit")
        ),
        lambda c: ea.CompositeController.for_robot(c.robot, DT, friction=True, compiled=True),
        lambda c: ea.CompositeController.for_robot(c.robot, DT),
    ],
)
def test_any_other_controller_goes_by_its_blocks(other):
    """Whatever is exchanged is used: such a controller has no line."""
    controller = ea.CompositeController.for_robot(load("two_link"), DT, compiled=True)
    assert controller._line is not None
    assert other(controller)._line is None


def test_a_subclassed_block_is_used():
    """A block of one's own that is derived from a default one is not bypassed."""

    class Twice(ea.FiniteTimePD):
        def torque(self, e1, e2, mass_matrix, dt):
            return 2 * super().torque(e1, e2, mass_matrix, dt)

    robot = load("two_link")
    base = ea.CompositeController.for_robot(robot, DT, compiled=True)
    fields = {f.name: getattr(base.control, f.name) for f in dataclasses.fields(base.control)}
    doubled = dataclasses.replace(base, control=Twice(**fields), effort_limit=np.inf)
    single = dataclasses.replace(base, effort_limit=np.inf)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement, goal = plant.reset(), robot.configuration(robot.target)
    torques = [c.step(c.init(measurement), measurement, goal, DT)[1] for c in (single, doubled)]
    np.testing.assert_allclose(torques[1], 2 * torques[0], rtol=1e-12)


def test_a_state_of_another_mixing_is_refused_as_the_blocks_refuse_it():
    """Determinant has one gate for all of theta_U, the line one a direction."""
    line, blocks = pair(load("two_link"))
    other = dataclasses.replace(blocks, mixing=ea.Determinant())
    plant = ea.PinocchioPlant(line.robot, line.robot.configuration(line.robot.home))
    measurement, goal = plant.reset(), line.robot.configuration(line.robot.target)
    state, tau = other.step(other.init(measurement), measurement, goal, DT)
    measurement = plant.step(tau, DT)
    for controller in (line, blocks):
        with pytest.raises(ValueError, match="reshape"):
            controller.step(state, measurement, goal, DT)


def test_a_torque_that_is_not_finite_is_refused():
    """As the blocks refuse it, with what to look at."""
    line, blocks = pair(load("two_link"))
    plant = ea.PinocchioPlant(line.robot, line.robot.configuration(line.robot.home))
    measurement = plant.reset()
    state = line.init(measurement)
    goal = line.robot.configuration(line.robot.target)
    broken = state._replace(theta=np.full_like(state.theta, np.nan))
    with pytest.raises(ArgumentError, match="torque of the control law"):
        line.step(broken, measurement, goal, DT)
    for number in (np.nan, np.inf, 1e308):  # the last one overflows on its way
        broken = state._replace(disturbance=np.full_like(state.disturbance, number))
        for controller in (line, blocks):
            with (
                np.errstate(over="ignore", invalid="ignore"),
                pytest.raises(ArgumentError, match="velocity that the control law starts from"),
            ):
                controller.step(broken, measurement, goal, DT)


def test_a_limit_changed_in_place_changes_no_controller():
    """Line and blocks keep the limit that the controller was made with."""
    limit = np.array([5.0, 5.0])
    controller = dataclasses.replace(
        ea.CompositeController.for_robot(load("two_link"), DT, compiled=True), effort_limit=limit
    )
    limit[:] = 1.0
    np.testing.assert_array_equal(controller.effort_limit, [5.0, 5.0])


def test_a_state_without_detector_and_disturbance_estimate_is_the_blocks_affair():
    """A controller whose detector and disturbance estimate were added later goes on from the state before."""
    line, blocks = pair(load("two_link"))
    plain = dataclasses.replace(line, detector=None, disturbance=None)
    plant = ea.PinocchioPlant(line.robot, line.robot.configuration(line.robot.home))
    measurement, goal = plant.reset(), line.robot.configuration(line.robot.target)
    state = plain.init(measurement)
    for _ in range(5):
        state, tau = plain.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
    assert state.disturbance is None
    one, two = (controller.step(state, measurement, goal, DT) for controller in (line, blocks))
    np.testing.assert_array_equal(one[1], two[1])
    np.testing.assert_array_equal(one[0].theta, two[0].theta)


def test_one_joint_is_enough_and_none_with_weight_is_none():
    """Pinocchio's bindings return vectors for one joint's matrices; an arm without gravity has no theta_U."""
    full = load("panda")
    names = full.joint_names
    shoulder, base = (
        ea.Robot.from_urdf(full.path, full.package_dirs, [*full.locked, *others], target=[0.4])
        for others in ([names[0], *names[2:]], names[1:])
    )
    assert ea.CompositeController.for_robot(base, DT, compiled=True)._line is None
    line, blocks = pair(shoulder)
    plant = ea.PinocchioPlant(shoulder, shoulder.configuration(shoulder.home))
    measurement, goal = plant.reset(), shoulder.configuration(shoulder.target)
    state = line.init(measurement)
    for _ in range(300):
        (state, tau), (two, expected) = (c.step(state, measurement, goal, DT) for c in (line, blocks))
        np.testing.assert_allclose(tau, expected, rtol=0, atol=ROUNDING * (1 + np.abs(expected).max()))
        assert_same(state, two)
        measurement = plant.step(tau, DT)
    assert pickle.loads(pickle.dumps(line))._line is not None, "simulate_many sends it to other processes"
