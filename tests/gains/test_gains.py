"""Gains from the URDF: where each comes from, what is kept, and what is refused."""

import dataclasses

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.gains.derived import RESOLVED, derive_gains
from eladapt.gains.extremes import adaptation_mode, fall_mode
from eladapt.robot.library import folder


@pytest.mark.parametrize("name", ["two_link", "panda", "kinova", "asr_twodof"])
def test_every_gain_names_its_rule_and_active_limit(name):
    gains = ea.CompositeController.for_robot(load(name)).gains
    fields = [f.name for f in dataclasses.fields(gains) if f.name != "rules"]
    assert sorted(rule.gain for rule in gains.rules) == sorted(fields)
    text = str(gains)
    assert all(name in text for name in fields)
    assumed = not np.isfinite(load(name).effort_limit).all()
    assert ("URDF sets none" in text) == assumed


def test_gains_scale_with_the_arm():
    """All masses doubled, effort limits not set: P, D and D_L double, and no time constant changes."""
    robot = load("two_link")
    model = robot.model.copy()
    for joint in range(1, model.njoints):
        body = model.inertias[joint]
        model.inertias[joint] = type(body)(2 * body.mass, body.lever, 2 * body.inertia)
    heavy = dataclasses.replace(robot, model=model)
    one, two = (derive_gains(ea.Regressors(r), 1e-3) for r in (robot, heavy))
    for name in ("P", "D", "D_L"):
        np.testing.assert_allclose(getattr(two, name), 2 * getattr(one, name), rtol=1e-12)


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "z1", "so_arm101"])
def test_friction_of_a_part_of_the_effort_limit_cannot_hold_a_joint_far_off(name):
    """P is 0.3 of the effort limit or more in every joint, and D goes with a rotor of such a motor: damping
    grows with the power 1/4 of the inertia, as the homogeneous rule has it."""
    robot = load(name)
    gains = ea.CompositeController.for_robot(robot).gains
    limit = np.where(np.isfinite(robot.effort_limit), robot.effort_limit, np.inf)
    assert np.all((0.3 * limit * (1 - 1e-12) <= gains.P) | ~np.isfinite(limit))
    stiffer = ea.CompositeController.for_robot(robot, P=16 * gains.P).gains
    np.testing.assert_allclose(stiffer.D, 8 * gains.D, rtol=1e-12)


def test_given_gains_are_kept_and_said():
    controller = ea.CompositeController.for_robot(load("two_link"), P=[5.0, 1.0], f0=1e-5)
    np.testing.assert_array_equal(controller.control.P, [5.0, 1.0])
    assert controller.extension.f0 == 1e-5
    given = [rule.gain for rule in controller.gains.rules if rule.active == "given"]
    assert given == ["P", "f0"]
    np.testing.assert_allclose(controller.gains.D_L, 0.1 * controller.gains.D)


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"P": [-1, 1]}, ArgumentError, "P: expected positive"),
        ({"P": [1, 1, 1]}, ArgumentError, r"P: expected a scalar or shape \(2,\)"),
        ({"f0": -1.0}, ArgumentError, "f0: expected positive"),
        ({"stiffness": 3}, UnknownNameError, "unknown gain 'stiffness'; legal names: P, D, D_L"),
    ],
)
def test_given_gains_are_checked(given, error, said):
    with pytest.raises(error, match=said):
        ea.CompositeController.for_robot(load("two_link"), **given)


def test_a_step_too_long_is_refused_with_one_that_would_do():
    """And the dt that the message offers is accepted."""
    robot = load("panda")
    with pytest.raises(
        ArgumentError, match=r"no stable gains at dt = 0.05 s.*joint 'panda_joint\d'"
    ) as caught:
        ea.CompositeController.for_robot(robot, dt=0.05)
    offered = float(str(caught.value).split("dt = ")[-1].split(" s")[0])
    assert ea.CompositeController.for_robot(robot, dt=0.99 * offered).gains is not None


