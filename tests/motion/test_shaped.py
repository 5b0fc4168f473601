"""Whatever a goal does, the reference that a controller is given keeps to the limits."""

import itertools
import warnings

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError, GoalWarning
from eladapt.motion.shaped import INSIDE


def made(name: str) -> tuple[ea.Robot, ea.Shaped]:
    robot = load(name)
    return robot, ea.Shaped(ea.CompositeController.for_robot(robot, DT))


def references(shaped: ea.Shaped, course, steps: int) -> tuple[np.ndarray, ...]:
    """q, v and a of the reference under a course of goals, from rest at home."""
    robot = shaped.robot
    reference = robot.check_goal(robot.configuration(robot.home))
    kept = [reference]
    for k in range(steps):
        reference = shaped.follow(reference, robot.check_goal(course(k * DT)), DT)
        kept.append(reference)
    return tuple(np.array(part) for part in zip(*kept, strict=True))


def keeps(shaped: ea.Shaped, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> bool:
    """Whether velocity, acceleration and jerk are within the limits, and the position their integral."""
    limits, robot = shaped.limits, shaped.robot
    within = np.all(np.abs(v) <= limits.velocity * (1 + 1e-9))
    within &= np.all(np.abs(a) <= limits.acceleration * (1 + 1e-9))
    within &= np.all(np.abs(np.diff(a, axis=0)) / DT <= limits.jerk * (1 + 1e-6))
    steps = np.array([robot.difference(one, two) for one, two in itertools.pairwise(q)])
    # Where the jerk changes within a step, its motion is not one cubic: off by up to dt^3 of the jerk.
    missed = steps - DT * (v[:-1] + v[1:]) / 2 + DT**2 / 12 * (a[1:] - a[:-1])
    return bool(within and np.all(np.abs(missed) <= limits.jerk * DT**3 + 1e-12))


@pytest.mark.parametrize("name", ["two_link", "panda", "ur5", "kinova"])
def test_a_goal_that_jumps_every_10_ms_for_a_second(name):
    """No limit is passed, and once the goal stays, the reference arrives there and rests."""
    robot, shaped = made(name)
    rng = np.random.default_rng(0)
    goals = [robot.random_configuration(rng) for _ in range(101)]
    q, v, a = references(shaped, lambda t: goals[min(int(t / 0.01), 100)], 12000)
    assert keeps(shaped, q, v, a)
    assert np.abs(robot.difference(q[-1], goals[-1])).max() < 1e-12
    assert not v[-1].any()
    assert not a[-1].any()


def test_a_reversal_in_mid_motion():
    robot, shaped = made("panda")
    home, target = robot.configuration(robot.home), robot.configuration(robot.target)
    q, v, a = references(shaped, lambda t: target if t < 0.8 else home, 6000)
    assert keeps(shaped, q, v, a)
    assert np.abs(v[799]).max() > 0.3, "it was in motion"
    assert np.abs(robot.difference(q[-1], home)).max() < 1e-12


def test_a_goal_beyond_the_joint_limits_is_taken_just_inside():
    robot, shaped = made("panda")
    x = robot.home.copy()
    x[3] += 5.0
    q, v, a = references(shaped, lambda t: robot.configuration(x), 6000)
    assert keeps(shaped, q, v, a)
    assert robot.coordinates(q[-1])[3] == pytest.approx(robot.upper[3] - INSIDE, abs=1e-9)
    assert np.all(np.array([robot.coordinates(one) for one in q]) <= robot.upper + 1e-9)


def warned(shaped: ea.Shaped, goals) -> list[str]:
    """What is said of goals, one a step, of an arm that stays at home."""
    robot, still = shaped.robot, np.zeros(shaped.robot.nv)
    q = robot.configuration(robot.home)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        state = shaped.init(ea.Measurement(0.0, q, still, still))
        for k, goal in enumerate(goals):
            state, _ = shaped.step(state, ea.Measurement(k * DT, q, still, still), goal, DT)
    return [str(one.message) for one in caught if issubclass(one.category, GoalWarning)]


def test_all_joints_beyond_their_range_are_named_once_and_degrees_are_asked_for():
    """A goal in degrees names every joint that is beyond, with value and range; one that wanders on outside
    is said once, and again when it has been inside in between."""
    robot, shaped = made("ur5")
    inside, x = robot.configuration(robot.home), np.rad2deg(robot.home + 0.3)
    beyond = np.flatnonzero((x < robot.lower) | (x > robot.upper))
    assert len(beyond) > 1
    (said,) = warned(shaped, [inside, *(robot.configuration(x + 0.01 * k) for k in range(5))])
    for k, name in enumerate(robot.joint_names):
        assert (f"{name} at {x[k]:.4g} ({robot.lower[k]:.4g} to" in said) == (k in beyond)
    assert "are these degrees?" in said
    assert len(warned(shaped, [inside, robot.configuration(x), inside, robot.configuration(x)])) == 2


@pytest.mark.parametrize(("off", "asked"), [(0.1, False), (7.0, True), (1e4, False)])
def test_degrees_are_asked_for_only_where_they_explain_the_goal(off, asked):
    """A bit too far is a bit too far; more than a turn too far may be degrees; 10,000 is no angle at all."""
    robot, shaped = made("panda")
    x = robot.home.copy()
    x[0] = robot.upper[0] + off
    (said,) = warned(shaped, [robot.configuration(robot.home), robot.configuration(x)])
    assert f"{robot.joint_names[0]} at {x[0]:.4g} is beyond its limits" in said
    assert ("degrees" in said) == asked


def test_a_goal_that_moves_within_the_limits_is_followed_to_the_letter():
    """Slow sines: caught up with within the limits, and from then on not a bit off."""
    robot, shaped = made("ur5")
    w = 0.5

    def sines(t: float) -> ea.Reference:
        x = robot.home + 0.2 + 0.2 * np.sin(w * t)
        one = 0.2 * np.ones(robot.nv)
        return ea.Reference(robot.configuration(x), one * w * np.cos(w * t), -one * w * w * np.sin(w * t))

    steps = 4000
    q, v, a = references(shaped, sines, steps)
    assert keeps(shaped, q, v, a)
    last = sines((steps - 1) * DT)
    np.testing.assert_allclose(q[-1], last.q, atol=1e-14)
    np.testing.assert_array_equal(v[-1], last.v)
    np.testing.assert_array_equal(a[-1], last.a)


def test_a_goal_that_runs_away_is_chased_within_the_limits():
    """Sines of three times the speed and more than the acceleration that the limits allow."""
    robot, shaped = made("panda")
    limits = shaped.limits
    w = 2.0

    def sines(t: float) -> ea.Reference:
        size = 3 * limits.velocity / w
        q = robot.configuration(robot.home + size * np.sin(w * t))
        return ea.Reference(q, size * w * np.cos(w * t), -size * w * w * np.sin(w * t))

    assert keeps(shaped, *references(shaped, sines, 5000))


@pytest.mark.parametrize("name", ["two_link", "panda", "ur5"])
def test_a_move_behind_the_gate_from_the_urdf(name):
    """As planned: at most its speed limits and 10 effort limits a second once the arm is held, no fault, and
    there in time."""
    robot = load(name)
    controller = ea.Shaped(ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT))
    start, goal = robot.configuration(robot.home), robot.configuration(robot.target)
    planned = ea.move(robot, start, goal).duration
    record = ea.simulate(
        controller, ea.PinocchioPlant(robot, start), goal, 1.2 * planned + 0.5, DT, progress=False
    )
    assert record.final_state.fault is None
    assert np.all(np.abs(record.v) <= robot.velocity_limit)
    assert record.settling_time(1e-3) < planned + 0.1
    rate = np.abs(np.diff(record.tau[record.t > 0.1], axis=0)) / DT
    assert np.all(rate < 10 * robot.effort_limit)


