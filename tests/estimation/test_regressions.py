"""The filtered regressions hold along real motion, with the torque held over each step."""

import numpy as np
import pytest
from shared import DT, Trajectory, closed_loop, regressors

import eladapt as ea
from eladapt.errors import ArgumentError


def residual(block, trajectory: Trajectory, theta: np.ndarray) -> float:
    """Largest |y - Omega theta| relative to the largest |y|."""
    state = block.init(trajectory.measurements[0])
    worst = largest = 0.0
    for measurement in trajectory.measurements[1:]:
        state, (y, omega) = block.step(state, measurement, DT)
        worst = max(worst, np.abs(y - omega @ theta).max())
        largest = max(largest, np.abs(y).max())
    return worst / largest


@pytest.fixture(scope="module", params=["two_link", "panda", "ur5", "kinova", "talos_left_arm"])
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module", params=[0.0, 0.3], ids=["rest", "moving"])
def trajectory(name, request) -> Trajectory:
    return closed_loop(name, request.param)


@pytest.mark.parametrize("pole", [2.0, 20.0, 100.0])
def test_force_balance_holds(trajectory, pole):
    """y = Omega theta for the force balance to 1e-5, from rest or moving."""
    reg = trajectory.reg
    assert residual(ea.ForceBalance(reg, pole), trajectory, reg.theta) <= 1e-5


def test_hermite_interpolation_is_of_fourth_order(trajectory):
    """With exact positions the force balance holds as well as the power balance."""
    reg = trajectory.reg
    assert residual(ea.ForceBalance(reg, interpolation="hermite"), trajectory, reg.theta) <= 1e-9


@pytest.mark.parametrize("pole", [2.0, 20.0, 100.0])
def test_power_balance_holds(trajectory, pole):
    """y = Omega theta for the power balance to 1e-9: exact but for the plant's own integration."""
    reg = trajectory.reg
    assert residual(ea.PowerBalance(reg, pole), trajectory, reg.theta) <= 1e-9


def test_weights_scale_rows_only(trajectory):
    reg = trajectory.reg
    weight = np.linspace(0.1, 2, reg.robot.nv)
    plain, weighted = ea.ForceBalance(reg, 20.0), ea.ForceBalance(reg, 20.0, weight=weight)
    states = [block.init(trajectory.measurements[0]) for block in (plain, weighted)]
    for measurement in trajectory.measurements[1:50]:
        (first, one), (second, other) = (
            block.step(state, measurement, DT) for block, state in zip((plain, weighted), states, strict=True)
        )
        states = [first, second]
    np.testing.assert_allclose(other.y, weight * one.y, rtol=1e-12)
    np.testing.assert_allclose(other.omega, weight[:, None] * one.omega, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("block", [ea.ForceBalance, ea.PowerBalance])
def test_viscous_friction_has_its_own_columns(block):
    """With friction columns the same regression holds on a plant with viscous friction; without
    them it does not. The dissipated energy is integrated by the trapezoid: second order in dt."""
    trajectory = closed_loop("ur5", 0.3, friction=True)
    reg = trajectory.reg
    theta = reg.theta
    viscous = reg.block("viscous")
    theta[viscous] = reg.scale[viscous] * (reg.robot.damping + 0.3)
    theta[reg.block("coulomb")] = 0
    assert residual(block(reg, 20.0), trajectory, theta) <= 1e-4
    rigid = regressors("ur5")
    assert residual(block(rigid, 20.0), trajectory, rigid.theta) > 1e-3


@pytest.mark.parametrize("block", [ea.ForceBalance, ea.PowerBalance])
@pytest.mark.parametrize("pole", [0.0, -1.0, np.nan, np.inf, "fast"])
def test_a_pole_must_be_positive(block, pole):
    with pytest.raises(ArgumentError, match="pole: expected"):
        block(regressors("two_link"), pole)
