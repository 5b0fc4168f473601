"""Coulomb friction in the regression: exact through stiction, and its estimate in physical units."""

import functools
import re

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.estimation import kernels
from eladapt.estimation.friction import FrictionEstimate, estimate_friction

VISCOUS, COULOMB = np.array([0.3, 0.1]), np.array([0.4, 0.2])


@functools.cache
def stick_slip() -> list[ea.Measurement]:
    """The two-link arm under slow swings of torque that both joints follow, stick in and turn back from;
    the friction's coefficients are in the plant only."""
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=ea.Friction(VISCOUS, COULOMB))
    measurements = [plant.reset()]
    for k in range(6000):
        t = k * DT
        swing = np.array([0.7 * np.sin(5 * t), 0.35 * np.sin(8 * t + 1)])
        measurements.append(plant.step(robot.gravity(plant.q) + swing, DT))
    return measurements


def truth(reg: ea.Regressors) -> np.ndarray:
    theta = reg.theta
    for name, values in (("viscous", VISCOUS), ("coulomb", COULOMB)):
        theta[reg.block(name)] = reg.scale[reg.block(name)] * values
    return theta


def run(block) -> tuple[float, np.ndarray, ea.Information]:
    """The largest |y - Omega theta| of the largest |y|, the share of rows that are used, and all seen."""
    theta = truth(block.regressors)
    measurements, extension = stick_slip(), ea.LeastSquares(beta=1e-3, f0=1e-7)
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
    return ea.Regressors(load("two_link"), joint_terms=("viscous", "coulomb"))


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

    ungated = ea.ForceBalance(regressors())
    object.__setattr__(ungated, "stiction_speed", -1.0)  # every joint is faster; not to be had by its name
    residual, _, _ = run(ungated)
    assert residual > 0.03


def test_power_balance_needs_no_gate():
    """What sticks does no work: the power balance holds through stiction as it is."""
    residual, _, _ = run(ea.PowerBalance(regressors()))
    assert residual < 1e-3


def found(reg: ea.Regressors, information) -> FrictionEstimate:
    """By least squares on all that was seen."""
    theta = kernels.prediction_error(information.triangle, information.prior, np.zeros(len(reg)))
    return estimate_friction(reg, theta, information)


def test_friction_is_found():
    """Every coefficient within 1 % from one run that sticks and slides, and there is no offset column."""
    estimate = found(regressors(), gated()[2])
    np.testing.assert_array_equal(estimate.known, [[True, True], [True, True], [False, False]])
    np.testing.assert_allclose(estimate.viscous, VISCOUS, rtol=0.01)
    np.testing.assert_allclose(estimate.coulomb, COULOMB, rtol=0.01)
    assert np.isnan(estimate.offset).all()


def test_friction_is_said_in_words():
    """A row a joint; what was not seen, and what there is no column for, is said and not printed as nan."""
    reg = regressors()
    head, shoulder, elbow = str(found(reg, gated()[2])).split("\n")
    assert " ".join(head.split()) == "friction viscous [N m s/rad] Coulomb [N m] offset [N m]"
    for row, name, coulomb in ((shoulder, "shoulder", COULOMB[0]), (elbow, "elbow", COULOMB[1])):
        assert row.startswith(name)
        assert row.endswith("not estimated")
        assert float(re.findall(r"(\S+) \+- ", row)[1]) == pytest.approx(coulomb, rel=0.01)
    unseen = ea.LeastSquares(beta=1e-3, f0=1e-7).init(len(reg))
    assert str(found(reg, unseen)).count("not known") == 4


def test_what_was_not_excited_is_unknown():
    """Nothing is known at first; a joint that never slides never is, and its standard deviation says so."""
    reg = regressors()
    block, extension = ea.ForceBalance(reg), ea.LeastSquares(beta=1e-3, f0=1e-7)
    assert not found(reg, extension.init(len(reg))).known.any()
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
    estimate = found(reg, information)
    np.testing.assert_array_equal(estimate.known[:2], [[False, True], [False, True]])
    assert np.all(estimate.std[:2, 0] >= 0.1)
    assert estimate.coulomb[1] == pytest.approx(0.2, rel=0.02)
    assert estimate.viscous[1] == pytest.approx(0.1, rel=0.05)


