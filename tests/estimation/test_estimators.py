"""Extensions and mixings: Y = delta basis' theta, and the paper's own equations as the judge."""

from collections.abc import Iterator

import numpy as np
import pytest
from shared import DT, closed_loop, load, regressors

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.estimation.extensions import Information
from eladapt.signals import Regression

EXTENSIONS = {
    "least squares": ea.LeastSquares(alpha=1, beta=5, xi=1e8, f0=1e-3),
    "kreisselmeier": ea.Kreisselmeier(forgetting=1.0, gain=1.3),
}
MIXINGS = {
    f"{kind.__name__}-{scope}": kind(scope)
    for kind in (ea.Determinant, ea.SmallestEigenvalue)
    for scope in ("all", "potential")
} | {"Directional-potential": ea.Directional()}


def consistent_regressions(name: str, block) -> Iterator[Regression]:
    """Omega along a real move, with y = Omega theta exactly: what mixing must then preserve.

    The filters' own discretisation (1e-5) is the claim of test_regressions, not of this file.
    """
    reg, measurements = closed_loop(name, 0.0)
    state = block(reg, 20.0).init(measurements[0])
    for measurement in measurements[1:]:
        state, regression = block(reg, 20.0).step(state, measurement, DT)
        yield Regression(regression.omega @ reg.theta, regression.omega)


@pytest.fixture(scope="module", params=["two_link", "panda"])
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module", params=[ea.ForceBalance, ea.PowerBalance], ids=["force", "power"])
def regressions(name, request) -> list[Regression]:
    return list(consistent_regressions(name, request.param))


@pytest.mark.parametrize("extension", EXTENSIONS.values(), ids=EXTENSIONS)
@pytest.mark.parametrize("mixing", MIXINGS.values(), ids=MIXINGS)
def test_mixed_regression_is_scalar_and_exact(name, regressions, extension, mixing):
    """Y = delta basis' theta to 1e-8 of the largest |Y| so far, at every step of the run."""
    reg = regressors(name)
    information = extension.init(len(reg))
    largest = 0.0
    for regression in regressions:
        information = extension.step(information, regression, DT)
        Y, delta, basis = mixing.mix(information, reg.n_potential)
        theta = reg.theta[len(reg) - len(Y) :]
        expected = delta * (basis.T @ theta)
        largest = max(largest, np.abs(expected).max())
        assert np.abs(Y - expected).max() <= 1e-8 * largest
        np.testing.assert_allclose(basis.T @ basis, np.eye(len(Y)), atol=1e-12)
    if name == "two_link" or len(regressions[0].y) > 1:
        assert np.max(delta) > 0, "nothing was excited: the claim above was empty"


@pytest.mark.parametrize("extension", EXTENSIONS.values(), ids=EXTENSIONS)
def test_triangle_holds_the_information(extension, rng):
    """R = T'T and s = T't are the accumulated Omega'Omega and Omega'y, and stay triangular."""
    information = extension.init(5)
    theta = rng.normal(size=5)
    for _ in range(200):
        omega = rng.normal(size=(3, 5))
        information = extension.step(information, Regression(omega @ theta, omega), DT)
    assert np.all(np.tril(information.triangle, -1) == 0)
    np.testing.assert_allclose(information.matrix @ theta, information.vector, rtol=1e-12)
    assert abs(information.triangle[-1, -1]) < 1e-12, "a consistent regression leaves no residual"


def paper_least_squares(omega_at, y_at, size, dt, steps, alpha, beta, xi, f0):
    """(443) by explicit Euler, with rho_0 != 0 so that z f0 F rho_0 counts."""
    covariance, rho0, z = np.eye(size) / f0, np.full(size, 0.3), 1.0
    rho = rho0.copy()
    for k in range(steps):
        omega, y = omega_at(k * dt), y_at(k * dt)
        rate = beta * (1 - np.linalg.norm(covariance, 2) / xi)
        gain = covariance @ omega.T
        rho = rho + dt * alpha * gain @ (y - omega @ rho)
        covariance = covariance + dt * (-alpha * gain @ omega @ covariance + rate * covariance)
        z = z - dt * rate * z
    phi = np.eye(size) - z * f0 * covariance
    return phi, rho - z * f0 * covariance @ rho0


def wave(t: float) -> np.ndarray:
    return np.array([[np.sin(3 * t), 1.0, np.cos(5 * t)], [t, np.cos(t), 0.5]])


THETA = np.array([1.0, -2.0, 0.5])


