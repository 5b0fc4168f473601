"""Robots from URDFs: names, limits, locked and continuous joints, and what is refused."""

import re
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from shared import ROBOTS, load

import eladapt as ea
from eladapt.errors import ArgumentError, AssumedWarning, UnitsWarning, UnknownNameError, UrdfError
from eladapt.robot.library import entry

LINK = '<link name="{0}"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>'  # noqa: E501
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 1 0"/>'
    '<origin xyz="0.3 0 0"/><limit effort="{4}" velocity="0" lower="{5}" upper="{6}"/>{7}</joint>'
)


def urdf(tmp_path: Path, *joints: str) -> Path:
    """A chain of links with the joints given, in order."""
    links = "".join(LINK.format(f"link{k}") for k in range(len(joints) + 1))
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{"".join(joints)}</robot>')
    return path


def joint(k: int, kind: str, effort: float = 0, lower: float = 0, upper: float = 0, more: str = "") -> str:
    return JOINT.format(f"j{k}", kind, f"link{k}", f"link{k + 1}", effort, lower, upper, more)


def test_all_joint_types_of_a_fixed_base_tree(tmp_path):
    """Revolute, continuous and prismatic joints in one arm, with 0 and equal limits read as not set."""
    arm = urdf(
        tmp_path, joint(0, "revolute", 5, -1, 2), joint(1, "continuous"), joint(2, "prismatic", 7),
        joint(3, "fixed"),
    )  # fmt: skip
    robot = ea.Robot.from_urdf(arm)
    assert (robot.nq, robot.nv, robot.joint_names) == (4, 3, ("j0", "j1", "j2"))
    np.testing.assert_array_equal(robot.effort_limit, [5, np.inf, 7])
    np.testing.assert_array_equal(robot.velocity_limit, [np.inf] * 3)
    np.testing.assert_array_equal(robot.lower, [-1, -np.inf, -np.inf])
    np.testing.assert_array_equal(robot.upper, [2, np.inf, np.inf])
    reg, rng = ea.Regressors(robot), np.random.default_rng(0)
    q, (v, a) = robot.configuration([0.5, 4.0, 0.2]), rng.normal(size=(2, 3))
    np.testing.assert_allclose(reg.torque(q, v, a) @ reg.theta, robot.inverse_dynamics(q, v, a), rtol=1e-11)


@pytest.mark.parametrize("name", ROBOTS)
def test_configurations_add_up(name, rng):
    """integrate undoes difference, also across the half turn of a continuous joint."""
    robot = load(name)
    for _ in range(20):
        q0, q1 = robot.random_configuration(rng), robot.random_configuration(rng)
        again = robot.integrate(q0, robot.difference(q0, q1))
        np.testing.assert_allclose(again, q1, atol=1e-12)
        np.testing.assert_allclose(robot.configuration(robot.coordinates(q0)), q0, atol=1e-12)


def test_continuous_joints_go_the_short_way():
    robot = load("kinova")
    near, far = (robot.configuration([angle, 0, 0, 0, 0, 0]) for angle in (3.1, -3.1))
    assert robot.difference(near, far)[0] == pytest.approx(2 * np.pi - 6.2)
    with pytest.raises(ArgumentError, match=r"continuous joint .* expects \(cos, sin\)"):
        robot.gravity(np.full(robot.nq, 0.5))


@pytest.mark.parametrize("name", ROBOTS)
def test_forward_dynamics_inverts_inverse_dynamics(name, rng):
    robot = load(name)
    q, (v, a) = robot.random_configuration(rng), rng.normal(size=(2, robot.nv))
    found = robot.forward_dynamics(q, v, robot.inverse_dynamics(q, v, a))
    np.testing.assert_allclose(found, a, rtol=1e-8, atol=1e-8)
    bias = robot.coriolis_matrix(q, v) @ v + robot.gravity(q)
    expected = robot.mass_matrix(q) @ a + bias
    np.testing.assert_allclose(robot.inverse_dynamics(q, v, a), expected, rtol=1e-10, atol=1e-10)


def test_armature_is_part_of_the_dynamics(rng):
    """The same arm with and without rotors differs by diag(armature) in M, and nowhere else."""
    with_rotors = load("talos_left_arm")
    source = entry("talos_left_arm")
    without = ea.Robot.from_urdf(source.urdf, source.package_dirs, source.locked)
    q = with_rotors.random_configuration(rng)
    difference = with_rotors.mass_matrix(q) - without.mass_matrix(q)
    np.testing.assert_allclose(difference, np.diag(with_rotors.armature), atol=1e-12)
    assert np.all(with_rotors.armature > 0)
    np.testing.assert_allclose(with_rotors.gravity(q), without.gravity(q), atol=1e-12)


