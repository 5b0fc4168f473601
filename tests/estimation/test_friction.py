"""Coulomb friction in the regression: exact through stiction, and its estimate in physical units."""

import functools

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.estimation.friction import FrictionCompensation, estimate_friction

VISCOUS, COULOMB = np.array([0.3, 0.1]), np.array([0.4, 0.2])


@functools.cache
def stick_slip() -> list[ea.Measurement]:
    """The two-link arm under slow swings of torque that both joints follow, stick in and turn back from;
    the friction's coefficients are in the plant only."""
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=ea.Friction(VISCOUS, COULOMB))
    measurements = [plant.reset()]
    for k in range(1500):
        t = k * DT
        swing = np.array([0.7 * np.sin(5 * t), 0.35 * np.sin(8 * t + 1)])
        measurements.append(plant.step(robot.gravity(plant.q) + swing, DT))
    return measurements


def truth(reg: ea.Regressors) -> np.ndarray:
    theta = reg.theta
    theta[reg.n_inertial : reg.n_inertial + 4] = np.concatenate([VISCOUS, COULOMB])
    return theta


def run(block) -> tuple[float, np.ndarray, ea.Information]:
    """The largest |y - Omega theta| of the largest |y|, the share of rows that are used, and all seen."""
    theta = truth(block.regressors)
    measurements, extension = stick_slip(), ea.LeastSquares()
    state, information = block.init(measurements[0]), extension.init(len(theta))
    worst = largest = 0.0
    used = []
    for measurement in measurements[1:]:
        state, regression = block.step(state, measurement, DT)
        information = extension.step(information, regression, DT)
        worst = max(worst, np.abs(regression.y - regression.omega @ theta).max())
        largest = max(largest, np.abs(regression.y).max())
        used.append(np.any(regression.omega != 0, axis=1))
    return worst / largest, np.mean(used, axis=0), information


@functools.cache
def regressors() -> ea.Regressors:
    return ea.Regressors(load("two_link"), friction=True)


@functools.cache
def gated() -> tuple[float, np.ndarray, ea.Information]:
    return run(ea.ForceBalance(regressors()))


def test_the_run_sticks_and_slides():
    v = np.array([m.v for m in stick_slip()])
    stuck = np.mean(np.abs(v) < 1e-6, axis=0)
    assert np.all(stuck > 0.04)
    assert np.all(stuck < 0.95)


def test_force_balance_holds_through_stiction():
    """y = Omega theta to 1e-4 along a run that sticks and slides, and rows of sliding are all used."""
    residual, used, _ = gated()
    assert residual < 1e-4
    v = np.array([m.v for m in stick_slip()])
    sliding = np.mean(np.abs(v) > 0.02, axis=0)
    assert np.all(used > 0.9 * sliding)


def test_without_the_gate_stiction_spoils_it():
    """The same regression that takes sign(v) at its word is off by a thirtieth and more."""

    class Ungated(ea.ForceBalance):
        def _sliding(self, before, after):
            return np.ones(len(before), dtype=bool)

    residual, _, _ = run(Ungated(regressors()))
    assert residual > 0.03


def test_power_balance_needs_no_gate():
    """What sticks does no work: the power balance holds through stiction as it is."""
    residual, _, _ = run(ea.PowerBalance(regressors()))
    assert residual < 1e-3


def test_friction_is_found():
    """Every coefficient within 1 % from one run that sticks and slides."""
    estimate = estimate_friction(regressors(), gated()[2])
    assert estimate.known.all()
    np.testing.assert_allclose(estimate.viscous, VISCOUS, rtol=0.01)
    np.testing.assert_allclose(estimate.coulomb, COULOMB, rtol=0.01)


def test_what_was_not_excited_is_unknown():
    """Nothing is known at first; a joint that never slides never is, and says so with nan."""
    reg = regressors()
    block, extension = ea.ForceBalance(reg), ea.LeastSquares()
    nothing = estimate_friction(reg, extension.init(len(reg)))
    assert not nothing.known.any()
    assert np.isnan(nothing.viscous).all()
    robot = load("two_link")
    friction = ea.Friction(VISCOUS, np.array([50.0, 0.2]))
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=friction)
    measurement = plant.reset()
    state, information = block.init(measurement), extension.init(len(reg))
    for k in range(1200):
        tau = robot.gravity(plant.q) + np.array([0.0, 0.45 * np.sin(8e-3 * k)])
        measurement = plant.step(tau, DT)
        state, regression = block.step(state, measurement, DT)
        information = extension.step(information, regression, DT)
    estimate = estimate_friction(reg, information)
    np.testing.assert_array_equal(estimate.known, [[False, True], [False, True]])
    assert np.isnan([estimate.viscous[0], estimate.coulomb[0]]).all()
    assert estimate.coulomb[1] == pytest.approx(0.2, rel=0.02)
    assert estimate.viscous[1] == pytest.approx(0.1, rel=0.05)


def test_one_kind_of_friction_alone():
    """With viscous columns only there is no gate, and Coulomb friction is not known."""
    reg = ea.Regressors(load("two_link"), friction="viscous")
    block = ea.ForceBalance(reg)
    state = block.init(stick_slip()[0])
    state, _ = block.step(state, stick_slip()[1], DT)
    information = ea.LeastSquares().init(len(reg))
    estimate = estimate_friction(reg, information)
    assert np.isnan(estimate.coulomb).all()
    assert not estimate.known.any()
    assert np.any(state.omega[:, reg.n_inertial + 2 :] != 0), "gravity is seen at rest"


def test_bad_input_is_named():
    with pytest.raises(ArgumentError, match="stiction_speed: expected"):
        ea.ForceBalance(regressors(), stiction_speed=-1)
    with pytest.raises(ArgumentError, match="information: expected that of"):
        estimate_friction(regressors(), ea.LeastSquares().init(3))
    with pytest.raises(ArgumentError, match="limit: expected"):
        FrictionCompensation(regressors(), limit=[1.0, 2.0, 3.0])
