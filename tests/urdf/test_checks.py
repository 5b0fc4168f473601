"""A broken URDF is refused with the file, the element and the value; a sound one passes."""

from __future__ import annotations

import os

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eladapt.errors import MendedWarning, UrdfError
from eladapt.robot import library
from eladapt.robot.model import Robot
from eladapt.urdf.checks import MAX_BYTES, MAX_DEPTH, MAX_JOINTS, check_model, check_urdf, read_urdf
from eladapt.urdf.numbers import parse

ARM = """<robot name="arm">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 1" rpy="0 0 0"/>
    <parent link="base"/> <child link="upper"/>
    <axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="40" velocity="2"/>
    <dynamics damping="0.5" friction="0.1"/>
  </joint>
  <link name="upper">
    <inertial>
      <origin xyz="0 0 0.2"/> <mass value="2"/>
      <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"/>
    </inertial>
    <visual><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.03" length="0.4"/></geometry></visual>
  </link>
  <joint name="elbow" type="continuous">
    <parent link="upper"/> <child link="fore"/> <axis xyz="0 1 0"/>
  </joint>
  <link name="fore">
    <inertial>
      <mass value="1"/>
      <inertia ixx="0.003" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.002"/>
    </inertial>
  </link>
  <joint name="mount" type="fixed">
    <parent link="fore"/> <child link="tool"/> <axis xyz="0 0 0"/>
  </joint>
  <link name="tool"/>
</robot>
"""
ELBOW = '<parent link="upper"/> <child link="fore"/>'
TOOL = '<link name="tool"/>'
FORE_INERTIA = '<inertia ixx="0.003" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.002"/>'
FORE_INERTIAL = ARM[ARM.index('<link name="fore">') : ARM.index('<joint name="mount"')]


def written(folder, *changes):
    """The arm as a file, with each (old, new) replaced; an old that is not there once is a mistake here."""
    text = ARM
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


def model_of(path):
    check_urdf(path)
    return pin.buildModelFromUrdf(str(path))


def refused(check, *arguments):
    with pytest.raises(UrdfError) as caught:
        check(*arguments)
    return caught.value


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


@pytest.mark.parametrize(("name", "problem"), [("none.urdf", "does not exist"), ("", "is a folder")])
def test_a_path_that_is_no_file_is_refused(tmp_path, name, problem):
    """A missing file and a folder are named, with the URDF files that are there."""
    written(tmp_path)
    (finding,) = refused(check_urdf, tmp_path / name).findings
    assert finding.value == str(tmp_path / name)
    assert finding.problem == problem
    assert '"robot.urdf"' in finding.remedy


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_refused_without_waiting(tmp_path):
    """A path that would block when opened is refused by its kind."""
    os.mkfifo(tmp_path / "pipe.urdf")
    assert refused(check_urdf, tmp_path / "pipe.urdf").findings[0].problem == "is not a file"


def test_a_default_namespace_changes_nothing(tmp_path):
    """Pinocchio's reader ignores namespaces, so the checks look through a default one."""
    spaced = ('<robot name="arm">', '<robot name="arm" xmlns="http://www.ros.org">')
    check_urdf(written(tmp_path, spaced))
    (finding,) = refused(check_urdf, written(tmp_path, spaced, ('value="2"', 'value="-2"'))).findings
    assert finding.value == 'value="-2"'


BODIES = {
    "massless": (FORE_INERTIAL, '<link name="fore"/>', '"fore", "tool" on joint "elbow"', "mass 0 kg"),
    "triangle": ('izz="0.02"', 'izz="0.08"', 'link "upper" on joint "shoulder"', "0.03, 0.04, 0.08"),
    "negative moment": ('ixx="0.03"', 'ixx="-0.03"', 'link "upper" on joint "shoulder"', "-0.03, 0.02, 0.04"),
    "product too large": ('iyz="0" izz="0.02"', 'iyz="0.05" izz="0.02"', 'link "upper"', "-0.0209902"),
    "mass on the axis": (
        FORE_INERTIA, FORE_INERTIA.replace("0.004", "0").replace("0.003", "0").replace("0.002", "0"),
        'joint "elbow"', "0 kg m^2 about its axis",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "element", "value"), BODIES.values(), ids=BODIES.keys())
