"""Motions keep to their limits, begin and end at rest, and go where they should."""

import dataclasses

import numpy as np
import pytest
from shared import ROBOTS, load

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError


def ends(name: str, seed: int = 0) -> tuple[ea.Robot, np.ndarray, np.ndarray]:
    """Two random postures that can be held."""
    robot, rng = load(name), np.random.default_rng(seed)
    found = []
    while len(found) < 2:
        q = robot.random_configuration(rng)
        if np.all(np.abs(robot.gravity(q)) < robot.effort_limit):
            found.append(q)
    return robot, *found


@pytest.mark.parametrize("name", ROBOTS)
def test_a_move_keeps_its_limits_from_rest_to_rest(name):
    """Velocity, acceleration and jerk, at every millisecond; the position is the velocity's integral."""
    robot, q0, q1 = ends(name)
    limits = ea.MotionLimits.for_robot(robot)
    motion = ea.move(robot, q0, q1, limits)
    t, course = motion.sampled(1e-3)
    for values, most in ((course.v, limits.velocity), (course.a, limits.acceleration)):
        assert np.all(np.abs(values) <= most * (1 + 1e-9))
    jerk = np.diff(course.a[: int(motion.duration / 1e-3)], axis=0) / 1e-3
    assert np.all(np.abs(jerk) <= limits.jerk * (1 + 1e-6))
    assert max(np.max(np.abs(course.v), axis=0) / limits.velocity) <= 1 + 1e-9
    assert robot.difference(motion.end, q1) == pytest.approx(0, abs=1e-9)
    for still in (motion(-1.0), motion(0.0), motion(motion.duration), motion(t[-1] + 1)):
        assert not still.v.any()
        assert not still.a.any()
    moved = np.cumsum((course.v[1:] + course.v[:-1]) / 2 * 1e-3, axis=0)
    steps = np.array([robot.difference(q0, q) for q in course.q[1:]])
    # Trapezoids of a velocity with this acceleration's slope: dt^2/12 of the change of a.
    assert np.abs(moved - steps).max() < 1e-6 * (1 + limits.acceleration.max())


def test_the_limits_are_used():
    """Some joint is at one of its limits nearly all the time: the motion is the fastest."""
    robot, q0, q1 = ends("panda")
    limits = ea.MotionLimits.for_robot(robot)
    _, course = ea.move(robot, q0, q1, limits).sampled(1e-3)
    jerk = np.diff(course.a, axis=0) / 1e-3
    used = [
        np.abs(course.v[1:]) / limits.velocity,
        np.abs(course.a[1:]) / limits.acceleration,
        np.abs(jerk) / limits.jerk,
    ]
    assert np.mean(np.max(used, axis=(0, 2)) > 0.999) > 0.95


def test_a_duration_may_be_longer_and_not_shorter():
    robot, q0, q1 = ends("ur5")
    fastest = ea.move(robot, q0, q1)
    assert ea.move(robot, q0, q1, duration=5.0).duration == pytest.approx(5.0)
    with pytest.raises(
        ArgumentError, match=rf"duration: expected at least {fastest.duration:.4g} s, which \w+"
    ):
        ea.move(robot, q0, q1, duration=0.9 * fastest.duration)


def test_continuous_joints_go_the_short_way_or_as_many_turns_as_asked():
    robot = load("kinova")
    joint = next(n for n in robot.joint_names if robot.model.nqs[robot.model.getJointId(n)] == 2)
    k = robot.joint_names.index(joint)
    x = robot.home.copy()
    x[k] = 3.0
    q0 = robot.configuration(x)
    x[k] = -3.0
    q1 = robot.configuration(x)
    for turns, way in (({}, 2 * np.pi - 6.0), ({joint: -1}, -6.0), ({joint: 2}, 6 * np.pi - 6.0)):
        _, course = ea.move(robot, q0, q1, turns=turns).sampled(1e-3)
        assert np.sum(course.v[:, k]) * 1e-3 == pytest.approx(way, abs=2e-3)
    with pytest.raises(UnknownNameError, match="continuous joint 'elbow'"):
        ea.move(robot, q0, q1, turns={"elbow": 1})


def test_an_end_that_cannot_be_is_refused_with_joint_and_figures():
    robot = load("panda")
    q0, x = robot.configuration(robot.home), robot.home.copy()
    x[3] = 1.0
    with pytest.raises(
        ArgumentError, match=r"q1: panda_joint4 at 1 is beyond its limits, -3\.\d+ to -0\.\d+"
    ):
        ea.move(robot, q0, robot.configuration(x))
    weak = load("ur5")
    model = weak.model.copy()
    model.upperEffortLimit = 0.1 * np.array(model.upperEffortLimit)
    model.lowerEffortLimit = -np.array(model.upperEffortLimit)
    weak = dataclasses.replace(weak, model=model)
    with pytest.raises(ArgumentError, match=r"q1: \w+ cannot be held there: gravity takes .* kg and m"):
        ea.move(weak, weak.configuration(weak.home), weak.configuration(np.zeros(6)))


@pytest.mark.parametrize("name", ROBOTS)
def test_limits_are_those_of_urdf_maker_and_torque(name):
    """Below the URDF's speed; all joints at full acceleration together take half of what gravity leaves at
    most, at postures that the limits were not made of."""
    robot, rng = load(name), np.random.default_rng(7)
    limits = ea.MotionLimits.for_robot(robot)
    assert np.all(limits.velocity <= 0.9 * robot.velocity_limit + 1e-12)
    assert {rule.gain for rule in limits.rules} == {"velocity", "acceleration", "jerk"}
    shares = []
    for _ in range(50):
        q = robot.random_configuration(rng)
        free = np.maximum(robot.effort_limit - np.abs(robot.gravity(q)), 0.1 * robot.effort_limit)
        shares.append(np.max(np.abs(robot.mass_matrix(q)) @ limits.acceleration / free))
    assert max(shares) < 0.6  # 0.5 at the sampled postures


