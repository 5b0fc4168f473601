"""Torque regressors and positions of many states at once, against Pinocchio's of each."""

import numpy as np
import pinocchio as pin
import pytest
from shared import ROBOTS, TREE, load, regressors

import eladapt as ea
from eladapt.robot.batch import Positions

MANY, POINTS = 11, 2  # more than a group of the kernel, and no multiple of it
ROUNDING = 1e-12  # of the largest entry; observed 2e-13 (kinova, whose angles Pinocchio turns to matrices)


@pytest.fixture
def tree(tmp_path) -> ea.Robot:
    path = tmp_path / "tree.urdf"
    path.write_text(TREE)
    return ea.Robot.from_urdf(path, armature={"z": 0.3, "p": 0.7})


def states(robot: ea.Robot, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    q = [[robot.random_configuration(rng) for _ in range(POINTS)] for _ in range(MANY)]
    return np.array(q), *rng.normal(size=(2, MANY, POINTS, robot.nv))


def require_alike(reg: ea.Regressors, rng: np.random.Generator) -> None:
    """rho omega + weight W, with W the mean of Pinocchio's regressors over each path."""
    robot = reg.robot
    q, v, a = states(robot, rng)
    omega, weight = rng.normal(size=(MANY, robot.nv, len(reg))), rng.uniform(0.5, 2, size=robot.nv)
    paths = zip(q, v, a, strict=True)
    mean = [np.mean([reg.torque(*state) for state in zip(*path, strict=True)], axis=0) for path in paths]
    expected = 0.9 * omega + weight[:, None] * mean
    for compiled in (False, True):
        found = reg.filtered_torque(omega, 0.9, weight, q, v, a, compiled=compiled)
        np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING * np.abs(expected).max())


@pytest.mark.parametrize("friction", [False, True], ids=["rigid", "friction"])
@pytest.mark.parametrize("sharing", ["shared", "independent"])
@pytest.mark.parametrize("name", ROBOTS)
def test_filtered_torque_regressors_are_pinocchios(name, sharing, friction, rng):
    require_alike(regressors(name, sharing, friction), rng)


@pytest.mark.parametrize("sharing", ["shared", "independent"])
def test_they_are_on_a_branched_tree_with_joints_of_every_kind(tree, sharing, rng):
    """Axes off the frames' own, sliding and continuous joints, rotors, two branches."""
    require_alike(ea.Regressors(tree, sharing, friction=True), rng)


def test_they_are_in_parameters_of_ones_own(rng):
    require_alike(ea.Regressors(load("two_link"), basis=ea.paper.basis(load("two_link"))), rng)


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
