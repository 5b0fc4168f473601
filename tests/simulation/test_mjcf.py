"""Another's MuJoCo model of the same arm is a plant: its dynamics act, and the load hangs where it should."""

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError

pytest.importorskip("mujoco")

DT = 1e-3
OUTSIDE = Path(__file__).resolve().parents[3] / "shared"  # beside the repository
# The two-link arm of the library by another author: moved, the forearm's frame laid along the rod; a servo, a
# stop and a floor that are not to act.
MJCF = """<mujoco model="other">
  <option gravity="0 0 -9.81" timestep="0.01" integrator="Euler"/>
  <worldbody>
    <geom type="plane" size="1 1 1" pos="0 0 0.5"/>
    <body name="one" pos="1 2 0.6">
      <inertial pos="0 0 -0.15" mass="2" diaginertia="0.015 0.015 0.0004"/>
      <joint {first} axis="0 1 0" damping="{damping}" armature="{armature}" range="-1 1" limited="true"/>
      <geom size="0.3"/>
      <body pos="0 0 -0.3" quat="1 0 1 0">
        <inertial pos="0.1 0 0" mass="1" diaginertia="0.0002 0.00333333333333 0.00333333333333"/>
        <joint {second} axis="0 1 0" damping="{damping}" armature="{armature}" frictionloss="{dry}"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="{target}" kp="100"/></actuator>
</mujoco>"""
NAMED = {"first": 'name="shoulder"', "second": 'name="elbow"', "target": "shoulder"}


def mjcf(damping=0.0, armature=0.0, dry=0.0, **names):
    return MJCF.format(damping=damping, armature=armature, dry=dry, **{**NAMED, **names})


def worst(plant, robot, rng, payload=None):
    """The largest differences of M and of C v + g from the robot's, over random states."""
    model = robot.model if payload is None else payload.loaded(robot)
    data, found = model.createData(), np.zeros(2)
    for _ in range(20):
        q, v = robot.random_configuration(rng), rng.normal(size=robot.nv)
        found[0] = max(found[0], np.abs(plant.mass_matrix(q) - pin.crba(model, data, q)).max())
        found[1] = max(found[1], np.abs(plant.bias(q, v) - pin.rnea(model, data, q, v, 0 * v)).max())
    return found


@pytest.mark.parametrize("payload", [None, ea.Payload(0.7, (0.01, 0.02, -0.03))])
@pytest.mark.parametrize("names", [{}, {"first": 'name="j1"', "second": 'name="j2"', "target": "j1"}])
def test_the_same_arm_in_other_frames_has_the_same_dynamics(payload, names, rng):
    """Base, bodies and names are another's; M, C v + g and a load at the tool are the robot's to 1e-11."""
    robot = load("two_link")
    plant = ea.MujocoPlant(robot, [0.3, 0.4], mjcf=mjcf(**names), payload=payload)
    assert worst(plant, robot, rng, payload).max() < 1e-11  # the file has twelve digits of the moments


def test_its_joints_are_found_by_name_before_order(rng):
    """One name that agrees leaves the other joint to the order; both names, exchanged, are another arm."""
    robot = load("two_link")
    one = mjcf(first='name="j1"', target="j1")
    assert worst(ea.MujocoPlant(robot, [0.0, 0.0], mjcf=one), robot, rng).max() < 1e-11
    turned = mjcf(first='name="elbow"', second='name="shoulder"')
    assert worst(ea.MujocoPlant(robot, [0.0, 0.0], mjcf=turned), robot, rng).max() > 0.01


def test_its_friction_and_rotors_act_and_nothing_else():
    """Motion is that of the robot with the same rotors and friction: no servo, stop or floor."""
    text = mjcf(damping=0.2, armature=0.05, dry=0.1)
    robot = ea.Robot.from_urdf(load("two_link").path, armature={"shoulder": 0.05, "elbow": 0.05})
    v0 = np.array([6.0, -3.0])
    plant = ea.MujocoPlant(robot, [0.5, 0.2], v0, ea.Friction(0.1), mjcf=text)
    other = ea.PinocchioPlant(robot, [0.5, 0.2], v0, ea.Friction(0.3, [0.0, 0.1]))
    furthest = 0.0
    for _ in range(500):
        furthest = max(furthest, plant.step(np.zeros(2), DT).q[0])
        other.step(np.zeros(2), DT)
    assert furthest > 1.0  # beyond the stop
    # Dry friction makes both of first order: each is off by its substep of 0.5 ms times the jump at v = 0.
    assert np.abs(plant.q - other.q).max() < 1e-4
    free = ea.MujocoPlant(robot, [0.5, 0.2], v0, mjcf=text, joint_friction=False)
    other = ea.PinocchioPlant(robot, [0.5, 0.2], v0)
    for _ in range(200):
        free.step(np.zeros(2), DT)
        other.step(np.zeros(2), DT)
    assert np.abs(free.q - other.q).max() < 1e-9


@pytest.mark.parametrize("given", [0.3, [0.1, 0.2]])
@pytest.mark.parametrize("text", [None, mjcf(armature=0.05)])
def test_rotors_can_be_put_in_place_of_the_models(given, text, rng):
    """M is the arm's without rotors and diag(armature), of the URDF as of another's model, loaded or not."""
    robot, payload = load("two_link"), ea.Payload(0.5)
    for load_ in (None, payload):
        plant = ea.MujocoPlant(robot, [0.0, 0.0], mjcf=text, armature=given, payload=load_)
        bare = ea.MujocoPlant(robot, [0.0, 0.0], payload=load_)
        q = robot.random_configuration(rng)
        expected = bare.mass_matrix(q) + np.diag(np.broadcast_to(given, 2))
        assert np.abs(plant.mass_matrix(q) - expected).max() < 1e-11  # as above
    assert not plant.knows_parameters


