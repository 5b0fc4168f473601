"""A second simulator, written elsewhere, agrees with the first; and tells friction and loads alike."""

import dataclasses
import importlib
import sys

import numpy as np
import pytest
from shared import TREE, joint, link, load

import eladapt as ea
from eladapt.errors import ArgumentError, EladaptError, SimulationError, UnknownNameError, UrdfError
from eladapt.robot import library

DT = 1e-3
LOAD = ea.Payload(2.0, (0.03, -0.02, 0.1))


@pytest.fixture
def mujoco_plant():
    """The class, where MuJoCo is installed."""
    pytest.importorskip("mujoco")
    from eladapt.simulation.mujoco_plant import MujocoPlant

    return MujocoPlant


def disagreement(plant, robot, rng, count=100):
    """Largest relative difference of M, and of C v + g, over random states."""
    worst = np.zeros(2)
    scale = 0.0
    for _ in range(count):
        q, v = robot.random_configuration(rng), rng.normal(size=robot.nv)
        mass_matrix, bias = robot.mass_matrix(q), robot.inverse_dynamics(q, v, 0 * v)
        scale = max(scale, np.abs(bias).max())
        worst[0] = max(worst[0], np.abs(plant.mass_matrix(q) - mass_matrix).max() / np.abs(mass_matrix).max())
        worst[1] = max(worst[1], np.abs(plant.bias(q, v) - bias).max())
    return worst / (1, scale)


@pytest.mark.parametrize("name", library.robots())
def test_both_engines_have_the_same_dynamics(name, mujoco_plant, rng):
    """M and C v + g agree to 1e-12 at 100 random states, without a load and with one at the tool."""
    robot = load(name)
    home = robot.configuration(robot.home)
    assert disagreement(mujoco_plant(robot, home), robot, rng).max() < 1e-12
    loaded = dataclasses.replace(robot, model=LOAD.loaded(robot))
    assert disagreement(mujoco_plant(robot, home, payload=LOAD), loaded, rng).max() < 1e-12


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "talos_left_arm", "double_pendulum"])
def test_free_motion_agrees(name, mujoco_plant, rng):
    """Half a second of fast motion ends at the same place to 1e-7, with twice the substeps to 1e-8."""
    robot = load(name)
    q0, v0 = robot.configuration(robot.home), rng.normal(size=robot.nv)
    reference = ea.PinocchioPlant(robot, q0, v0, substeps=16)
    plants = [mujoco_plant(robot, q0, v0, substeps=n, joint_friction=False) for n in (2, 4)]
    for k in range(500):
        tau = robot.gravity(q0) * np.cos(0.01 * k)
        for plant in (reference, *plants):
            measurement = plant.step(tau, DT)
    coarse, fine = (np.abs(robot.difference(reference.q, plant.q)).max() for plant in plants)
    assert coarse < 1e-7
    assert fine < max(coarse / 10, 1e-10)
    assert np.array_equal(measurement.tau, tau)
    assert measurement.t == pytest.approx(0.5)


def test_the_urdf_damping_acts_unless_told_not_to(mujoco_plant):
    """With the URDF's damping given to the other plant, both move alike; the caller's is added."""
    robot = load("double_pendulum")
    q0, v0 = robot.configuration([0.5, 0.2]), np.array([3.0, -2.0])
    more = np.array([0.01, 0.02])
    for options, viscous in (
        ({}, robot.damping),
        ({"joint_friction": False}, 0.0),
        ({"friction": ea.Friction(viscous=more)}, robot.damping + more),
    ):
        plant = mujoco_plant(robot, q0, v0, **options)
        other = ea.PinocchioPlant(robot, q0, v0, friction=ea.Friction(viscous))
        for _ in range(300):
            plant.step(np.zeros(2), DT)
            other.step(np.zeros(2), DT)
        assert np.abs(robot.difference(plant.q, other.q)).max() < 1e-9