def test_an_impossible_body_is_refused(tmp_path, old, new, element, value):
    """What Pinocchio loads but no body can be is refused with its links and its number."""
    path = written(tmp_path, (old, new))
    error = refused(check_model, model_of(path), path)
    (finding,) = error.findings
    assert element in finding.element
    assert value in finding.value
    assert str(path) in str(error)


def test_joints_that_move_no_inertia_together_are_refused(tmp_path):
    """Two joints on one axis with a point mass between leave M singular, though each turns inertia."""
    path = written(
        tmp_path,
        ('<origin xyz="0 0 0.2"/> <mass', "<mass"),
        ('ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"', ZERO),
        ('axis xyz="0 1 0"', 'axis xyz="1 0 0"'),
    )
    (finding,) = refused(check_model, model_of(path), path).findings
    assert finding.element == 'joints "shoulder", "elbow"'


def test_nothing_to_move_is_refused(tmp_path):
    """A robot without a movable joint is refused."""
    path = written(tmp_path, ('type="revolute"', 'type="fixed"'), ('type="continuous"', 'type="fixed"'))
    (finding,) = refused(check_model, model_of(path), path).findings
    assert finding.value == "0 movable joints"


@pytest.mark.parametrize("armature", [-0.1, np.nan, np.inf])
def test_an_impossible_armature_is_refused(tmp_path, armature):
    """A rotor inertia is finite and not negative."""
    path = written(tmp_path)
    model = model_of(path)
    model.armature[1] = armature
    (finding,) = refused(check_model, model, path).findings
    assert 'joint "elbow"' in finding.element
    assert f"armature {armature:g}" in finding.value


ZERO = 'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"'
ROD = 'ixx="0" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.012"'
IMPOSSIBLE = 'ixx="0.0001" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.0123"'
HEAVY_TOOL = '<link name="tool"><inertial><mass value="{}"/><inertia {}/></inertial></link>'
SOUND = {
    "rod without width": ('ixx="0.003" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.002"', ROD),
    "point mass off the axis": ('ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"', ZERO),
    "massless tool": (TOOL, HEAVY_TOOL.format(0, ZERO)),
    "tool that the arm makes up for": (TOOL, HEAVY_TOOL.format(0.1, IMPOSSIBLE)),
    "range of nothing": ('lower="-3" upper="3" effort="40" velocity="2"', 'effort="0" velocity="0"'),
}


@pytest.mark.parametrize(("old", "new"), SOUND.values(), ids=SOUND.keys())
def test_the_edge_of_the_physical_passes(tmp_path, old, new):
    """Bodies on the boundary pass, and a link counts only as part of the body that moves with it."""
    path = written(tmp_path, (old, new))
    check_model(model_of(path), path)


def test_armature_makes_up_for_inertia(tmp_path):
    """A joint that turns no inertia is refused; with a rotor it passes."""
    path = written(tmp_path, (FORE_INERTIA, f"<inertia {ZERO}/>"))
    model = model_of(path)
    refused(check_model, model, path)
    model.armature[1] = 0.01
    check_model(model, path)


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_float_is_a_number(value):
    """The strict grammar of numbers takes what Python writes."""
    assert parse(repr(value)) == (value,)
    assert parse(f"{value!r}  {value!r} 0", 3) == (value, value, 0.0)


@pytest.mark.parametrize(
    "text", ["", "1_0", "0x10", "1d3", "+-1", ".", "1e", "\u0661", "1\t", "infinity", "true"]
)
def test_what_the_reader_drops_is_not_a_number(text):
    """What Python or a person may take for a number but Pinocchio's reader does not is refused."""
    assert parse(text) is None


@settings(derandomize=True, deadline=None, max_examples=300)
@given(start=st.integers(0, len(ARM)), length=st.integers(0, 60), noise=st.binary(max_size=12))
def test_no_damage_to_a_file_escapes_as_another_error(tmp_path_factory, start, length, noise):
    """A file with a piece cut out and bytes put in either is read by Pinocchio too, or raises UrdfError."""
    path = tmp_path_factory.mktemp("damaged") / "robot.urdf"
    path.write_bytes(ARM[:start].encode() + noise + ARM[start + length :].encode())
    try:
        check_urdf(path)
    except UrdfError:
        return
    pin.buildModelFromUrdf(str(path))