def test_locked_joints_by_name_and_pattern():
    source = entry("panda")
    robot = ea.Robot.from_urdf(source.urdf, source.package_dirs, ["panda_finger_*", "panda_joint7"])
    assert robot.nv == 6
    assert "panda_joint7" not in robot.joint_names
    with pytest.raises(UnknownNameError, match=r"unknown joint 'elbow'; legal names: panda_joint1, "):
        ea.Robot.from_urdf(source.urdf, source.package_dirs, ["elbow"])


def test_coupled_joints_must_be_locked():
    source = entry("panda")
    with pytest.raises(UrdfError, match=r"panda_finger_joint2.*mimics.*locked="):
        ea.Robot.from_urdf(source.urdf, source.package_dirs)


def test_nothing_left_to_move_is_refused(tmp_path):
    path = urdf(tmp_path, joint(0, "continuous"))
    with pytest.raises(UrdfError, match=r"arm.urdf(.|\n)*0 movable joints"):
        ea.Robot.from_urdf(path, locked=["j0"])


def test_massless_and_absent_inertia_are_refused(tmp_path):
    path = urdf(tmp_path, joint(0, "continuous"), joint(1, "continuous"))
    text = path.read_text()
    path.write_text(text.replace(LINK.format("link2"), '<link name="link2"/>'))
    with pytest.raises(UrdfError, match=r"arm.urdf(.|\n)*link2"):
        ea.Robot.from_urdf(path)


def test_unknown_robots_and_frames_list_the_legal_names(tmp_path):
    with pytest.raises(UnknownNameError, match=r"'pandaa' \(did you mean 'panda'\?\); legal names: .*panda"):
        ea.Robot.load("pandaa")
    with pytest.raises(UnknownNameError, match=r"'hand'; legal names: .*link1"):
        ea.Robot.from_urdf(urdf(tmp_path, joint(0, "continuous")), tool="hand")
    with pytest.raises(UnknownNameError, match="unknown joint 'j9'"):
        ea.Robot.from_urdf(urdf(tmp_path, joint(0, "continuous")), armature={"j9": 1.0})


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(UrdfError, match="does not exist"):
        ea.Robot.from_urdf(tmp_path / "no.urdf")


def test_parameters_said_to_be_zero_must_be(tmp_path):
    path = urdf(tmp_path, joint(0, "continuous"))
    with pytest.raises(ArgumentError, match=r"m\(j0\) is 1 in the URDF, expected 0"):
        ea.Regressors(ea.Robot.from_urdf(path, zero_parameters=["m(j0)"]))
    with pytest.raises(UnknownNameError, match="'weight'; legal names"):
        ea.Regressors(ea.Robot.from_urdf(path, zero_parameters=["weight"]))


def test_a_robot_can_be_found_again_from_its_source(robot):
    again = ea.Robot.from_source(robot.source)
    assert again.model == robot.model
    q = robot.configuration(robot.home)
    np.testing.assert_array_equal(again.gravity(q), robot.gravity(q))


@pytest.mark.parametrize(
    ("changed", "reason"), [({"colour": "red"}, "'colour'"), ({"text": "\u0416"}, "latin-1")]
)
def test_what_is_no_source_is_refused_in_a_line(changed, reason):
    """With the reason, and without the file's whole text."""
    source = {**ea.Robot.from_urdf(entry("two_link").urdf).source, **changed}
    with pytest.raises(ArgumentError, match=f"expected what Robot.source gives, got .*{reason}") as refused:
        ea.Robot.from_source(source)
    assert len(str(refused.value)) < 400


def test_a_variant_of_a_robot_of_the_library_is_not_taken_for_it():
    """Same name and file, but no rotors, or other parameters known to be zero."""
    source = entry("talos_left_arm")
    bare = ea.Robot.from_urdf(source.urdf, source.package_dirs, source.locked, name="talos_left_arm")
    assert np.all(ea.Robot.from_source(bare.source).armature == 0)
    general = ea.Robot.from_urdf(entry("two_link").urdf, name="two_link")
    assert len(ea.Regressors(ea.Robot.from_source(general.source))) == 6


def test_a_robot_without_gravity_torque_is_regulated():
    """Both axes of asr_twodof are vertical: theta_U is empty, and everything still works."""
    robot = load("asr_twodof")
    reg = ea.Regressors(robot)
    assert reg.n_potential == 0
    assert reg.gravity(robot.configuration(robot.home)).shape == (2, 0)


