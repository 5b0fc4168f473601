"""The composite law: its exact flow, its saturation function, its direct term and projection."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shared import regressors

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.estimation.adaptation import flow, stiffness
from eladapt.estimation.excitation import saturation, zeta_1
from eladapt.paper.typeset_estimation import GateMonitor
from eladapt.signals import MixedRegression


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
    mixed = MixedRegression(delta * true, delta)
    xi = np.sign(theta - true) * np.abs(delta * theta - mixed.Y) ** 0.5
    rate = -law.Gamma * (psi.T @ (0.3 * 5.0 * np.tanh(e1) + e2))
    rate -= law.Gamma * law.Upsilon * delta**0.8 / (1 + delta**1.3) * xi
    dt = 1e-7
    moved = law.scalar_flow(law.descend(theta, psi, e1, e2, dt), mixed, dt)
    np.testing.assert_allclose((moved - theta) / dt, rate, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("steps", [1, 7, 1000])
def test_vector_form_arrives_and_stays(steps, rng):
    """theta' = rate r / |r|^(1 - b) with Phi = I reaches the truth at |r|^(1 - b) / ((1 - b) rate), within
    one step, along a straight line, and stays there to the last bit."""
    law = ea.CompositeLaw(Gamma=1.0, Upsilon=3.0)
    true, start = rng.normal(size=(2, 6))
    arrival = np.linalg.norm(start - true) ** 0.5 / (0.5 * 3.0)
    theta, dt = start, arrival / steps
    for _ in range(steps + 1):
        theta = law.arrive(theta, true - theta, dt)
        line = (theta - start) @ (true - start) / np.sum((true - start) ** 2)
        np.testing.assert_allclose(theta, start + line * (true - start), atol=1e-12)
    np.testing.assert_allclose(law.arrive(theta, true - theta, dt), true, rtol=0, atol=1e-15)


def test_vector_form_decays_as_its_inequality_says(rng):
    """V' <= -rate lambda_min(Phi) |theta_error|^(1 + b) (588), by a fine step, for Phi of any eigenvalues."""
    law, dt = ea.CompositeLaw(Gamma=1.0, Upsilon=2.0), 1e-7
    for _ in range(50):
        basis = np.linalg.qr(rng.normal(size=(5, 5)))[0]
        gates = rng.uniform(0, 1, size=5)
        error = rng.normal(size=5)
        moved = law.arrive(error, -(basis * gates) @ basis.T @ error, dt)
        rate = (np.sum(moved**2) - np.sum(error**2)) / (2 * dt)
        assert rate <= -2.0 * gates.min() * np.linalg.norm(error) ** 1.5 * (1 - 1e-5)


def test_direct_term_is_one_gain_for_all_or_a_diagonal_for_gravity(rng):
    """-dt Gamma W' [gamma1 d1 tanh(e1) + (gamma1 + gamma2) e2]; a diagonal leaves all but theta_U alone."""
    W, e1, e2, theta = rng.normal(size=(3, 6)), rng.normal(size=3), rng.normal(size=3), rng.normal(size=6)
    push = 1e-3 * W.T @ (0.3 * 5.0 * np.tanh(e1) + e2)
    np.testing.assert_allclose(ea.CompositeLaw(Gamma=2.0).descend(theta, W, e1, e2, 1e-3), theta - 2 * push)
    diagonal = ea.CompositeLaw(Gamma=np.array([1.0, 3.0])).descend(theta, W, e1, e2, 1e-3)
    np.testing.assert_allclose(diagonal, theta - push * [0, 0, 0, 0, 1, 3])


def test_estimates_stay_within_known_bounds():
    """theta_U alone is bounded, however far the data say it is."""
    law = ea.CompositeLaw(bounds=np.array([1.0, 2.0, 0.5]))
    mixed = MixedRegression(np.array([9.0, 5.0, -5.0, 0.1]), 1.0)
    theta = np.zeros(4)
    for _ in range(5000):
        theta = law.bounded(law.scalar_flow(theta, mixed, 1e-3), 3)
    np.testing.assert_allclose(theta, [9.0, 1.0, -2.0, 0.1], atol=1e-12)


def test_bounds_of_the_whole_theta_leave_free_what_has_none():
    law = ea.CompositeLaw(bounds=np.array([[0.0, np.inf], [-np.inf, np.inf], [-1.0, 1.0]]))
    np.testing.assert_array_equal(law.bounded(np.array([-3.0, -3.0, -3.0]), 1), [0.0, -3.0, -1.0])
    law.check_bounds(1, 3)
    with pytest.raises(ArgumentError, match=r"expected a scalar, \(2,\) or \(4, 2\), got 3"):
        law.check_bounds(2, 4)


def test_monitor_integrates_zeta():
    monitor, mixed = GateMonitor(0.5, 0.5), MixedRegression(np.zeros(2), 0.25)
    excitation = monitor.init()
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


@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_the_direct_term_is_as_stiff_as_its_trace(name):
    """Against numpy; and Gamma counts for as much less as keeps the swing within what a step resolves."""
    reg, rng = regressors(name), np.random.default_rng(0)
    robot = reg.robot
    q, v = robot.random_configuration(rng), rng.normal(size=robot.nv)
    W, M, Gamma = reg.slotine_li(q, v, 20 * v, 90 * v), robot.mass_matrix(q), rng.uniform(1, 2, len(reg))
    kept = slice(1, 3)
    others = np.delete(np.arange(len(reg)), [1, 2])
    expected = np.trace(np.linalg.solve(M, (W * Gamma)[:, others] @ W[:, others].T))
    assert stiffness(M, W, Gamma, 1, 3) == pytest.approx(expected, rel=1e-10)
    law, theta, e1, e2 = ea.CompositeLaw(Gamma=10.0), np.zeros(len(reg)), 0.01 * v, 0.1 * v
    whole = law.descend(theta, W, e1, e2, 1e-2, kept=kept)
    slowed = law.descend(theta, W, e1, e2, 1e-2, kept=kept, mass_matrix=M)
    share = 0.09 / (1e-4 * stiffness(M, W, np.array([10.0]), 1, 3))
    assert share < 1
    np.testing.assert_allclose(slowed, share * whole, atol=1e-12)
    assert not slowed[1:3].any()
