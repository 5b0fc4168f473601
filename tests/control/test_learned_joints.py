"""What has been learned of rotors and viscous friction stands in the control law's M, once it is known."""

import dataclasses

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.control.learned_joints import VISCOUS_SHARE, LearnedJoints

HORIZON = 1.3e-3


def learned(name: str, changes: dict[str, float], seconds: float) -> tuple[LearnedJoints, np.ndarray]:
    """What is known after exact regressions of random motion, of an arm whose joints differ from the URDF's
    by ``changes`` of a joint term."""
    robot = load(name)
    controller = ea.CompositeController.for_robot(robot)
    reg, rng = controller.regressors, np.random.default_rng(0)
    theta = reg.theta.copy()
    for term, value in changes.items():
        if term == "rotor":
            more = np.zeros(reg.basis.projection.shape[1])
            more[-robot.nv :] = value
            theta[reg.inertial] += reg.scale[reg.inertial] * (reg.basis.projection @ more)
        else:
            theta[reg.block(term)] += value * reg.scale[reg.block(term)]
    information = controller.extension.init(len(reg))
    for _ in range(round(seconds / DT)):
        q, v, a = robot.random_configuration(rng), rng.normal(size=robot.nv), rng.normal(size=robot.nv)
        omega = controller.gains.row_weight[:, None] * reg.torque(q, v, a)
        information = controller.extension.step(information, ea.Regression(omega @ theta, omega), DT)
    joints = LearnedJoints(reg, 10.0, HORIZON)
    return joints, joints.inertia(theta, information, np.zeros(robot.nv), np.zeros(robot.nv))


@pytest.mark.parametrize("name", ["two_link", "ur5", "panda"])
def test_what_is_known_counts(name):
    """A rotor of 0.05 kg m^2 in every joint counts with half of it at least and never with more (a body that
    turns with it could be part of it), viscous friction with its share of c H, and nothing counts without
    either or before anything was seen."""
    viscous = VISCOUS_SHARE * HORIZON * 4.0
    np.testing.assert_allclose(learned(name, {"viscous": 4.0}, 0.3)[1], viscous, rtol=2e-2)  # a lower bound
    rotors = learned(name, {"rotor": 0.05}, 0.3)[1]
    assert np.all((rotors > 0.025) & (rotors < 0.0501))
    assert np.abs(learned(name, {}, 0.3)[1]).max() < 1e-5
    np.testing.assert_array_equal(learned(name, {"rotor": 0.05, "viscous": 4.0}, 0.0)[1], 0)


def test_a_joint_of_friction_alone_does_not_chatter():
    """15 N m s/rad on a wrist whose link is a ten-thousandth of a kg m^2: at rest the torque stands still.
    With all of c H in place of the share it swings by more than 0.1 N m."""
    robot = load("ur5")
    controller = ea.CompositeController.for_robot(robot)
    assert 2 / (2 + DT / controller.gains.horizon.min()) > VISCOUS_SHARE, "what the stable share is"
    plant = ea.PinocchioPlant(
        robot, robot.configuration(robot.home), friction=ea.Friction(viscous=15.0), substeps=20
    )
    goal = robot.configuration(robot.target)
    record = ea.simulate(controller, plant, goal, 4.0, progress=False)
    last = record.t > record.t[-1] - 0.5
    assert record.settling_time(1e-3) < 3
    assert np.ptp(record.tau[last], axis=0).max() < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("told", [True, False], ids=["told", "untold"])
def test_an_arm_that_rests_in_noise_keeps_what_it_learned(told):
    """2 kg that nobody told are learned in eight moves; after a minute of rest in noise of 1e-4 rad and 1e-3
    rad/s gravity in 50 random postures is right within 1 % of its largest torque."""
    robot, noise = load("panda"), ea.Noise(1e-4, 1e-3)
    known = {"position_noise": 1e-4, "velocity_noise": 1e-3} if told else {}
    controller = ea.CompositeController.for_robot(robot, DT, **known)
    load_ = ea.Payload(2.0, (0.0, 0.0, 0.05))
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=load_, noise=noise)
    rng = np.random.default_rng(0)
    goals = [robot.random_configuration(rng) for _ in range(8)]
    postures = [robot.random_configuration(rng) for _ in range(50)]
    measurement = plant.reset()
    state = controller.init(measurement)
    for k in range(92_000):
        state, tau = controller.step(state, measurement, goals[min(k // 4000, 7)], DT)
        measurement = plant.step(tau, DT)
    loaded = dataclasses.replace(robot, model=load_.loaded(robot))
    true = np.array([loaded.gravity(q) for q in postures])
    told_by_theta = np.array([controller.regressors.gravity(q) @ state.theta for q in postures])
    assert np.abs(told_by_theta - true).max() < 0.01 * np.abs(true).max()


def test_friction_that_is_believed_and_is_not_there_throws_no_joint():
    """xArm7's URDF has 2 N m s/rad and 1 N m on a wrist whose link is 1e-4 kg m^2, Pinocchio's plant none: a
    tenth of the arm's mass at the tool and sines of 0.25 rad throw no joint by more than 0.1 rad. With d
    bounded by the friction that is believed, and not by what is known, it was 100 rad."""
    robot = load("xarm7")
    mass = sum(body.mass for body in list(robot.model.inertias)[1:])
    x0 = robot.home + 0.1
    plant = ea.PinocchioPlant(robot, robot.configuration(x0), payload=0.1 * mass)

    def sines(t: float) -> ea.Reference:
        w, b = 2.0, min(t, 1.0) ** 2
        b1 = 2 * t if t < 1 else 0.0
        v = 0.25 * (b * w * np.cos(w * t) + b1 * np.sin(w * t)) * np.ones(robot.nv)
        q = robot.configuration(x0 + 0.25 * b * np.sin(w * t))
        return ea.Reference(q, v, np.zeros(robot.nv))

    record = ea.simulate(ea.CompositeController.for_robot(robot), plant, sines, 1.5, progress=False)
    assert np.abs(record.error).max() < 0.1
