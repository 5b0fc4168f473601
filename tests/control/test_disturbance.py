"""What holds the arm and is in no model is fed forward, and costs nothing where nothing does."""

import dataclasses

import numpy as np
import pytest
from shared import load

import eladapt as ea
from eladapt.control.disturbance import CREEPING, DisturbanceEstimate, unexplained
from eladapt.errors import ArgumentError

DT = 1e-3


def move(controller: ea.CompositeController, duration: float, dt: float = DT, **unknown) -> ea.Record:
    """Home to target from the URDF's theta, and what else there is unknown."""
    robot = controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), **unknown)
    goal = robot.configuration(robot.target)
    return ea.simulate(controller, plant, goal, duration, dt, theta0="urdf", progress=False)


def explicit(controller: ea.CompositeController) -> ea.CompositeController:
    law = dataclasses.replace(controller.control, evaluation="explicit")
    return dataclasses.replace(controller, control=law, disturbance=None)


def unasked() -> np.ndarray:
    """The friction where d is within its limits without it."""
    raise AssertionError("asked for friction although d is within its limits")


def test_a_constant_push_is_found_with_the_memory_as_time_constant():
    """After one memory 63 % of it, after ten all, whatever the step."""
    push, moving = np.array([1.0, -3.0]), np.array([0.2, -0.2])
    for dt in (1e-3, 1e-2):
        block = DisturbanceEstimate(10.0, memory=0.1)
        d = block.init(2)
        for k in range(1, round(1 / dt) + 1):
            d = block.step(d, push, unasked, np.ones(2), moving + 1.0, moving, dt)
            if k == round(0.1 / dt):
                np.testing.assert_allclose(d, (1 - np.exp(-1)) * push, rtol=1e-12)
        np.testing.assert_allclose(d, push, rtol=1e-4)  # e^-10


def test_a_joint_that_has_arrived_keeps_what_holds_it():
    """Still, slow and within the tolerance, a joint's d stands; each condition alone does not do."""
    block = DisturbanceEstimate(10.0, tolerance=1e-4, slow=1e-3)
    d, residual = np.full(4, 2.0), np.zeros(4)
    e1, v = np.array([5e-5, 5e-4, 5e-5, 5e-5]), np.array([5e-4, 5e-4, 5e-3, 5e-4])
    e2 = v + np.array([0.0, 0.0, 0.0, 1e-3])
    kept = block.step(d, residual, unasked, e1, e2, v, DT)
    assert kept[0] == 2.0
    assert np.all(kept[1:] < 2.0)


def test_a_fast_joint_is_not_thrown():
    """A joint that creeps may wind up to its limit, a fast one to what its inertia can take."""
    block = DisturbanceEstimate(10.0, moving=0.5)
    v = np.array([0.5 * CREEPING, 2 * CREEPING])
    d = block.step(np.zeros(2), np.full(2, 1e3), lambda: np.zeros(2), np.ones(2), v + 1.0, v, 1.0)
    np.testing.assert_array_equal(d, [10.0, 0.5])


def test_known_friction_is_overcome_and_no_more():
    """Beyond its limit a fast joint's d may reach as far as the friction against it, not that behind it."""
    block = DisturbanceEstimate(10.0, moving=0.5)
    v, friction = np.array([2.0, -2.0]) * CREEPING, np.array([3.0, -3.0])
    for push, expected in ((1e3, [3.5, 0.5]), (-1e3, [-0.5, -3.5])):
        d = block.step(np.zeros(2), np.full(2, push), lambda: friction, np.ones(2), v + 1.0, v, 1.0)
        np.testing.assert_array_equal(d, expected)


def test_friction_that_helps_is_left_to_help():
    """On an arm whose theta is right, what is left unexplained is the friction at v beside that at v_d: in a
    joint on its way to the reference or too slow to tell, and in one whose friction would push. Nothing is in
    one that leaves its reference against friction."""
    reg = ea.Regressors(load("ur5"), joint_terms=("viscous", "coulomb", "offset"))
    robot, rng = reg.robot, np.random.default_rng(0)
    theta, q = rng.normal(size=len(reg)), robot.random_configuration(rng)
    theta[reg.friction] = np.abs(theta[reg.friction])
    theta[reg.block("viscous")][0] *= -10
    v, v_d = np.array([1.0, 1.0, 1.0, -1.0, -1.0, 1e-3]), np.array([0.5, 0.5, 2.0, -0.5, -0.5, -1.0])
    a, a_d = rng.normal(size=(2, robot.nv))
    e1, e2 = np.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0]), v - v_d
    moved, wanted = reg.torque(q, v, a), reg.slotine_li(q, v, v_d, a_d)
    friction, offset = reg.friction, reg.block("offset").start
    residual, rows = unexplained(
        moved @ theta, moved, wanted, theta, e1, e2, v, 0.01, friction.start, offset, friction.stop
    )
    more = (moved - wanted)[:, friction] @ theta[friction]
    leaves = np.array([False, False, True, False, True, False])
    np.testing.assert_allclose(residual, np.where(leaves, 0, more), atol=1e-12)
    both = theta.copy()
    both[offset : friction.stop] = 0  # the rows' offsets stand as they are
    np.testing.assert_allclose(rows @ both, more, atol=1e-12)