def test_blanks_and_tabs_around_numbers_are_read(tmp_path):
    """As vendors ship them; the model is that of the file without them."""
    changes = [
        ('mass value="2"', 'mass value=" 2 "'),
        ('xyz="0 0 1" rpy="0 0 0"', 'xyz=" 0\t0  1" rpy="0 0 0 "'),
    ]
    assert Robot.from_urdf(written(tmp_path, *changes)).model == Robot.from_urdf(written(tmp_path)).model


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<robot name="arm">', '<robot name="arm" xmlns:xacro="http://elsewhere"><xacro:if value="true"/>'),
        (TOOL, TOOL + '<property name="w" value="0.2"/>'),
        (TOOL, TOOL + '<include filename="arm.xacro"/>'),
    ],
)
def test_xacro_of_any_namespace_or_none_is_refused(tmp_path, old, new):
    with pytest.raises(UrdfError, match="xacro tag"):
        check_urdf(written(tmp_path, (old, new)))


def test_an_unused_xacro_namespace_is_none(tmp_path):
    """What xacro leaves when it expands a file."""
    check_urdf(
        written(tmp_path, ('<robot name="arm">', '<robot name="arm" xmlns:xacro="http://ros.org/xacro">'))
    )


@pytest.mark.parametrize("encoding", ["gbk", "shift_jis", "utf-8"])
def test_a_file_is_read_in_the_encoding_that_it_declares(tmp_path, encoding):
    path = tmp_path / "arm.urdf"
    text = f'<?xml version="1.0" encoding="{encoding}"?>' + ARM.replace(
        'name="tool"', 'name="\u624b"'
    ).replace('link="tool"', 'link="\u624b"')
    path.write_bytes(text.encode(encoding))
    assert Robot.from_urdf(path).model.existFrame("\u624b")


def test_materials_of_one_name_are_named(tmp_path):
    twice = '<material name="grey"/>' * 2
    with pytest.raises(UrdfError, match='material "grey": 2 times'):
        check_urdf(written(tmp_path, (TOOL, TOOL + twice)))


def test_a_body_that_is_none_is_mended_where_asked(tmp_path):
    """Principal moments 0.03, 0.04 and 0.08: the nearest physical ones, told; mass and centre stay, and what
    is physical is left alone."""
    plain = Robot.from_urdf(written(tmp_path)).model
    path = written(tmp_path, ('ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"',
                              'ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.08"'))  # fmt: skip
    with pytest.raises(UrdfError, match="mend=True"):
        Robot.from_urdf(path)
    with pytest.warns(MendedWarning, match=r"'shoulder': principal moments 0\.03 -> .*0\.08 -> "):
        robot = Robot.from_urdf(path, mend=True)
    body = robot.model.inertias[1]
    moments = np.linalg.eigvalsh(body.inertia)
    assert moments[2] <= moments[0] + moments[1]
    # S was (0.045, 0.035, -0.005); raising the last by d raises two moments by d, and by no more than needed.
    np.testing.assert_allclose(moments, [0.035045, 0.045045, 0.08], rtol=1e-3)
    assert body.mass == plain.inertias[1].mass
    np.testing.assert_array_equal(body.lever, plain.inertias[1].lever)
    assert robot.model.inertias[2] == plain.inertias[2]
    with pytest.warns(MendedWarning):
        assert Robot.from_source(robot.source).model == robot.model


@pytest.mark.parametrize("encoding", ["punycode", "zlib", "rot13", "nonsense"])
def test_an_encoding_that_nobody_writes_in_is_refused(tmp_path, encoding):
    """Without a try at it: decoding five megabytes of punycode takes hours."""
    path = tmp_path / "arm.urdf"
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>'.encode() + b"a" * 4_000_000)
    with pytest.raises(UrdfError, match="encoding"):
        read_urdf(path)