def test_shares_and_limits_of_ones_own():
    robot = load("panda")
    whole = ea.MotionLimits.for_robot(robot, velocity=1.0)
    np.testing.assert_allclose(ea.MotionLimits.for_robot(robot, velocity=0.5).velocity, whole.velocity / 2)
    own = ea.MotionLimits.for_robot(robot, jerk=np.full(7, 10.0))
    assert np.all(own.jerk == 10.0)
    assert "given by the caller" in str(own)
    for given, said in (
        ({"velocity": 0.0}, "velocity"),
        ({"jerk": 2.0}, "jerk"),
        ({"acceleration": [1.0]}, "7"),
    ):
        with pytest.raises(ArgumentError, match=said):
            ea.MotionLimits.for_robot(robot, **given)


@pytest.mark.parametrize("name", ["panda", "ur3", "ur5", "ur10", "xarm7"])
def test_makers_limits_hold(name):
    """Of the library's arms whose makers publish any: no motion is planned beyond them, and some joint is
    slower for it than the URDF alone would have it."""
    robot = load(name)
    limits = ea.MotionLimits.for_robot(robot, velocity=1.0)
    unpublished = ea.MotionLimits.for_robot(dataclasses.replace(robot, published={}), velocity=1.0)
    slower = False
    for kind in set(robot.published) - {"torque_rate"}:
        assert np.all(getattr(limits, kind) <= robot.published[kind])
        slower |= bool(np.any(getattr(limits, kind) < getattr(unpublished, kind)))
    assert slower


def test_half_of_the_panda_makers_torque_rate_is_the_motions():
    robot = load("panda")
    limits = ea.MotionLimits.for_robot(robot, velocity=1.0)
    q = robot.configuration(robot.home)
    assert np.all(np.abs(robot.mass_matrix(q)) @ limits.jerk <= 0.55 * robot.published["torque_rate"])
    assert np.all(ea.TorqueGate.for_robot(robot).torque_rate <= 1000)
    with pytest.raises(UnknownNameError, match="published limit 'snap'"):
        ea.Robot.from_urdf(load("ur5").path, published={"snap": [1.0] * 6})


@pytest.mark.parametrize("name", ["two_link", "panda", "kinova"])
def test_waypoints_are_passed_without_stopping_within_the_limits(name):
    """Each of five points is met, no joint rests in between, and no limit is passed, jerk included."""
    robot, rng = load(name), np.random.default_rng(1)
    limits = ea.MotionLimits.for_robot(robot)
    middle = robot.home
    points = [robot.configuration(middle + rng.uniform(-0.3, 0.3, robot.nv)) for _ in range(5)]
    motion = ea.waypoints(robot, points, limits)
    _, course = motion.sampled(1e-3)
    assert np.all(np.abs(course.v) <= limits.velocity * (1 + 1e-6))
    assert np.all(np.abs(course.a) <= limits.acceleration * (1 + 1e-6))
    # Between knots the jerk is continuous but for the profile's own: a difference of 1 ms sees both at once.
    assert np.all(np.abs(np.diff(course.a, axis=0)) / 1e-3 <= limits.jerk * 1.01)
    for k, point in enumerate(points):
        far = [np.abs(robot.difference(point, q)).max() for q in course.q]
        assert min(far) < 5e-3
        if 0 < k < 4:
            assert np.abs(course.v[int(np.argmin(far))]).max() > 0.02
    assert np.abs(robot.difference(motion.end, points[-1])).max() < 1e-9


def test_waypoints_that_make_no_path_are_refused():
    robot = load("panda")
    home, target = robot.configuration(robot.home), robot.configuration(robot.target)
    with pytest.raises(ArgumentError, match=r"points\[1\] and points\[2\] coincide"):
        ea.waypoints(robot, [home, target, target])
    with pytest.raises(ArgumentError, match="at least 2"):
        ea.waypoints(robot, [home])


@pytest.mark.parametrize(("name", "rounds"), [("two_link", 40), ("ur5", 12)])
def test_an_excitation_tells_more_than_random_ones_within_the_limits(name, rounds):
    """From rest to rest; its condition number is less than half of the best of ten."""
    robot = load(name)
    limits = ea.MotionLimits.for_robot(robot)
    found = ea.excitation(robot, 8.0, limits, rounds=rounds, progress=False)
    assert len(found.random) == 10
    assert found.condition < 0.5 * min(found.random)
    assert f"{found.condition:.3g}" in repr(found)
    _, course = found.sampled(1e-3)
    assert np.all(np.abs(course.v) <= limits.velocity)
    assert np.all(np.abs(course.a) <= limits.acceleration)
    x = np.array([robot.coordinates(q) for q in course.q])
    assert np.all((robot.lower <= x) & (x <= robot.upper))
    torque = [robot.inverse_dynamics(*r) for r in zip(*(part[::50] for part in course), strict=True)]
    assert np.all(np.abs(torque) <= robot.effort_limit)
    for still in (found(0.0), found(found.duration)):
        assert np.abs(robot.difference(still.q, found.q0)).max() < 1e-12
        assert not still.v.any()
    again = ea.excitation(robot, 8.0, limits, rounds=0, progress=False)
    assert again.condition == min(again.random), "the same seed, and no search"