@pytest.mark.parametrize("integrator", ["rk4", "implicitfast"])
def test_coulomb_friction_sticks_and_then_gives_way(integrator, mujoco_plant):
    """An arm pushed with 99 % of its friction does not creep; with 101 %, it moves as in PinocchioPlant."""
    robot = load("panda")
    q0 = robot.configuration(robot.home)
    for push in (0.99, 1.01):
        friction, tau = ea.Friction(coulomb=1.0), robot.gravity(q0) + push * np.eye(7)[6]
        plant = mujoco_plant(robot, q0, friction=friction, integrator=integrator, joint_friction=False)
        other = ea.PinocchioPlant(robot, q0, friction=friction)
        for _ in range(200):
            plant.step(tau, DT)
            other.step(tau, DT)
        if push < 1:
            assert np.abs(plant.q - q0).max() < 1e-9
        else:
            assert plant.q[6] - q0[6] == pytest.approx(other.q[6] - q0[6], rel=5e-3)


def test_friction_of_the_urdf_holds_xarm7(mujoco_plant):
    """Its 1 N m of joint friction carries half a newton metre a joint, for any step that is asked for."""
    robot = load("xarm7")
    q0 = robot.configuration(robot.home)
    plant = mujoco_plant(robot, q0)
    for dt in (1e-3, 2e-3, 5e-4):
        for _ in range(50):
            plant.step(robot.gravity(q0) + 0.5, dt)
    assert np.abs(plant.q - q0).max() < 1e-9


def test_the_integrator_fits_the_damping(mujoco_plant):
    """RK4 with the substeps that its stability asks for; implicit where that would be more than 16."""
    light, stiff = load("panda"), load("xarm7")
    at = [robot.configuration(robot.home) for robot in (light, stiff)]
    assert mujoco_plant(light, at[0]).scheme(DT) == ("rk4", 2)
    assert mujoco_plant(stiff, at[1]).scheme(DT) == ("rk4", 8)
    assert mujoco_plant(stiff, at[1], substeps=2).scheme(DT) == ("implicitfast", 2)
    heavy = mujoco_plant(stiff, at[1], np.ones(7), friction=ea.Friction(viscous=50.0))
    assert heavy.scheme(DT) == ("implicitfast", 16)
    for _ in range(100):
        heavy.step(stiff.gravity(at[1]), DT)
    assert np.abs(heavy.v).max() < 1e-2


def test_joint_limits_are_no_walls(mujoco_plant, tmp_path, monkeypatch):
    """A joint that runs past its limit goes on as in PinocchioPlant; limits of 0 are not remarked on."""
    monkeypatch.chdir(tmp_path)
    robot = load("panda")
    x = robot.home.copy()
    x[0] = robot.upper[0] - 0.01
    plant = mujoco_plant(robot, x, np.eye(7)[0], joint_friction=False)
    other = ea.PinocchioPlant(robot, x, np.eye(7)[0])
    for _ in range(100):
        plant.step(robot.gravity(x), DT)
        other.step(robot.gravity(x), DT)
    assert plant.q[0] > robot.upper[0] + 0.01
    assert np.abs(plant.q - other.q).max() < 1e-9
    mujoco_plant(load("double_pendulum"), [0.0, 0.0])
    assert not list(tmp_path.iterdir())


def test_a_load_comes_and_goes(mujoco_plant):
    """Attached at 0.1 s and released at 0.2 s, it moves the arm as it does in PinocchioPlant."""
    robot = load("panda")
    q0 = robot.configuration(robot.home)
    load_ = dataclasses.replace(LOAD, frame="panda_hand", attach=0.1, release=0.2)
    plant, other = (
        make(robot, q0, payload=load_, **options)
        for make, options in ((mujoco_plant, {"joint_friction": False}), (ea.PinocchioPlant, {}))
    )
    moved = []
    for _ in range(300):
        for each in (plant, other):
            each.step(robot.gravity(q0), DT)
        moved.append(np.abs(plant.q - q0).max())
    assert moved[99] < 1e-9 < 1e-3 < moved[199]
    assert np.abs(plant.q - other.q).max() < 1e-9
    assert isinstance(mujoco_plant(robot, q0, payload=2).payload, ea.Payload)