def test_a_run_goes_on_from_its_state_bit_for_bit():
    """The planner remembers nothing: the same state gives the same reference and torque again."""
    robot, shaped = made("panda")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement, goal = plant.reset(), robot.configuration(robot.target)
    state = shaped.init(measurement)
    for k in range(300):
        before, seen = state, measurement
        state, tau = shaped.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        if k % 50 == 7:
            again, torque = shaped.step(before, seen, goal, DT)
            np.testing.assert_array_equal(torque, tau)
            np.testing.assert_array_equal(again.reference.q, state.reference.q)


def test_a_fault_holds_the_reference_where_the_arm_is():
    """After a reset the arm starts from where it stands, not from where it should have been."""
    robot = load("two_link")
    shaped = ea.Shaped(ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT))
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement, goal = plant.reset(), robot.configuration(robot.target)
    state = shaped.init(measurement)
    for k in range(600):
        state, tau = shaped.step(state, measurement, goal * (np.nan if k == 200 else 1.0), DT)
        measurement = plant.step(tau, DT)
    assert state.fault.name == "goal"
    assert np.abs(robot.difference(state.reference.q, measurement.q)).max() < 1e-3


def test_what_cannot_be_shaped_and_limits_of_another_robot_are_refused():
    with pytest.raises(ArgumentError, match=r"limits: expected MotionLimits.*, got 3"):
        ea.Shaped(ea.CompositeController.for_robot(load("ur5"), DT), limits=3)
    with pytest.raises(ArgumentError, match=r"controller: .* CompositeController\.for_robot"):
        ea.Shaped(load("ur5"))
    shaped = ea.Shaped(ea.CompositeController.for_robot(load("two_link"), DT))
    for around in (shaped, ea.GatedController.for_robot(shaped, DT)):
        with pytest.raises(ArgumentError, match="expected one without Shaped in it"):
            ea.Shaped(around)
    with pytest.raises(ArgumentError, match="limits: expected those of the joints"):
        ea.Shaped(ea.CompositeController.for_robot(load("ur5")), ea.MotionLimits.for_robot(load("panda")))


