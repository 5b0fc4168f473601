"""Extensions and mixings: Y = gain theta_S, and the paper's own equations as the judge."""

from collections.abc import Iterator

import numpy as np
import pytest
from shared import DT, closed_loop, load, regressors

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.estimation.change import surprise
from eladapt.estimation.extensions import Information
from eladapt.signals import Regression

EXTENSIONS = {
    "least squares": ea.LeastSquares(alpha=1, beta=5, xi=1e8, f0=1e-3),
    "subspace": ea.SubspaceLeastSquares(alpha=1, beta=5, f0=1e-3),
    "kreisselmeier": ea.Kreisselmeier(forgetting=1.0, gain=1.3),
}
MIXINGS = {
    f"{kind.__name__}-{scope}": kind(scope)
    for kind in (ea.Unmixed, ea.Determinant, ea.SmallestEigenvalue)
    for scope in ("all", "potential")
}


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
def test_mixed_regression_is_exact(name, regressions, extension, mixing):
    """Y = gain theta_S to 1e-8 of the largest |Y| so far along the run; a matrix gain is symmetric, with
    eigenvalues in [0, 1) where there is a prior."""
    reg = regressors(name)
    information = extension.init(len(reg))
    largest = 0.0
    for k, regression in enumerate(regressions):
        information = extension.step(information, regression, DT)
        if k % 5:
            continue
        Y, gain = mixing.mix(information, reg.n_potential)
        theta = reg.theta[len(reg) - len(Y) :]
        expected = gain @ theta if np.ndim(gain) else gain * theta
        largest = max(largest, np.abs(expected).max())
        # A gate far below rounding of the prior is not told from it: seen at the start of a move.
        rounding = 1e-8 * largest if information.prior == 0 else 1e-8 * largest + 1e-11 * np.abs(theta).max()
        assert np.abs(Y - expected).max() <= rounding
        if np.ndim(gain):
            assert np.abs(gain - gain.T).max() <= 1e-9 * np.abs(gain).max()
            eigenvalues = np.linalg.eigvalsh(gain)
            assert eigenvalues[0] >= -1e-9 * np.abs(gain).max()
            assert information.prior == 0 or eigenvalues[-1] < 1 + 1e-12
    if name == "two_link" or len(regressions[0].y) > 1:
        assert np.max(gain) > 0, "nothing was excited: the claim above was empty"


@pytest.mark.parametrize("extension", EXTENSIONS.values(), ids=EXTENSIONS)
def test_triangle_holds_the_information(extension, rng):
    """R = T'T and s = T't are the accumulated Omega'Omega and Omega'y, and stay triangular."""
    information = extension.init(5)
    theta = rng.normal(size=5)
    for _ in range(200):
        omega = rng.normal(size=(3, 5))
        information = extension.step(information, Regression(omega @ theta, omega), DT)
    assert np.all(np.tril(information.triangle, -1) == 0)
    np.testing.assert_allclose(information.matrix @ theta, information.vector, rtol=1e-11)
    # Of a consistent regression the prior alone, which pulls theta to 0, leaves a residual.
    assert information.triangle[-1, -1] ** 2 <= information.prior * (theta @ theta) + 1e-24


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


@pytest.mark.parametrize("mixing", [ea.Unmixed("potential"), ea.Determinant(), ea.SmallestEigenvalue()])
def test_potential_scope_needs_no_excitation_of_the_rest(mixing):
    """theta_U is found while theta_M is not excited at all: an arm that stands still."""
    robot = load("two_link")
    reg = ea.Regressors(robot)
    extension = ea.LeastSquares()
    information = extension.init(len(reg))
    for q1 in np.linspace(-1, 1, 50):
        psi = reg.potential_gradient(np.array([q1, 0.4]))
        information = extension.step(information, Regression(psi @ reg.theta, psi), 0.05)
    Y, gain = mixing.mix(information, reg.n_potential)
    found = np.linalg.solve(gain, Y) if np.ndim(gain) else Y / gain
    np.testing.assert_allclose(found, reg.theta_potential, rtol=1e-9)


def test_unexcited_is_zero_not_noise():
    """Without information the gain is 0, and Y with it, for every mixing; to rounding of the prior."""
    for mixing in MIXINGS.values():
        Y, gain = mixing.mix(ea.LeastSquares().init(6), 2)
        assert np.all(np.abs(gain) < 1e-15)
        assert np.all(Y == 0)


def test_determinant_of_many_small_gates_does_not_underflow():
    """delta of 43 gates of 1e-8 is 1e-344 as a product: it is kept by its logarithm, above zero."""
    information = Information(np.diag(np.append(np.full(43, np.sqrt(1 + 1e-8)), 0.0)), 1.0)
    assert ea.Determinant("all").mix(information, 12).gain > 0