def test_a_plant_says_whether_the_robots_parameters_are_the_true_ones():
    robot = load("two_link")
    known = ea.MujocoPlant(robot, [0.0, 0.0]), ea.PinocchioPlant(robot, [0.0, 0.0])
    assert all(plant.knows_parameters for plant in known)
    plant = ea.MujocoPlant(robot, [0.0, 0.0], mjcf=mjcf())
    assert not plant.knows_parameters
    assert plant.mjcf == mjcf()


def test_a_file_is_read_as_its_text_is(tmp_path):
    path = tmp_path / "other.xml"
    path.write_text(mjcf(damping=0.2))
    robot = load("two_link")
    plants = [ea.MujocoPlant(robot, [0.5, 0.2], mjcf=given) for given in (path, str(path), path.read_text())]
    ends = [[plant.step(np.ones(2), DT).q for _ in range(5)][-1] for plant in plants]
    assert np.array_equal(ends[0], ends[1])
    assert np.array_equal(ends[0], ends[2])
    assert [file.name for file in tmp_path.iterdir()] == ["other.xml"]


THREE = mjcf().replace(
    "</body>\n    </body>", '<body><joint name="grip"/><geom size="1"/></body></body></body>'
)
REFUSED = {
    "missing": ("nowhere.xml", "nowhere.xml does not exist; expected the path of an MJCF file"),
    "a folder": (".", "is not a file"),
    "not XML": ("<mujoco><body", "MuJoCo does not load the MJCF text: "),
    "not MJCF": (mjcf().replace("worldbody", "world"), "MuJoCo does not load the MJCF text: .*world"),
    "impossible": (mjcf().replace('mass="1"', 'mass="0"'), "MuJoCo does not load the MJCF text: "),
    "more joints": (
        THREE,
        r"has 3 joints \(shoulder, elbow, grip\), expected the robot's 2 \(shoulder, elbow",
    ),
    "no joints": ("<mujoco/>", r"has 0 joints \(none\), expected the robot's 2"),
    "another kind": (mjcf(second='name="elbow" type="slide"'), "joint 'elbow' .* expected a hinge"),
}


@pytest.mark.parametrize(("given", "said"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_no_model_of_the_arm_is_refused(given, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArgumentError, match=f"^mjcf: .*{said}"):
        ea.MujocoPlant(load("two_link"), [0.0, 0.0], mjcf=given)
    assert not list(tmp_path.iterdir())


def test_a_load_needs_models_that_count_alike():
    """A joint that turns the other way round is noticed where it matters: where a load would hang."""
    text = mjcf().replace(
        'axis="0 1 0" damping="0.0" armature="0.0" frictionloss', 'axis="0 -1 0" frictionloss'
    )
    ea.MujocoPlant(load("two_link"), [0.0, 0.0], mjcf=text)
    with pytest.raises(ArgumentError, match=r"mjcf: a load .* would move by 0\.\d+ m .* zero positions"):
        ea.MujocoPlant(load("two_link"), [0.0, 0.0], mjcf=text, payload=1.0)


@pytest.mark.parametrize("bad", [-0.1, np.nan, [0.1, 0.2, 0.3]])
def test_impossible_rotors_are_refused(bad):
    with pytest.raises(ArgumentError, match="armature: expected"):
        ea.MujocoPlant(load("two_link"), [0.0, 0.0], armature=bad)


@pytest.mark.parametrize(("name", "torque"), [("panda", 1e-9), ("ur5e", 0.02)])
def test_a_load_hangs_on_others_arms_as_on_the_robot(name, torque, rng):
    """What 2 kg at the tool add to gravity is the same.

    On Menagerie's Panda to rounding, whose frames are the URDF's; on its UR5e, with other frames and links
    that differ by 1 mm, to 2 kg times that.
    """
    path = OUTSIDE / "plants" / f"{name}_menagerie.xml"
    if not path.is_file():
        pytest.skip(f"needs another's model of the arm at {path}")
    robot = load(name) if name == "panda" else ea.Robot.from_urdf(OUTSIDE / "arms" / f"{name}.urdf")
    q0 = robot.configuration(robot.home)
    bare, carrying = (ea.MujocoPlant(robot, q0, mjcf=path, payload=load_) for load_ in (None, 2.0))
    loaded = dataclasses.replace(robot, model=ea.Payload(2.0).loaded(robot))
    for _ in range(20):
        q = robot.random_configuration(rng)
        added = carrying.bias(q, 0 * robot.still) - bare.bias(q, 0 * robot.still)
        assert np.abs(added - (loaded.gravity(q) - robot.gravity(q))).max() < torque
    measurement = carrying.step(robot.gravity(q0), DT)
    assert np.isfinite(measurement.q).all()


def test_a_plant_of_anothers_model_says_so():
    plant = ea.MujocoPlant(load("two_link"), [0.0, 0.0], mjcf=mjcf(), payload=1.0)
    assert repr(plant) == "MujocoPlant('two_link', t = 0 s, dynamics of another's MJCF, 1 kg at 'tip')"
