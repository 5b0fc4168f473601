"""A broken URDF is refused with the file, the element and the value; a sound one passes."""

from __future__ import annotations

import numpy as np
import pytest
from small_arm import ELBOW, TOOL, model_of, refused, written

from eladapt.robot import library
from eladapt.robot.model import Robot
from eladapt.urdf.checks import MAX_BYTES, MAX_DEPTH, MAX_JOINTS, check_model, check_urdf, read_urdf


def test_the_unchanged_arm_passes(tmp_path):
    """The template of every mutation below is sound, before and after Pinocchio reads it."""
    path = written(tmp_path)
    assert read_urdf(path).get("name") == "arm"
    check_model(model_of(path), path)


@pytest.mark.parametrize("name", library.robots())
def test_every_robot_of_the_library_passes(name):
    """Each robots/*.toml names a sound URDF, and postures strictly inside its limits."""
    entry, robot = library.entry(name), Robot.load(name)
    check_urdf(entry.urdf, locked=entry.locked)
    check_model(robot.model, entry.urdf)
    for posture in (robot.home, robot.target):
        assert np.all(robot.lower < posture)
        assert np.all(posture < robot.upper)
    assert entry.description
    assert entry.tool == robot.tool


MUTATIONS = {
    # one change to the arm: (old, new), the element named, the value named
    "negative mass": ('mass value="2"', 'mass value="-2"', 'link "upper" <inertial> <mass>', '"-2"'),
    "comma in mass": ('mass value="2"', 'mass value="1,5"', 'link "upper" <inertial> <mass>', '"1,5"'),
    "unit in mass": ('mass value="2"', 'mass value="2 kg"', 'link "upper" <inertial> <mass>', '"2 kg"'),
    "NaN mass": ('mass value="2"', 'mass value="nan"', 'link "upper" <inertial> <mass>', '"nan"'),
    "infinite mass": ('mass value="2"', 'mass value="inf"', 'link "upper" <inertial> <mass>', '"inf"'),
    "overflowing mass": ('mass value="2"', 'mass value="1e999"', 'link "upper" <inertial> <mass>', "1e999"),
    "no mass": ('<mass value="2"/>', "", 'link "upper" <inertial> <mass>', "missing"),
    "two masses": ('<mass value="2"/>', '<mass value="2"/><mass value="3"/>', "<inertial> <mass>", "2 times"),
    "NaN inertia": ('ixx="0.03"', 'ixx="nan"', 'link "upper" <inertial> <inertia>', 'ixx="nan"'),
    "no izz": (' izz="0.02"', "", 'link "upper" <inertial> <inertia>', "no izz"),
    "short origin": ('xyz="0 0 1"', 'xyz="0 1"', 'joint "shoulder" <origin>', 'xyz="0 1"'),
    "word in rpy": ('rpy="0 0 0"', 'rpy="0 0 pi"', 'joint "shoulder" <origin>', 'rpy="0 0 pi"'),
    "infinite radius": ('radius="0.03"', 'radius="inf"', 'link "upper" <visual> <geometry>', '"inf"'),
    "NaN axis": ('xyz="1 0 0"', 'xyz="nan 0 0"', 'joint "shoulder" <axis>', "nan 0 0"),
    "zero axis": ('xyz="1 0 0"', 'xyz="0 0 0"', 'joint "shoulder" <axis>', 'xyz="0 0 0"'),
    "axis without xyz": ('<axis xyz="1 0 0"/>', "<axis/>", 'joint "shoulder" <axis>', "no xyz"),
    "crossed limits": ('lower="-3"', 'lower="4"', 'joint "shoulder" <limit>', 'lower="4" upper="3"'),
    "NaN limit": ('upper="3"', 'upper="nan"', 'joint "shoulder" <limit>', 'upper="nan"'),
    "negative effort": ('effort="40"', 'effort="-40"', 'joint "shoulder" <limit>', 'effort="-40"'),
    "no effort": (' effort="40"', "", 'joint "shoulder" <limit>', "no effort"),
    "no limit": (
        '<limit lower="-3" upper="3" effort="40" velocity="2"/>', "", 'joint "shoulder" <limit>', "missing",
    ),
    "word in damping": ('damping="0.5"', 'damping="low"', 'joint "shoulder" <dynamics>', 'damping="low"'),
    "negative friction": ('friction="0.1"', 'friction="-1"', 'joint "shoulder" <dynamics>', 'friction="-1"'),
    "empty dynamics": (
        '<dynamics damping="0.5" friction="0.1"/>', "<dynamics/>", 'joint "shoulder" <dynamics>', "empty",
    ),
    "floating joint": ('type="revolute"', 'type="floating"', 'joint "shoulder"', 'type="floating"'),
    "planar joint": ('type="revolute"', 'type="planar"', 'joint "shoulder"', 'type="planar"'),
    "misspelt type": ('type="revolute"', 'type="revolut"', 'joint "shoulder"', 'type="revolut"'),
    "unknown child": (ELBOW, ELBOW.replace("fore", "foer"), 'joint "elbow" <child>', 'link="foer"'),
    "unknown parent": (ELBOW, ELBOW.replace("upper", "uper"), 'joint "elbow" <parent>', 'link="uper"'),
    "no parent": (ELBOW, '<child link="fore"/>', 'joint "elbow" <parent>', 'link=""'),
    "same link name": (TOOL, TOOL + '<link name="fore"/>', 'link "fore"', "2 times"),
    "same joint name": ('joint name="mount"', 'joint name="elbow"', 'joint "elbow"', "2 times"),
    "nameless link": (TOOL, TOOL + '<link/>', "<link>", "no name"),
    "nameless robot": ('<robot name="arm">', "<robot>", "<robot>", "no name"),
    "two bases": (TOOL, TOOL + '<link name="lost"/>', "<robot>", '"base", "lost"'),
    "closed loop": (
        TOOL,
        TOOL + '<joint name="bar" type="fixed"><parent link="base"/><child link="tool"/></joint>',
        'link "tool"',
        'joints "mount", "bar"',
    ),
    "cycle": ('parent link="base"', 'parent link="fore"', "<robot>", '"upper", "fore"'),
    "joint on itself": (ELBOW, '<parent link="fore"/> <child link="fore"/>', "<robot>", '"fore"'),
    "unexpanded value": ('mass value="2"', 'mass value="${m}"', 'link "upper" <inertial> <mass>', "${m}"),
    "xacro tag": (
        '<robot name="arm">',
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="a.xacro"/>',
        "<xacro:include>",
        "xacro tag",
    ),
    "xacro tag, prefix undeclared": (TOOL, "<xacro:tool/>", "file", "unbound prefix"),
    "entity": (
        '<robot name="arm">', '<!DOCTYPE r [<!ENTITY m "2">]><robot name="arm">', "<!DOCTYPE>", "name='r'",
    ),
    "external file": (
        '<robot name="arm">',
        '<!DOCTYPE r SYSTEM "secret.txt"><robot name="arm">',
        "<!DOCTYPE>",
        "secret.txt",
    ),
    "cut off": ("</robot>", "", "file", "no element found"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "element", "value"), MUTATIONS.values(), ids=MUTATIONS.keys())
