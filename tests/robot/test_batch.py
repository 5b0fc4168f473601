"""Positions and filtered torque regressors of many robots at once, against Pinocchio's of each."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from shared import ROBOTS, TREE, load, regressors

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.robot.batch import Path, Positions

MANY, POINTS, DT = 11, 2, 0.2  # more than a group of the kernel, and no multiple of it; long steps
ROUNDING = 1e-12  # of the largest entry; observed 2e-13 (kinova, whose angles Pinocchio turns to matrices)


@pytest.fixture
def tree(tmp_path) -> ea.Robot:
    path = tmp_path / "tree.urdf"
    path.write_text(TREE)
    return ea.Robot.from_urdf(path, armature={"z": 0.3, "p": 0.7})


def states(robot: ea.Robot, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    q = [[robot.random_configuration(rng) for _ in range(POINTS)] for _ in range(MANY)]
    return np.array(q), *rng.normal(size=(2, MANY, POINTS, robot.nv))


def require_alike(reg: ea.Regressors, interpolation: str, rng: np.random.Generator) -> None:
    """Two steps of a batch of force balances, from one random state to the next, as one by one."""
    q, v, tau = states(reg.robot, rng)
    weight = rng.uniform(0.5, 2, size=reg.robot.nv)
    balance = ea.ForceBalance(reg, weight=weight, interpolation=interpolation, stiction_speed=0.0)
    samples = [ea.Measurement(DT * k, q[:, k % 2], v[:, k % 2], tau[:, k % 2]) for k in range(3)]
    expected = []
    for b in range(MANY):
        first, *others = (ea.Measurement(t, *(array[b] for array in arrays)) for t, *arrays in samples)
        filters = balance.init(first)
        for sample in others:
            filters, found = balance.step(filters, sample, DT)
        expected.append(found)
    for compiled in (False, True):
        many = dataclasses.replace(balance, compiled=compiled)
        filters = many.init(samples[0])
        for sample in samples[1:]:
            filters, found = many.step(filters, sample, DT)
        for one, all_of_them in zip(zip(*expected, strict=True), found, strict=True):
            largest = np.abs(one).max()
            np.testing.assert_allclose(all_of_them, one, rtol=0, atol=ROUNDING * largest)


@pytest.mark.parametrize("friction", [False, True], ids=["rigid", "friction"])
@pytest.mark.parametrize("sharing", ["shared", "independent"])
@pytest.mark.parametrize("name", ROBOTS)
def test_force_balances_of_a_batch_are_those_of_each(name, sharing, friction, rng):
    require_alike(regressors(name, sharing, friction), "linear", rng)


def test_continuous_joints_may_be_a_little_off_the_circle(rng):
    """As far as a measurement may be: the way back to it is Pinocchio's, and both ways of a batch agree."""
    robot, reg = load("kinova"), regressors("kinova")
    q, v, _ = states(robot, rng)
    q[..., np.repeat(reg.positions.continuous, reg.positions.continuous + 1)] *= 1 + 4e-7
    moved = reg.positions.integrate(q[:, 0], v[:, 0])
    expected = [pin.integrate(robot.model, *pair) for pair in zip(q[:, 0], v[:, 0], strict=True)]
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-12)
    found = []
    for compiled in (False, True):
        balance = ea.ForceBalance(reg, compiled=compiled)
        first, second = (ea.Measurement(DT * k, q[:, k], v[:, k], v[:, k]) for k in range(2))
        found.append(balance.step(balance.init(first), second, DT)[1].omega)
    np.testing.assert_allclose(*found, rtol=0, atol=ROUNDING * np.abs(found[0]).max())


@pytest.mark.parametrize("interpolation", ["linear", "hermite"])
@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_they_are_on_a_branched_tree_with_joints_of_every_kind(tree, sharing, interpolation, rng):
    """Axes off the frames' own, sliding and continuous joints, rotors, two branches."""
    require_alike(ea.Regressors(tree, sharing), interpolation, rng)


def test_friction_columns_are_not_left_out_without_a_word():
    reg = regressors("two_link", "shared", True)
    still = np.zeros((1, 2))
    path = Path(still, still, still, still, DT, np.array([0.5]), False)
    with pytest.raises(ArgumentError, match="without friction columns"):
        reg.filtered_torque(np.zeros((1, 2, len(reg))), 1.0, np.ones(2), path)


def test_they_are_in_parameters_of_ones_own(rng):
    robot = load("two_link")
    require_alike(ea.Regressors(robot, basis=ea.paper.basis(robot)), "hermite", rng)


@pytest.mark.parametrize("name", [*ROBOTS, "tree"])
def test_differences_and_sums_of_positions_are_pinocchios(name, tree, rng):
    robot = tree if name == "tree" else load(name)
    positions = Positions(robot.model)
    q, dq, _ = states(robot, rng)
    model = robot.model
    apart = [pin.difference(model, *pair) for pair in q]
    np.testing.assert_allclose(positions.difference(q[:, 0], q[:, 1]), apart, rtol=0, atol=1e-13)
    moved = [
        [pin.integrate(model, *pair) for pair in zip(*path, strict=True)]
        for path in zip(q, dq, strict=True)
    ]  # fmt: skip
    np.testing.assert_allclose(positions.integrate(q, dq), moved, rtol=0, atol=1e-14)
    together = positions.integrate(q[:, :1], dq)
    np.testing.assert_allclose(together[:, 1], positions.integrate(q[:, 0], dq[:, 1]), rtol=0, atol=1e-15)