@pytest.mark.parametrize("name", ["two_link", "panda"])
@pytest.mark.parametrize("course", ["jumps", "reverses", "beyond"])
def test_the_gate_has_nothing_to_say(name, course):
    """A goal that jumps every 10 ms for a second and stays, one that reverses, one beyond the joint limits:
    no fault, no joint above its speed limit, and the arm arrives."""
    robot = load(name)
    controller = ea.Shaped(ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT))
    home, target, rng = (
        robot.configuration(robot.home),
        robot.configuration(robot.target),
        np.random.default_rng(0),
    )
    x = robot.home.copy()
    x[1] = robot.upper[1] + 1.0
    near = [robot.configuration(robot.home + rng.uniform(-0.3, 0.3, robot.nv)) for _ in range(101)]
    goals = {
        "jumps": lambda t: near[min(int(t / 0.01), 100)],
        "reverses": lambda t: target if t < 0.6 else home,
        "beyond": lambda t: robot.configuration(x),
    }
    end = {
        "jumps": near[-1],
        "reverses": home,
        "beyond": robot.configuration(np.minimum(x, robot.upper - INSIDE)),
    }[course]
    way = ea.move(robot, home, target if course == "reverses" else end)
    duration = 2 * way.duration + 2.5
    plant = ea.PinocchioPlant(robot, home)
    record = ea.simulate(controller, plant, goals[course], duration, DT, progress=False)
    assert record.final_state.fault is None
    assert np.all(np.abs(record.v) <= robot.velocity_limit)
    assert np.abs(robot.difference(record.q[-1], end)).max() < 1e-3


def test_a_fast_motion_of_a_light_arm_from_nothing():
    """An SO-ARM101 at 9 rad/s and 90 rad/s^2 from theta = 0: with Gamma as at a set-point the direct term
    swings its wrist, whose link is a hundred-thousandth of a kg m^2, beyond all bounds."""
    robot = load("so_arm101")
    rng = np.random.default_rng(1)
    start, goal = (robot.configuration(robot.home + rng.uniform(-0.5, 0.5, robot.nv)) for _ in range(2))
    shaped = ea.Shaped(ea.GatedController.for_robot(ea.CompositeController.for_robot(robot, DT), DT))
    plant = ea.PinocchioPlant(robot, start)
    record = ea.simulate(shaped, plant, goal, 1.5, DT, theta0="zero", progress=False)
    assert record.final_state.fault is None
    assert np.all(np.abs(record.v) <= robot.velocity_limit)
    assert record.settling_time(1e-3) < 0.8


def test_a_sample_that_was_seen_before_moves_nothing():
    """The interface hands the last one over where there is no newer: the reference stays, in motion too."""
    robot, shaped = made("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    measurement, goal = plant.reset(), robot.configuration(robot.home + 5e-4)
    state = shaped.init(measurement)
    for _ in range(5):
        state, tau = shaped.step(state, measurement, robot.configuration(robot.target), DT)
        measurement = plant.step(tau, DT)
    again, _ = shaped.step(state, measurement._replace(t=state.t), goal, DT)
    assert again.reference is state.reference
    assert state.measurement.t == state.t


@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_samples_that_are_late_early_or_lost_do_not_let_the_reference_lag(lost):
    """The reference of every sample is the motion's at its time stamp, from the first on: to rounding."""
    robot, shaped = made("panda")
    motion = ea.move(robot, robot.configuration(robot.home), robot.configuration(robot.target))
    rng, still = np.random.default_rng(0), np.zeros(robot.nv)
    state = shaped.init(ea.Measurement(0.0, motion.q0, still, still))
    t = 0.0
    while t < motion.duration:
        goal = motion(t)
        state, _ = shaped.step(state, ea.Measurement(t, goal.q, goal.v, still), goal, DT)
        assert np.abs(robot.difference(goal.q, state.reference.q)).max() < 1e-12
        t += DT * (rng.uniform(0.9, 1.1) + (rng.random() < lost))


def test_a_goal_that_no_motion_leads_to_brakes_the_reference():
    """One that claims 1e300 rad/s: the reference keeps its limits, and comes to rest where the goal is."""
    robot, shaped = made("kinova")
    reference = robot.check_goal(robot.configuration(robot.home))
    for k in range(3000):
        goal = robot.check_goal(robot.configuration(robot.target))
        far = ea.Reference(goal.q, np.full(robot.nv, 1e300), goal.a)
        reference = shaped.follow(reference, far if k > 300 else goal, DT)
        assert np.all(np.abs(reference.v) <= shaped.limits.velocity * (1 + 1e-9))
    assert np.abs(robot.difference(reference.q, goal.q)).max() < 1e-9
    with pytest.raises(ArgumentError, match="dt: expected a finite number"):
        shaped.step(shaped.init(ea.PinocchioPlant(robot, goal.q).reset()), None, goal.q, 0.0)
