"""The composite law: its exact flow, its saturation function, its direct term and projection."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.estimation.adaptation import flow
from eladapt.estimation.excitation import GateMonitor, saturation, zeta_1
from eladapt.signals import MixedRegression

STILL = (np.zeros((2, 3)), np.zeros(2), np.zeros(2))


@pytest.mark.parametrize("b", [0.25, 0.5, 0.9, 1.0])
def test_flow_solves_its_differential_equation(b):
    """x' = -k |x|^b sign(x), against a general solver, before it arrives."""
    x0, rate = np.array([1.0, -2.0, 0.5]), 0.7
    solved = solve_ivp(lambda _, x: -rate * np.sign(x) * np.abs(x) ** b, (0, 0.5), x0, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(flow(x0, rate, b, 0.5), solved.y[:, -1], rtol=1e-7)


def test_flow_arrives_exactly_and_does_not_depend_on_the_step():
    """It reaches zero at |x|^(1-b) / ((1-b) k), whatever the step, and rests there."""
    x, arrival = np.array([1.0, -1.0]), 1 / (0.5 * 3.0)
    for steps in (1, 7, 1000):
        y = x
        for _ in range(steps):
            y = flow(y, 3.0, 0.5, arrival / steps * 1.0001)
        assert np.all(y == 0)


@pytest.mark.parametrize("d", [0.25, 0.5, 2.0])
def test_zeta_is_the_papers_product(d):
    """zeta_1 = f(Delta) |Delta|^b, with f of (fphi) and c = b, in [0, 1)."""
    delta = np.concatenate([[0.0], np.logspace(-30, 6, 200)])
    product = saturation(delta, 0.5, d) * delta**0.5
    np.testing.assert_allclose(zeta_1(delta, 0.5, d), product, rtol=1e-12)
    assert np.all((product >= 0) & (product < 1))


def test_law_is_the_typeset_right_side_for_a_small_step(rng):
    """(theta+ - theta)/dt -> -Gamma Psi'[...] - (g1 + g2) Gamma Upsilon f(Delta) Xi (318), (471)."""
    law = ea.CompositeLaw(0.3, 0.7, 5.0, np.array([1.0, 0.5, 2.0]), np.array([50.0, 20.0, 5.0]), d=0.8)
    psi, e1, e2 = rng.normal(size=(2, 3)), rng.normal(size=2), rng.normal(size=2)
    theta, true, delta = rng.normal(size=3), rng.normal(size=3), 0.02
    mixed = MixedRegression(delta * true, delta, np.eye(3))
    xi = np.sign(theta - true) * np.abs(delta * theta - mixed.Y) ** 0.5
    rate = -law.Gamma * (psi.T @ (0.3 * 5.0 * np.tanh(e1) + e2))
    rate -= law.Gamma * law.Upsilon * delta**0.8 / (1 + delta**1.3) * xi
    dt = 1e-7
    np.testing.assert_allclose(
        (law.step(theta, psi, e1, e2, mixed, dt) - theta) / dt, rate, rtol=1e-5, atol=1e-6
    )


def test_directional_step_moves_each_direction_by_its_own_gate(rng):
    """An unexcited direction stays; an excited one arrives."""
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    true, theta = rng.normal(size=3), np.zeros(3)
    gates = np.array([0.9, 0.9, 0.0])
    mixed = MixedRegression(gates * (basis.T @ true), gates, basis)
    law = ea.CompositeLaw()
    for _ in range(2000):
        theta = law.step(theta, *STILL, mixed, 1e-3)
    np.testing.assert_allclose((basis.T @ theta)[:2], (basis.T @ true)[:2], atol=1e-12)
    assert abs((basis.T @ theta)[2]) < 1e-12


def test_estimates_stay_within_known_bounds():
    law = ea.CompositeLaw(bounds=np.array([1.0, 2.0, 0.5]))
    mixed = MixedRegression(np.array([5.0, -5.0, 0.1]), 1.0, np.eye(3))
    theta = np.zeros(3)
    for _ in range(5000):
        theta = law.step(theta, *STILL, mixed, 1e-3)
    np.testing.assert_allclose(theta, [1.0, -2.0, 0.1], atol=1e-12)


def test_monitor_integrates_zeta():
    monitor, mixed = GateMonitor(0.5, 0.5), MixedRegression(np.zeros(2), 0.25, np.eye(2))
    excitation = monitor.init(1)
    for _ in range(10):
        excitation = monitor.step(excitation, mixed, 0.1)
    np.testing.assert_allclose(excitation.integral, 0.25 / 1.25, rtol=1e-12)


def test_interval_excitation_is_the_smallest_eigenvalue_of_the_integral(rng):
    """mu of (502)."""
    block, total = ea.IntervalExcitation(), np.zeros((3, 3))
    information = block.init(3)
    for _ in range(40):
        omega = rng.normal(size=(2, 3))
        total += 0.01 * omega.T @ omega
        information = block.step(information, ea.Regression(np.zeros(2), omega), 0.01)
    assert block.level(information) == pytest.approx(np.linalg.eigvalsh(total)[0], rel=1e-10)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"gamma1": -1}, "gamma1"), ({"gamma1": 0, "gamma2": 0}, "positive sum"), ({"d1": np.nan}, "d1"),
        ({"Gamma": 0}, "Gamma"), ({"Upsilon": [1, -1]}, "Upsilon"), ({"d": 0}, "d: expected"),
        ({"b": 0}, "b: expected"), ({"b": 1.1}, "b: expected"), ({"bounds": -1.0}, "bounds"),
        ({"Gamma": [[1, 1], [0, 1]]}, "diagonal"),
    ],
)  # fmt: skip
def test_gains_outside_their_range_are_refused(options, said):
    with pytest.raises(ArgumentError, match=said):
        ea.CompositeLaw(**options)