@pytest.mark.parametrize("viscous", [0.0, 15.0])
def test_a_motion_is_followed_while_friction_is_being_learned(viscous):
    """A UR5 with rotors of 0.1 kg m^2 and 15 N m s/rad that nobody told: within the first second of smooth
    sines no joint is 0.01 rad off, at 0.02 rad of one that nothing learned would follow."""
    robot = load("ur5")
    plant = ea.MujocoPlant(
        robot, robot.configuration(robot.home), armature=0.1, friction=ea.Friction(viscous=viscous)
    )

    def sines(t: float) -> ea.Reference:
        w, u = 2.0, min(t, 1.0)
        b, b1, b2 = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
        s, s1, s2 = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
        one = 0.25 * np.ones(robot.nv)
        q = robot.configuration(robot.home + one * b * s)
        return ea.Reference(q, one * (b1 * s + b * s1), one * (b2 * s + 2 * b1 * s1 + b * s2))

    record = ea.simulate(ea.CompositeController.for_robot(robot), plant, sines, 1.0, progress=False)
    assert np.abs(record.error).max() < 0.01


def test_friction_is_overcome():
    """Stuck by 1 N m, every joint of the ur5 comes within 1e-5 rad (twice what it is left alone within);
    without the estimate the wrists stay behind by a thousandth of a radian and more."""
    controller = ea.CompositeController.for_robot(load("ur5"))
    friction = ea.Friction(coulomb=1.0)
    blind = dataclasses.replace(controller, disturbance=None)
    assert np.all(np.abs(move(controller, 3.0, friction=friction).error[-1]) <= 1e-5)
    assert np.abs(move(blind, 3.0, friction=friction).error[-1]).max() > 1e-3


def test_it_costs_nothing_where_the_model_is_right():
    """Arrival within 1e-9 rad, without ripple, on the paper's arm at the paper's step."""
    controller = ea.CompositeController.for_robot(load("two_link"), 5e-4)
    metrics = move(controller, 4.0, 5e-4).metrics()
    assert metrics.steady_error < 1e-9
    assert metrics.chatter < 1e-6, "the paper: 0.015 N m"


@pytest.mark.slow
@pytest.mark.parametrize(
    "unknown", [{}, {"payload": 2.0}, {"noise": ea.Noise(1e-4, 1e-3)}], ids=["nothing", "2 kg", "noise"]
)
def test_panda_against_explicit_evaluation(unknown):
    """At 1 kHz: a hundredth of the ripple at most, or with noise 0.6 of the torque's deviation, and no larger
    an error, though neither the load nor the noise is told."""
    controller = ea.CompositeController.for_robot(load("panda"))
    ours, theirs = move(controller, 3.0, **unknown), move(explicit(controller), 3.0, **unknown)
    last = ours.t > 2
    assert ours.metrics().steady_error <= theirs.metrics().steady_error
    if "noise" in unknown:
        assert ours.tau[last].std(axis=0).max() <= 0.6 * theirs.tau[last].std(axis=0).max()
    else:
        assert np.ptp(ours.tau[last], axis=0).max() <= 1e-2 * np.ptp(theirs.tau[last], axis=0).max()


def test_memory_follows_the_horizon():
    """Twice the horizon, which noise and delay lengthen, and at least 10 ms."""
    late = ea.CompositeController.for_robot(load("panda"), delay=5e-3)
    np.testing.assert_array_equal(late.disturbance.memory, 2 * late.control.horizon)
    np.testing.assert_array_equal(ea.CompositeController.for_robot(load("panda")).disturbance.memory, 0.01)


@pytest.mark.parametrize(
    ("options", "said"),
    [({"limit": -1}, "limit"), ({"limit": 1, "memory": 0}, "memory"), ({"limit": 1, "moving": 0}, "moving"),
     ({"limit": 1, "tolerance": np.nan}, "tolerance"), ({"limit": 1, "slow": -1}, "slow")],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(options, said):
    with pytest.raises(ArgumentError, match=said):
        DisturbanceEstimate(**options)