@pytest.mark.parametrize("scope", ["all", "potential"])
@pytest.mark.parametrize("extension", EXTENSIONS.values(), ids=EXTENSIONS)
def test_unmixed_follows_its_mixed_regression(extension, scope, rng):
    """What moves theta, by triangular solves, is Y - Phi theta of what `mix` gives, by inverses; the
    potential scope leaves all but theta_U where it was."""
    reg = regressors("panda")
    information = extension.init(len(reg))
    for regression in list(consistent_regressions("panda", ea.ForceBalance))[:200]:
        information = extension.step(information, regression, DT)
    mixing, law, j = ea.Unmixed(scope), ea.CompositeLaw(Upsilon=1e9), reg.n_potential
    theta = rng.normal(size=len(reg))
    Y, gain = mixing.mix(information, j)
    start = len(theta) - len(Y)
    # With so large a rate the step is the whole way along r.
    moved = mixing.follow(law, information, theta, j, 1.0)
    np.testing.assert_array_equal(moved[:start], theta[:start])
    np.testing.assert_allclose(moved[start:] - theta[start:], Y - gain @ theta[start:], atol=1e-6)


def made_of_rest(block, extension, seconds: float) -> float:
    """How far ``seconds`` of rest in noise, after a move, take the estimate of gravity at other postures, of
    the largest torque [-]."""
    reg, (_, measurements) = block.regressors, closed_loop("panda", 0.0)
    robot, rng, rest = reg.robot, np.random.default_rng(2), measurements[-1]
    state, information = block.init(measurements[0]), extension.init(len(reg))
    for measurement in measurements[1:]:
        state, regression = block.step(state, measurement, DT)
        information = extension.step(information, regression, DT)
    before, learned = information, information.completed(np.zeros(len(reg)))
    state, tau = block.init(rest._replace(v=np.zeros(7))), robot.gravity(rest.q)
    for k in range(round(seconds / DT)):
        noisy = ea.Measurement(rest.t + (k + 1) * DT, rest.q, 1e-3 * rng.normal(size=7), tau)
        state, regression = block.step(state, noisy, DT)
        information = extension.step(information, regression, DT)
    moved = (information.completed(learned) - before.completed(learned))[-reg.n_potential :]
    postures = [robot.random_configuration(rng) for _ in range(50)]
    largest = np.abs([robot.gravity(q) for q in postures]).max()
    return float(np.abs([reg.gravity(q) @ moved for q in postures]).max() / largest)


def test_rest_in_noise_costs_nothing():
    """20 s of rest in noise of 1e-3 rad/s, told. With Coulomb columns a joint that may stick says nothing, so
    nothing is lost. Without them each row at rest is the posture's gravity and noise, and what is lost of
    other postures is less than half of what forgetting everywhere at once loses."""
    told = {"velocity_noise": 1e-3}
    whole = ea.CompositeController.for_robot(load("panda"), **told)
    assert made_of_rest(whole.regression, whole.extension, 20.0) == 0
    bodies = ea.CompositeController.for_robot(load("panda"), joint_terms=(), **told)
    lost = made_of_rest(bodies.regression, bodies.extension, 20.0)
    assert lost < 0.5 * made_of_rest(bodies.regression, ea.LeastSquares(1.0, 5.0, 1e8, 1e-7), 20.0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ea.LeastSquares(xi=10, f0=0.05), r"xi >= 1/f0"),
        (lambda: ea.LeastSquares(alpha=-1), "alpha"),
        (lambda: ea.LeastSquares(beta=0), "beta"),
        (lambda: ea.Kreisselmeier(forgetting=0), "lambda_2"),
        (lambda: ea.Kreisselmeier(gain=np.nan), "lambda_3"),
        (lambda: ea.Determinant("some"), "scope"),
        (lambda: ea.Unmixed("some"), "scope"),
        (lambda: ea.SubspaceLeastSquares(floor=-1), "floor"),
        (lambda: ea.SubspaceLeastSquares(f0=0), "f0"),
    ],
)
def test_settings_outside_their_range_are_refused(make, said):
    with pytest.raises(ArgumentError, match=said):
        make()


def test_what_was_excited_is_completed_without_a_prior_too():
    """Kreisselmeier's R theta = s is solved where it can be, and theta kept elsewhere; a change that is none
    raises no alarm."""
    rng, block = np.random.default_rng(0), ea.Kreisselmeier()
    true, start = rng.normal(size=(2, 6))
    information = block.init(6)
    for _ in range(300):
        omega = rng.normal(size=(2, 6)) * [1, 1, 1, 1, 0, 0]
        information = block.step(information, ea.Regression(omega @ true, omega), 1e-2)
    np.testing.assert_allclose(information.completed(start), [*true[:4], *start[4:]], atol=1e-9)
    assert surprise(information, ea.Regression(omega @ true, omega), start) == 0