def test_square_root_least_squares_is_the_papers():
    """T, z give the Phi and rho - z f0 F rho_0 of (443), integrated with a 100 times smaller step.

    Both are first order in dt, the library's with 100 times the step: the tolerance is that of
    dt = 1e-3, and it shrinks with dt, which the second line shows.
    """
    settings = {"alpha": 3.0, "beta": 4.0, "xi": 20.0, "f0": 0.2}
    phi, vector = paper_least_squares(wave, lambda t: wave(t) @ THETA, 3, 1e-5, 100_000, **settings)
    errors = []
    for dt in (2e-3, 1e-3):
        block = ea.LeastSquares(**settings)
        information = block.init(3)
        for k in range(round(1 / dt)):
            omega = wave((k + 0.5) * dt)
            information = block.step(information, Regression(omega @ THETA, omega), dt)
        full = information.prior * np.eye(3) + information.matrix
        errors.append(
            max(
                np.abs(np.linalg.solve(full, information.matrix) - phi).max(),
                np.abs(np.linalg.solve(full, information.vector) - vector).max(),
            )
        )
    assert errors[1] < 2e-3
    assert errors[1] < 0.7 * errors[0]


def test_square_root_kreisselmeier_is_the_papers():
    """T'T and T't are Phi_2 and Phi_1 of (510), integrated with a 100 times smaller step."""
    phi1, phi2, fine = np.zeros(3), np.zeros((3, 3)), 1e-5
    for k in range(100_000):
        omega = wave(k * fine)
        phi1, phi2 = (
            phi1 + fine * (-2 * phi1 + 1.3 * omega.T @ omega @ THETA),
            phi2 + fine * (-2 * phi2 + 1.3 * omega.T @ omega),
        )
    block = ea.Kreisselmeier(forgetting=2.0, gain=1.3)
    information = block.init(3)
    for k in range(1000):
        omega = wave((k + 0.5) * 1e-3)
        information = block.step(information, Regression(omega @ THETA, omega), 1e-3)
    assert np.abs(information.matrix - phi2).max() < 1e-4 * np.abs(phi2).max()
    assert np.abs(information.vector - phi1).max() < 1e-4 * np.abs(phi1).max()


def test_information_never_falls_below_its_floor(rng):
    """lambda_min(z f0 I + R) >= 1/xi however long nothing is excited (443)."""
    block = ea.LeastSquares(alpha=1, beta=5, xi=100, f0=0.05)
    information = block.init(4)
    for k in range(20_000):
        omega = rng.normal(size=(2, 4)) * (k < 50)
        information = block.step(information, Regression(omega @ np.ones(4), omega), 1e-2)
    smallest = np.linalg.eigvalsh(information.prior * np.eye(4) + information.matrix)[0]
    assert 0.01 * (1 - 1e-9) <= smallest < 0.0101, "it also forgets down to the floor"


@pytest.mark.parametrize("mixing", [ea.Determinant(), ea.SmallestEigenvalue(), ea.Directional()])
def test_potential_scope_needs_no_excitation_of_the_rest(mixing):
    """theta_U is found while theta_M is not excited at all: an arm that stands still."""
    robot = load("two_link")
    reg = ea.Regressors(robot)
    extension = ea.LeastSquares()
    information = extension.init(len(reg))
    for q1 in np.linspace(-1, 1, 50):
        psi = reg.potential_gradient(np.array([q1, 0.4]))
        information = extension.step(information, Regression(psi @ reg.theta, psi), 0.05)
    Y, delta, basis = mixing.mix(information, reg.n_potential)
    assert np.all(delta > 0)
    np.testing.assert_allclose(basis @ (Y / delta), reg.theta_potential, rtol=1e-9)


def test_unexcited_is_zero_not_noise():
    """Without information delta is 0, and Y with it, for every mixing."""
    for mixing in MIXINGS.values():
        Y, delta, _ = mixing.mix(ea.LeastSquares().init(6), 2)
        assert np.all(np.asarray(delta) == 0)
        assert np.all(Y == 0)


def test_determinant_of_many_small_gates_does_not_underflow():
    """delta of 43 gates of 1e-8 is 1e-344 as a product: it is kept by its logarithm, above zero."""
    information = Information(np.diag(np.append(np.full(43, 1e-4), 0.0)), 1.0, 0.0)
    assert ea.Determinant("all").mix(information, 12).delta > 0


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ea.LeastSquares(xi=10, f0=0.05), r"xi >= 1/f0"),
        (lambda: ea.LeastSquares(alpha=-1), "alpha"),
        (lambda: ea.LeastSquares(beta=0), "beta"),
        (lambda: ea.Kreisselmeier(forgetting=0), "lambda_2"),
        (lambda: ea.Kreisselmeier(gain=np.nan), "lambda_3"),
        (lambda: ea.Determinant("some"), "scope"),
    ],
)
def test_settings_outside_their_range_are_refused(make, said):
    with pytest.raises(ArgumentError, match=said):
        make()
