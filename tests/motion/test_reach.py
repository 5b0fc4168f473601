"""A tool goes where it is sent."""

import numpy as np
import pinocchio as pin
import pytest
from shared import ROBOTS, load

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.motion.reach import _longest
from eladapt.robot.reading import frame_index

SPATIAL = [name for name in ROBOTS if load(name).nv >= 6 and name != "talos"]


def tool_pose(robot: ea.Robot, q: np.ndarray) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[frame_index(robot.model, robot.tool)].copy()


def held(robot: ea.Robot, seed: int) -> np.ndarray:
    """A random posture that the efforts hold."""
    rng = np.random.default_rng(seed)
    while np.any(np.abs(robot.gravity(q := robot.random_configuration(rng))) > robot.effort_limit):
        pass
    return q


@pytest.mark.parametrize("name", SPATIAL)
@pytest.mark.parametrize("seed", range(3))
def test_a_pose_is_reached(name, seed):
    """That of a random posture; the search stops at 1e-9 m and rad, and so may entries differ."""
    robot = load(name)
    home, wanted = robot.configuration(robot.home), tool_pose(robot, held(robot, seed))
    motion = ea.reach(robot, home, wanted)
    assert tool_pose(robot, motion.end).homogeneous == pytest.approx(wanted.homogeneous, abs=2e-9)
    assert motion(0.0).q == pytest.approx(home)
    x = robot.coordinates(motion.end)
    assert np.all((robot.lower <= x) & (x <= robot.upper))
    assert np.all(np.abs(robot.gravity(motion.end)) <= robot.effort_limit)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_position_alone_is_reached_whichever_way_the_tool_points(name):
    robot = load(name)
    wanted = tool_pose(robot, held(robot, 1)).translation
    motion = ea.reach(robot, robot.configuration(robot.home), wanted)
    assert tool_pose(robot, motion.end).translation == pytest.approx(wanted, abs=2e-9)


def test_where_the_tool_is_already_is_no_way():
    robot = load("panda")
    home = robot.configuration(robot.home)
    assert ea.reach(robot, home, tool_pose(robot, home)).duration == 0


def test_matrices_and_poses_are_one():
    robot = load("panda")
    home, wanted = robot.configuration(robot.home), tool_pose(robot, held(robot, 2))
    one, two = ea.reach(robot, home, wanted), ea.reach(robot, home, wanted.homogeneous)
    assert np.array_equal(one.end, two.end)


def test_a_frame_may_be_named():
    robot = load("ur5")
    q = held(robot, 4)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    elbow = data.oMf[frame_index(robot.model, "forearm_link")].translation
    end = ea.reach(robot, robot.configuration(robot.home), elbow, frame="forearm_link").end
    pin.framesForwardKinematics(robot.model, data, end)
    assert data.oMf[frame_index(robot.model, "forearm_link")].translation == pytest.approx(elbow, abs=2e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_tool_arrives_with_a_load_that_nobody_told(seed):
    """Within 0.1 mm and 0.1 mrad, what the issue of a tool's pose asks, two seconds after the move."""
    robot = load("panda")
    home, wanted = robot.configuration(robot.home), tool_pose(robot, held(robot, seed))
    motion = ea.reach(robot, home, wanted)
    controller = ea.Shaped(ea.CompositeController.for_robot(robot, 1e-3))
    plant = ea.PinocchioPlant(robot, home, payload=2.0)
    record = ea.simulate(controller, plant, motion, motion.duration + 2, 1e-3, progress=False)
    missing = wanted.actInv(tool_pose(robot, record.q[-1]))
    assert np.linalg.norm(missing.translation) < 1e-4
    assert np.linalg.norm(pin.log3(missing.rotation)) < 1e-4


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        ([1.3, 0, 0.3], "nearest leaves the frame .* mm"),
        ([400.0, 0, 300], r"500 m from the base, panda_hand_tcp reaches 1\.\d+ m at most; is it in metres"),
        ([0.5, 0], r"expected pin.SE3, \(4, 4\) .* or \(3,\) .*; got shape \(2,\)"),
        ("up", r"expected pin.SE3, .*; got 'up'"),
        ([[1.0], [2.0, 3.0]], r"expected pin.SE3, .*; got \[\[1"),
        ([np.nan, 0, 0], "pose: expected finite"),
        (2 * np.eye(4), "pose: expected .* a rotation"),
        (np.diag([1.0, 1, -1, 1]), "pose: expected .* a rotation"),
        (np.ones((2, 8)), r"got shape \(2, 8\)"),
    ],
)
def test_what_is_no_pose_or_out_of_reach_is_told(pose, said):
    robot = load("panda")
    with pytest.raises(ArgumentError, match=said):
        ea.reach(robot, robot.configuration(robot.home), pose)


@pytest.mark.parametrize("name", ROBOTS)
def test_no_posture_takes_the_tool_further_than_it_is_said_to_reach(name):
    """So that no pose is refused that is none too far."""
    robot = load(name)
    frame = robot.model.frames[frame_index(robot.model, robot.tool)]
    furthest = max(np.linalg.norm(tool_pose(robot, held(robot, seed)).translation) for seed in range(100))
    assert 0.5 * _longest(robot, frame) < furthest < _longest(robot, frame)


def test_the_search_says_nothing_beside(caplog):
    """Pink warns on the root logger, step by step, of a joint that rounding takes beyond its limits."""
    robot = load("talos_left_arm")
    with pytest.raises(ArgumentError, match="nearest"):
        ea.reach(robot, robot.configuration(robot.home), [-0.613, -0.304, 0.146])
    assert caplog.records == []


def test_a_frame_that_is_none_is_told():
    robot = load("panda")
    with pytest.raises(UnknownNameError, match="panda_link8"):
        ea.reach(robot, robot.configuration(robot.home), [0.5, 0, 0.5], frame="hand")
