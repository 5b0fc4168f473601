"""Joints that are locked are judged as what they are then: held."""

from __future__ import annotations

import numpy as np
import pytest
from small_arm import ARM, written

import eladapt as ea
from eladapt.errors import UnknownNameError, UrdfError
from eladapt.robot.model import Robot
from eladapt.viewing.scene import tip_of

SHOULDER_LIMIT = '<limit lower="-3" upper="3" effort="40" velocity="2"/>'
LOOSE_BASE = (
    '<link name="base"/>',
    '<link name="world"/><link name="base"/>'
    '<joint name="w" type="{}"><origin xyz="0 0 0.4" rpy="0.5 0 0"/>'
    '<parent link="world"/><child link="base"/></joint>',
)


def with_base(kind: str) -> tuple[str, str]:
    """A joint of this kind between the world and the arm, which holds it at an angle."""
    return LOOSE_BASE[0], LOOSE_BASE[1].format(kind)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_loose_base_that_is_locked_is_a_fixed_one(tmp_path, kind, rng):
    """Same dynamics, view and source as with a fixed joint in its place; refused where it is not locked."""
    fixed = Robot.from_urdf(written(tmp_path, with_base("fixed")))
    path = written(tmp_path, with_base(kind))
    with pytest.raises(UrdfError, match=r'joint "w": type=.*locked='):
        Robot.from_urdf(path)
    robot = Robot.from_urdf(path, locked=["w"])
    assert robot.locked == ("w",)
    assert robot.model == fixed.model
    assert Robot.from_source(robot.source).model == fixed.model


NO_LIMITS = {
    "no effort": (SHOULDER_LIMIT, '<limit lower="0.5" upper="3" velocity="2"/>'),
    "no effort and no velocity": (SHOULDER_LIMIT, '<limit lower="0.5" upper="3"/>'),
    "an effort that is none": (SHOULDER_LIMIT, '<limit lower="0.5" upper="3" effort="-" velocity="nan"/>'),
}


@pytest.mark.parametrize(("old", "new"), NO_LIMITS.values(), ids=NO_LIMITS)
def test_a_locked_joint_needs_no_effort(tmp_path, old, new):
    """It stands where its range says, as with an effort; moving, it is refused."""
    sound = written(tmp_path, (old, '<limit lower="0.5" upper="3" effort="40" velocity="2"/>'))
    expected = Robot.from_urdf(sound, locked="shoulder").model
    path = written(tmp_path, (old, new))
    with pytest.raises(UrdfError, match=r'joint "shoulder" <limit>'):
        Robot.from_urdf(path)
    assert Robot.from_urdf(path, locked="should*").model == expected


def test_a_locked_joint_needs_no_limit_at_all(tmp_path):
    """Without a range it stands at zero."""
    expected = Robot.from_urdf(written(tmp_path), locked="shoulder").model
    path = written(tmp_path, (SHOULDER_LIMIT, ""))
    with pytest.raises(UrdfError, match="or lock the joint"):
        Robot.from_urdf(path)
    assert Robot.from_urdf(path, locked="shoulder").model == expected


def test_the_range_of_a_locked_joint_is_still_judged(tmp_path):
    """It says where the joint is held."""
    path = written(tmp_path, ('lower="-3" upper="3"', 'lower="3" upper="-3"'))
    with pytest.raises(UrdfError, match="lower exceeds upper"):
        Robot.from_urdf(path, locked=["shoulder"])


def test_a_joint_and_a_link_of_one_name_are_told_apart(tmp_path):
    """A fixed joint and a link are both "tool", a moving joint and a link both "upper": as tool, as frame of
    a load, and as what is locked each is the one that is meant."""
    text = ARM.replace('joint name="mount"', 'joint name="tool"').replace(
        'joint name="elbow"', 'joint name="upper"'
    )
    path = tmp_path / "arm.urdf"
    path.write_text(text.replace('<axis xyz="0 0 0"/>', '<origin xyz="0 0 0.3"/>'))
    plain = Robot.from_urdf(written(tmp_path, ('<axis xyz="0 0 0"/>', '<origin xyz="0 0 0.3"/>')))
    robot = Robot.from_urdf(path, tool="tool")
    np.testing.assert_allclose(tip_of(robot, 2), [0, 0, 0.3])
    q = robot.configuration([0.3, 0.8])
    loads = (ea.Payload(1.0, frame="upper").loaded(robot), ea.Payload(1.0, frame="upper").loaded(plain))
    assert loads[0].inertias[1] == loads[1].inertias[1]  # the link's, that the shoulder moves
    assert loads[0].inertias[2] == robot.model.inertias[2]
    held = Robot.from_urdf(path, locked=["upper"])
    assert held.joint_names == ("shoulder",)
    np.testing.assert_allclose(robot.gravity(q), plain.gravity(q))
    with pytest.raises(UnknownNameError, match="unknown joint 'fore'"):
        Robot.from_urdf(path, locked=["fore"])