@functools.cache
def noisy_log(seconds: float, seed: int) -> tuple[ea.Regressors, ea.Information]:
    """A panda's sines in all joints, exact but for white noise of 1e-3 of the largest torque. A prior so weak
    that what it adds to the residual is below the noise."""
    robot = load("panda")
    reg = ea.Regressors(robot, joint_terms=("rotor", "viscous", "coulomb", "offset"))
    rng, turn = np.random.default_rng(seed), np.random.default_rng(0)
    speed, phase = turn.uniform(2, 4, size=(2, 7)), turn.uniform(0, 6, size=(2, 7))
    theta = panda_theta(reg)
    block, extension = (
        ea.ForceBalance(reg, weight=1 / robot.effort_limit),
        ea.LeastSquares(beta=1e-3, xi=1e13, f0=1e-12),
    )
    deviation = 1e-3 * robot.effort_limit

    def sample(t):
        angle = speed * t + phase
        q = robot.configuration(robot.home + 0.25 * np.sum(np.sin(angle), axis=0))
        v = 0.25 * np.sum(speed * np.cos(angle), axis=0)
        return q, v, -0.25 * np.sum(speed**2 * np.sin(angle), axis=0)

    q, v, _ = sample(0.0)
    state, information = block.init(ea.Measurement(0.0, q, v, np.zeros(7))), extension.init(len(reg))
    for k in range(round(seconds / DT)):
        # The torque that was held over the step, as its middle asks.
        tau = reg.torque(*sample((k + 0.5) * DT)) @ theta + deviation * rng.normal(size=7)
        q, v, _ = sample((k + 1) * DT)
        state, regression = block.step(state, ea.Measurement((k + 1) * DT, q, v, tau), DT)
        information = extension.step(information, regression, DT)
    return reg, information


def panda_theta(reg: ea.Regressors) -> np.ndarray:
    """The URDF's, with friction and offsets of a few per cent of the effort limits."""
    theta, limit = reg.theta, reg.robot.effort_limit
    for name, share in (("viscous", 0.02), ("coulomb", 0.03), ("offset", -0.01)):
        theta[reg.block(name)] = reg.scale[reg.block(name)] * share * limit
    return theta


def test_noise_leaves_standard_deviations_that_are_right_and_shrink():
    """10 s with noise of 1e-3 of the torque: all of 21 parameters known, errors of the size that is stated
    (RMS of error over deviation within a factor 1.5 over 63 of them), and less than 0.8 of it after 20 s."""
    ratios = []
    for seed in range(3):
        reg, information = noisy_log(10.0, seed)
        estimate, theta = found(reg, information), panda_theta(reg)
        values = np.array([estimate.viscous, estimate.coulomb, estimate.offset])
        true = [theta[reg.block(n)] / reg.scale[reg.block(n)] for n in ("viscous", "coulomb", "offset")]
        ratios.append((values - true) / estimate.std)
    assert estimate.known.all()
    assert 2 / 3 < np.sqrt(np.mean(np.square(ratios))) < 1.5
    longer = found(*noisy_log(20.0, 0))
    assert 0.2 < np.median(longer.std / estimate.std) < 0.8


def test_one_kind_of_friction_alone():
    """With viscous columns only there is no gate, and Coulomb friction is not known."""
    reg = ea.Regressors(load("two_link"), joint_terms="viscous")
    block = ea.ForceBalance(reg)
    state = block.init(stick_slip()[0])
    state, _ = block.step(state, stick_slip()[1], DT)
    estimate = found(reg, ea.LeastSquares().init(len(reg)))
    assert np.isnan(estimate.coulomb).all()
    assert not estimate.known.any()
    assert np.any(state.omega[:, reg.n_inertial + 2 :] != 0), "gravity is seen at rest"


def test_bad_input_is_named():
    with pytest.raises(ArgumentError, match="stiction_speed: expected"):
        ea.ForceBalance(regressors(), stiction_speed=-1)
    with pytest.raises(ArgumentError, match="information: expected that of"):
        estimate_friction(regressors(), regressors().theta, ea.LeastSquares().init(3))
    bare = ea.Regressors(load("two_link"))
    with pytest.raises(ArgumentError, match="no friction columns"):
        estimate_friction(bare, bare.theta, ea.LeastSquares().init(len(bare)))


def test_a_joint_that_shakes_is_not_sliding():
    """White noise of 4e-3 rad/s about rest, which is above a stiction speed of 5e-3 rad/s every fifth time:
    the noise is measured within a quarter, and once it is, 1 row in 100 counts at most. On a slow motion with
    the same noise, 0.1 rad/s, all count."""
    reg, rng, speed = regressors(), np.random.default_rng(0), 5e-3
    block = ea.ForceBalance(reg, stiction_speed=speed)
    for moving in (0.0, 0.1):
        used, state = [], None
        for k in range(6000):
            v = moving + 4e-3 * rng.normal(size=reg.robot.nv)
            q = reg.robot.configuration(reg.robot.home + moving * k * DT)
            seen = ea.Measurement(k * DT, q, v, np.zeros(reg.robot.nv))
            if state is None:
                state = block.init(seen)
                continue
            state, regression = block.step(state, seen, DT)
            used.append(regression.omega.any(axis=1))
        np.testing.assert_allclose(np.sqrt(state.jitter), 4e-3, rtol=0.25)
        assert np.mean(used[4000:]) == 1.0 if moving else np.mean(used[4000:]) < 0.01