def test_reset_repeats_the_run_and_noise_is_the_same(mujoco_plant):
    robot = load("kinova")
    q0, noise = robot.configuration(robot.home), ea.Noise(1e-3, 1e-2)
    plant = mujoco_plant(robot, q0, noise=noise, seed=3, friction=ea.Friction(coulomb=0.5), payload=1.0)
    runs = []
    for _ in range(2):
        start = plant.reset()
        runs.append([start.q, *(plant.step(robot.gravity(q0), DT).q for _ in range(50))])
    assert np.array_equal(*runs)
    assert np.array_equal(runs[0][0], ea.PinocchioPlant(robot, q0, noise=noise, seed=3).reset().q)
    robot.check_q(runs[0][-1])  # still on the circle for continuous joints


def test_the_controller_does_not_tell_the_plants_apart(mujoco_plant):
    """The same controller reaches the same set-point on it."""
    robot = load("two_link")
    plant = mujoco_plant(robot, robot.configuration(robot.home))
    controller = ea.CompositeController.for_robot(robot)
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 2.5, progress=False)
    assert np.abs(record.error[-1]).max() < 1e-3


def test_branches_and_locked_joints_are_matched_by_name(mujoco_plant, tmp_path, rng, monkeypatch):
    """Joints in another order than the file's, some locked away from zero; nothing is left behind."""
    path = tmp_path / "tree.urdf"
    path.write_text(TREE)
    monkeypatch.chdir(tmp_path)
    for locked in ((), ("k",), ("s", "z"), ("k", "s")):
        robot = ea.Robot.from_urdf(path, locked=locked)
        plant = mujoco_plant(robot, robot.configuration(np.zeros(robot.nv)))
        assert disagreement(plant, robot, rng, 20).max() < 1e-12
    assert [file.name for file in tmp_path.iterdir()] == ["tree.urdf"]


def test_divergence_is_an_error_without_a_log_file(mujoco_plant, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plant = mujoco_plant(load("two_link"), [0.0, 0.0])

    def push():
        for k in range(100):
            plant.step(np.full(2, 10.0**k), DT)

    with pytest.raises(SimulationError, match=r"two_link diverged before t = 0\.0"):
        push()
    assert not list(tmp_path.iterdir())


def test_what_mujoco_refuses_is_said(mujoco_plant, tmp_path):
    """It wants moments of inertia on every moving link, which a pendulum's bob does without."""
    path = tmp_path / "bob.urdf"
    path.write_text(
        f'<robot name="bob">{link("base")}{link("bob", 0)}{joint("j", "revolute", "base", "bob")}</robot>'
    )
    with pytest.raises(UrdfError, match=r"mass and inertia of moving bodies.*PinocchioPlant"):
        mujoco_plant(ea.Robot.from_urdf(path), [0.0])


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"q0": [0.0]}, ArgumentError, "q0: expected shape"),
        ({"v0": [0.0, np.nan]}, ArgumentError, "v0: expected finite"),
        ({"integrator": "euler"}, ArgumentError, "integrator: expected 'rk4', 'implicitfast'"),
        ({"substeps": 0}, ArgumentError, "substeps: expected at least 1"),
        ({"payload": -1.0}, ArgumentError, "mass"),
        ({"friction": ea.Friction(viscous=[1.0] * 3)}, ArgumentError, "viscous: expected a scalar or shape"),
        ({"payload": ea.Payload(1.0, frame="hand")}, UnknownNameError, "'hand'; legal names: .*tip"),
    ],
)
def test_bad_set_ups_are_refused(options, error, said, mujoco_plant):
    with pytest.raises(error, match=said):
        mujoco_plant(load("two_link"), **{"q0": [0.0, 0.0], **options})


def test_bad_torques_are_named(mujoco_plant):
    plant = mujoco_plant(load("two_link"), [0.0, 0.0])
    with pytest.raises(ArgumentError, match="tau: expected finite"):
        plant.step(np.array([np.nan, 0]), DT)
    with pytest.raises(ArgumentError, match="dt"):
        plant.step(np.zeros(2), -DT)


def test_without_mujoco_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.delitem(sys.modules, "eladapt.simulation.mujoco_plant", raising=False)
    with pytest.raises(EladaptError, match='pip install "mujoco>='):
        importlib.import_module("eladapt.simulation.mujoco_plant")