def test_one_fault_is_one_finding(tmp_path, old, new, element, value):
    """One change to a sound file is refused once, with the file, the element, the value and a remedy."""
    path = written(tmp_path, (old, new))
    error = refused(check_urdf, path)
    (finding,) = error.findings
    assert element in finding.element
    assert value in finding.value
    assert finding.problem
    assert finding.remedy
    assert str(path) in str(error)
    assert str(finding) in str(error)


def test_all_faults_are_reported_at_once(tmp_path):
    """Four faults in four places are four findings of one error."""
    path = written(
        tmp_path,
        ('mass value="2"', 'mass value="-2"'),
        ('xyz="1 0 0"', 'xyz="0 0 0"'),
        ('damping="0.5"', 'damping="inf"'),
        (TOOL, TOOL + '<link name="lost"/>'),
    )
    found = {finding.value for finding in refused(check_urdf, path).findings}
    assert found == {'value="-2"', 'xyz="0 0 0"', 'damping="inf"', 'base links "base", "lost"'}


JOINT = '<joint name="j{1}" type="continuous"><parent link="l{0}"/><child link="l{1}"/></joint>'
CHAIN = '<link name="l{1}"/>' + JOINT
NOT_ROBOTS = {
    "empty": ("", "no element found"),
    "text": ("hello", "syntax error"),
    "SDF": ('<sdf version="1.9"/>', "<sdf>"),
    "no links": ('<robot name="r"/>', "no <link>"),
    "one link": ('<robot name="r"><link name="base"/></robot>', "no <joint>"),
    "deep": ("<robot>" + "<a>" * MAX_DEPTH, f"depth {MAX_DEPTH + 1}"),
    "heavy": ("<robot/>" + " " * MAX_BYTES, f"{MAX_BYTES + 8} bytes"),
    "long": (
        '<robot name="r"><link name="l0"/>'
        + "".join(CHAIN.format(i, i + 1) for i in range(MAX_JOINTS + 1))
        + "</robot>",
        f"{MAX_JOINTS + 1} joints",
    ),
}


@pytest.mark.parametrize(("text", "value"), NOT_ROBOTS.values(), ids=NOT_ROBOTS.keys())
def test_what_is_no_robot_is_refused(tmp_path, text, value):
    """Other files, empty robots and oversize ones are refused before any reader sees them."""
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    error = refused(check_urdf, path)
    assert value in [finding.value for finding in error.findings] or value in error.findings[0].value
    assert str(path) in str(error)


def test_a_chain_of_the_greatest_length_is_read(tmp_path):
    """The bound on joints is not off by one: that many pass the check and Pinocchio's reader."""
    path = tmp_path / "robot.urdf"
    links = "".join(CHAIN.format(i, i + 1) for i in range(MAX_JOINTS))
    path.write_text(f'<robot name="r"><link name="l0"/>{links}</robot>')
    assert model_of(path).nv == MAX_JOINTS


def test_nothing_to_move_is_refused(tmp_path):
    """A robot without a movable joint is refused."""
    path = written(tmp_path, ('type="revolute"', 'type="fixed"'), ('type="continuous"', 'type="fixed"'))
    (finding,) = refused(check_model, model_of(path), path).findings
    assert finding.value == "0 movable joints"