@pytest.mark.parametrize("kind", ["continuous", "revolute", "prismatic"])
def test_one_joint_is_a_robot_too(tmp_path, kind, rng):
    """Identities and regulation with matrices of one row, for each joint type."""
    robot = ea.Robot.from_urdf(urdf(tmp_path, joint(0, kind)).rename(tmp_path / "one.urdf"))
    for joint_terms in ((), ("rotor", "viscous", "coulomb", "offset")):
        reg = ea.Regressors(robot, joint_terms=joint_terms)
        q, (v, a) = robot.configuration([0.7]), rng.normal(size=(2, 1))
        np.testing.assert_allclose(reg.torque(q, v, a) @ reg.theta, robot.inverse_dynamics(q, v, a))
        np.testing.assert_allclose(reg.momentum(q, v) @ reg.theta, robot.mass_matrix(q) @ v)
        expected = robot.coriolis_matrix(q, v).T @ v
        np.testing.assert_allclose(reg.kinetic_gradient(q, v) @ reg.theta, expected, atol=1e-14)
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration([0.0]), friction=ea.Friction(coulomb=1e-6))
    record = ea.simulate(controller, plant, robot.configuration([0.8]), 4.0, progress=False)
    assert record.settling_time(1e-3) < 4


def test_a_robot_says_what_it_is_in_a_line(robot):
    """Its name, how many joints from which to which, and the tool; nothing of Pinocchio's."""
    shown = repr(robot)
    assert shown.count("\n") == 0
    assert len(shown) < 160
    for name in (robot.name, robot.joint_names[0], robot.joint_names[-1], robot.tool):
        assert repr(name) in shown
    assert f"{robot.nv} joint" in shown


def test_a_robot_of_hostile_names_is_still_told_in_a_line(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(tmp_path, joint(0, "revolute")).read_text().replace('"j0"', f'"j&#10;{"0" * 1000}"'))
    robot = ea.Robot.from_urdf(path, name="a\n\x1b[31m" * 100)
    assert repr(robot).isprintable()
    assert len(repr(robot)) < 300


def test_the_types_are_there_for_others():
    """A type checker reads the annotations of a library that has this file (PEP 561)."""
    assert (Path(ea.__file__).parent / "py.typed").is_file()


def test_coordinates_by_name_are_those_in_order():
    """In any order; a typo and a joint left out are said."""
    robot = load("kinova")
    x = np.linspace(-1, 1, robot.nv)
    named = dict(reversed(list(zip(robot.joint_names, x, strict=True))))
    np.testing.assert_array_equal(robot.configuration(named), robot.configuration(x))
    with pytest.raises(UnknownNameError, match=f"'typo'; legal names: {robot.joint_names[0]}"):
        robot.configuration({**named, "typo": 0.0})
    with pytest.raises(ArgumentError, match=f"none is given for {robot.joint_names[0]}"):
        robot.configuration({name: named[name] for name in robot.joint_names[1:]})


def test_coordinates_by_name_and_back(rng):
    robot = ea.Robot.load("kinova")
    q = robot.random_configuration(rng)
    found = robot.names(q)
    assert tuple(found) == robot.joint_names
    np.testing.assert_allclose(robot.configuration(dict(reversed(found.items()))), q, atol=1e-12)


def ceiling(tmp_path: Path) -> tuple[ea.Robot, ea.Robot]:
    """A UR5 that hangs from the ceiling: by gravity, and by a base that is turned over about x."""
    path = ea.Robot.load("ur5").path
    text = path.read_text()
    root = ElementTree.fromstring(text)
    base = next(
        n.get("name")
        for n in root.findall("link")
        if not any(j.find("child").get("link") == n.get("name") for j in root.findall("joint"))
    )
    turned = f"""<link name="ceiling"/><joint name="hung" type="fixed"><parent link="ceiling"/>
        <child link="{base}"/><origin xyz="0 0 0" rpy="{np.pi!r} 0 0"/></joint></robot>"""
    copy = tmp_path / "hung.urdf"
    copy.write_text(text.replace("</robot>", turned))
    folders = ea.Robot.load("ur5").package_dirs
    return ea.Robot.from_urdf(path, folders, gravity=(0, 0, 9.81)), ea.Robot.from_urdf(copy, folders)