def test_a_massless_wrist_is_refused_by_name():
    """A last link of a microgram swings faster than 1 kHz can follow."""
    robot = load("panda")
    model = robot.model.copy()
    body = model.inertias[7]
    model.inertias[7] = type(body)(1e-6 * body.mass, body.lever, 1e-6 * body.inertia)
    with pytest.raises(ArgumentError, match=r"no stable gains.*'panda_joint7'"):
        ea.CompositeController.for_robot(dataclasses.replace(robot, model=model))


def written(path, *changes: tuple[str, str]):
    """The two-link URDF with texts replaced, as a file of its own."""
    text = (folder() / "two_link.urdf").read_text()
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = path / "arm.urdf"
    path.write_text(text)
    return path


def test_a_urdf_file_with_a_massless_wrist_is_refused_by_name(tmp_path):
    """A forearm of a microgram whose centre of mass is off its axis: no step of 1 ms follows its fall."""
    inertia = 'ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{1}"'
    path = written(
        tmp_path, ('<mass value="1"/>', '<mass value="1e-9"/>'),
        (inertia.format("0.0033333333333333335", "0.0001125"), inertia.format("3e-14", "1e-14")),
        ('<origin xyz="0 0 -0.1"/>\n      <mass', '<origin xyz="0 0 -0.00001"/>\n      <mass'),
    )  # fmt: skip
    with pytest.raises(ArgumentError, match=r"no stable gains at dt = 0.001 s.*joint 'elbow'.*would do"):
        ea.CompositeController.for_robot(ea.Robot.from_urdf(path))


def test_a_urdf_file_and_a_step_too_long(tmp_path):
    """The dt offered is taken, and one a tenth longer is not."""
    robot = ea.Robot.from_urdf(written(tmp_path))
    with pytest.raises(ArgumentError, match=r"no stable gains at dt = 0.2 s.*joint '\w+'") as caught:
        ea.CompositeController.for_robot(robot, dt=0.2)
    offered = float(str(caught.value).split("dt = ")[-1].split(" s")[0])
    assert ea.CompositeController.for_robot(robot, dt=0.99 * offered).gains is not None
    with pytest.raises(ArgumentError, match="no stable gains"):
        ea.CompositeController.for_robot(robot, dt=1.1 * offered)


def test_gamma_gives_way_to_sampling():
    """Where a step would turn more than RESOLVED of the adaptation's swing, Gamma is what gives."""
    reg = ea.Regressors(load("so_arm101"))
    fast, slow = derive_gains(reg, 1e-3), derive_gains(reg, 1e-2)
    assert fast.Gamma == 0.2
    assert slow.Gamma < 0.2
    assert adaptation_mode(reg, slow.Gamma).frequency * 1e-2 == pytest.approx(RESOLVED, rel=1e-9)
    assert "sampling" in str(slow)


def test_fall_mode_of_a_pendulum():
    """One joint: omega^2 = dg/dq / M at the bottom, the pendulum's own frequency."""
    robot = load("two_link")
    one = fall_mode(robot, samples=2000)
    q = np.zeros(2)
    jacobian = np.array([[0.981 + 5.886, 0.981], [0.981, 0.981]])
    bottom = np.sqrt(np.linalg.eigvals(np.linalg.solve(robot.mass_matrix(q), jacobian)).max())
    assert one.frequency >= 0.9 * bottom


def test_zeros_that_mean_something_are_taken():
    """No rotor believed, no linear damping, no floor, no tolerance."""
    zeros = dict.fromkeys(("rotors", "D_L", "floor", "tolerance"), 0.0)
    gains = ea.CompositeController.for_robot(load("two_link"), **zeros).gains
    assert not any(np.any(getattr(gains, name)) for name in zeros)


def test_the_weight_of_rows_is_no_limit_of_torque():
    """However rows are weighted, a disturbance is believed up to half of the effort limit."""
    robot, make = load("two_link"), ea.CompositeController.for_robot
    default, weighted = make(robot), make(robot, row_weight=1.0)
    np.testing.assert_array_equal(weighted.disturbance.limit, default.disturbance.limit)