def test_an_arm_on_the_ceiling_is_one_on_a_turned_base(tmp_path, rng):
    """Dynamics, identities and a run: by gravity=(0, 0, 9.81) as by the file's own turned base."""
    robot, other = ceiling(tmp_path)
    reg = ea.Regressors(robot, joint_terms="viscous")
    for _ in range(5):
        q, v, a = robot.random_configuration(rng), rng.normal(size=robot.nv), rng.normal(size=robot.nv)
        np.testing.assert_allclose(robot.gravity(q), other.gravity(q), atol=1e-10)
        np.testing.assert_allclose(reg.gravity(q) @ reg.theta_potential, robot.gravity(q), atol=1e-10)
        torque = robot.inverse_dynamics(q, v, a) + reg.joint_torque(v) @ reg.theta
        np.testing.assert_allclose(reg.torque(q, v, a) @ reg.theta, torque, atol=1e-9)
    assert not np.allclose(robot.gravity(q), ea.Robot.load("ur5").gravity(q), atol=0.1)
    runs = []
    for arm in (robot, other):
        start, goal = np.zeros(arm.nv), 0.5 * np.ones(arm.nv)
        plant = ea.PinocchioPlant(arm, arm.configuration(start))
        controller = ea.CompositeController.for_robot(arm)
        runs.append(ea.simulate(controller, plant, arm.configuration(goal), 1.0, progress=False))
    # Not to rounding: its base parameters are chosen in another frame, and the gains' postures are the same.
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-5)
    assert ea.Robot.from_source(robot.source).model.gravity == robot.model.gravity
    with pytest.raises(ArgumentError, match="gravity: expected"):
        ea.Robot.from_urdf(robot.path, robot.package_dirs, gravity=(0, 0))


def test_coupled_joints_are_locked_together():
    """By the word mimic; the message names all that have to be."""
    panda = entry("panda")
    with pytest.raises(UrdfError, match=r"panda_finger_joint2.*locked=\['mimic'\]"):
        ea.Robot.from_urdf(panda.urdf, panda.package_dirs)
    assert ea.Robot.from_urdf(panda.urdf, panda.package_dirs, "mimic").locked == ("panda_finger_joint2",)


def test_numbers_that_fit_no_arm_are_told(tmp_path):
    """Masses in grams: gravity is a thousand times too large, wherever the arm is."""
    path = tmp_path / "grams.urdf"
    text = ea.Robot.load("two_link").path.read_text()
    heavier = re.sub(r'mass value="([^"]+)"', lambda m: f'mass value="{1e3 * float(m[1])}"', text)
    path.write_text(re.sub(r'effort="[^"]+"', 'effort="20"', heavier))
    with pytest.warns(UnitsWarning, match="kg and m"):
        ea.Robot.from_urdf(path)


def weightless_wrist(tmp_path: Path, effort: float) -> Path:
    """A last link that is a point on its own axis."""
    path = urdf(tmp_path, joint(0, "revolute", 50, -2, 2), joint(1, "revolute", effort, -2, 2))
    text = path.read_text()
    point = LINK.format("link2")
    for moment in ("ixx", "iyy", "izz"):
        point = point.replace(f'{moment}=".1"', f'{moment}="0"')
    path.write_text(text.replace(LINK.format("link2"), point))
    return path


def test_a_joint_that_turns_no_inertia_runs_on_an_assumed_rotor(tmp_path):
    """One that its effort turns at 400 rad/s^2, told; the arm settles on it. Without an effort limit nothing
    can be assumed, and with a rotor given nothing is."""
    path = weightless_wrist(tmp_path, 20)
    with pytest.warns(AssumedWarning, match=r"joint 'j1'.*rotor of 0\.05 kg m\^2.*armature="):
        robot = ea.Robot.from_urdf(path)
    np.testing.assert_allclose(robot.armature, [0, 20 / 400])
    goal = robot.configuration([0.5, 0.8])
    plant = ea.PinocchioPlant(robot, robot.configuration([0.0, 0.0]))
    record = ea.simulate(ea.CompositeController.for_robot(robot), plant, goal, 4.0, progress=False)
    assert record.settling_time(1e-3) < 4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = ea.Robot.from_source(robot.source)
        np.testing.assert_array_equal(again.armature, robot.armature)
        assert ea.Robot.from_urdf(path, armature={"j1": 0.02}).armature[1] == 0.02
    with pytest.raises(UrdfError, match=r'"j1": 0 kg m\^2 about its axis.*an effort limit or an armature'):
        ea.Robot.from_urdf(weightless_wrist(tmp_path, 0))
