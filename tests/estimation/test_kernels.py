"""Each kernel against LAPACK's or numpy's way to the same thing."""

import lapack
import numpy as np
import pytest
import scipy.optimize

import eladapt as ea
from eladapt.estimation import kernels
from eladapt.estimation.extensions import Information
from eladapt.signals import Regression

SIZES = [(1, 1), (5, 2), (43, 7), (69, 7)]
LARGER = SIZES[1:]  # with something beside the rows


def excited(size: int, m: int, rng, prior: float = 1e-3) -> Information:
    """Information of 3 l rows of sizes over four decades, and a residual that is not zero."""
    omega = rng.normal(size=(3 * size, size)) * 10.0 ** rng.uniform(-3, 1, size=size)
    y = omega @ rng.normal(size=size) + 0.1 * rng.normal(size=len(omega))
    rows = np.column_stack([omega, y])
    start = np.sqrt(prior) * np.eye(size + 1)
    start[-1, -1] = 0
    return Information(lapack.triangle_of(np.vstack([start, rows])), prior, 0.0, float(len(rows)))


def same_up_to_signs(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Two triangles, row by row, of their largest element."""
    signs = np.where(np.diag(found) < 0, -1.0, 1.0)[:, None]
    assert np.abs(found * signs - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize(("size", "m"), SIZES)
def test_updated_is_lapacks_triangle(size, m, rng):
    """To rounding of l + m sums; the innovation is what the residual grew by."""
    information, omega, y = excited(size, m, rng), rng.normal(size=(m, size)), rng.normal(size=m)
    found, innovation = kernels.updated(information.triangle, 0.7, 0.2, omega, y)
    expected = lapack.updated(information.triangle, 0.7, 0.2, omega, y)
    same_up_to_signs(found, expected, 1e-13)
    assert np.all(np.tril(found, -1) == 0)
    grown = expected[-1, -1] ** 2 - 0.7 * information.triangle[-1, -1] ** 2
    # A difference of two residuals: it loses the digits that they share.
    assert 0.2 * innovation**2 == pytest.approx(grown, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("prior", [1e-7, 1e-3])
@pytest.mark.parametrize(("size", "m"), SIZES)
def test_subspace_step_is_its_formula(size, m, prior, rng):
    """R and s against pseudo-inverses; the prior is neither forgotten nor learned."""
    information, omega, y = excited(size, m, rng, prior), rng.normal(size=(m, size)), rng.normal(size=m)
    found, _, counted = kernels.subspace_step(information.triangle, prior, omega, y, 0.2, 0.3, 0.0)
    after = Information(found, prior)
    matrix, vector = lapack.subspace_step(information.matrix, information.vector, omega, y, 0.2, 0.3)
    assert counted == m
    # R spans eight decades here: numpy's own forming of it is good to 1e-9 of the largest.
    assert np.abs(after.matrix - matrix).max() <= 1e-9 * np.abs(matrix).max()
    assert np.abs(after.vector - vector).max() <= 1e-9 * np.abs(vector).max()


def rest_of(information: Information, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is known of the directions that the rows of omega do not touch, all others eliminated: R and s."""
    turn = np.linalg.svd(omega)[2].T
    m, matrix, vector = len(omega), turn.T @ information.matrix @ turn, turn.T @ information.vector
    share = np.linalg.solve(matrix[:m, :m], matrix[:m, m:]).T
    return matrix[m:, m:] - share @ matrix[:m, m:], vector[m:] - share @ vector[:m]


@pytest.mark.parametrize(("size", "m"), LARGER)
def test_forgetting_leaves_what_the_rows_do_not_tell(size, m, rng):
    """What is known of all other directions stays to rounding, though two thirds along the rows go."""
    information, omega = excited(size, m, rng), rng.normal(size=(m, size))
    V = np.linalg.svd(omega)[2][:m].T
    found, *_ = kernels.subspace_step(information.triangle, 1e-3, omega, np.zeros(m), 1e-20, 2 / 3, 0.0)
    after = Information(found, 1e-3)
    for now, before in zip(rest_of(after, omega), rest_of(information, omega), strict=True):
        assert np.abs(now - before).max() <= 1e-7 * np.abs(before).max()
    np.testing.assert_allclose(V.T @ after.matrix @ V, V.T @ information.matrix @ V / 3, rtol=1e-6)


@pytest.mark.parametrize(("size", "m"), LARGER)
def test_the_same_rows_for_ever_cost_nothing_else(size, m, rng):
    """After 4 s of forgetting in 20 ms, what the rows say is their own and ends at their sum over the
    memory; what is known of the rest has not fallen."""
    block = ea.SubspaceLeastSquares(1.0, 50.0, f0=1e-3)
    information, omega = excited(size, m, rng), rng.normal(size=(m, size))
    before = rest_of(information, omega)[0]
    state = information
    for _ in range(400):
        state = block.step(state, Regression(np.zeros(m), omega), 1e-2)
    grown = np.linalg.eigvalsh(rest_of(state, omega)[0] - before)
    assert grown[0] >= -1e-7 * np.abs(before).max()
    V = np.linalg.svd(omega)[2][:m].T
    weight = 1e-2 / -np.expm1(-0.5)
    np.testing.assert_allclose(
        V.T @ state.matrix @ V, weight * (omega @ V).T @ (omega @ V), rtol=1e-4, atol=1e-4
    )


def test_rows_below_the_floor_count_for_nothing(rng):
    """A row of noise beside a row of motion: the motion counts, the noise does not, however it is mixed."""
    information = excited(5, 2, rng)
    loud, faint = rng.normal(size=5), 1e-3 * rng.normal(size=5)
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    omega = turn @ np.vstack([loud, faint - loud * (faint @ loud) / (loud @ loud)])
    prior, floor = 1e-3, 0.01
    found, _, counted = kernels.subspace_step(
        information.triangle, prior, omega, np.zeros(2), 0.2, 0.3, floor
    )
    alone = kernels.subspace_step(information.triangle, prior, loud[None], np.zeros(1), 0.2, 0.3, floor)[0]
    assert counted == 1
    np.testing.assert_allclose(Information(found, 1e-3).matrix, Information(alone, 1e-3).matrix, atol=1e-9)
    same = kernels.subspace_step(information.triangle, prior, omega, np.zeros(2), 0.2, 0.3, 100.0)
    assert same[2] == 0
    assert same[0] is information.triangle


@pytest.mark.parametrize("prior", [0.0, 1e-3])
@pytest.mark.parametrize(("size", "m"), SIZES)
def test_prediction_error_is_y_less_phi_theta(size, m, prior, rng):
    information, theta = excited(size, m, rng, prior), rng.normal(size=size)
    found = kernels.prediction_error(information.triangle, prior, theta)
    expected = lapack.prediction_error(information, theta)
    # Solving with R = T'T, whose condition is 1e8, loses as many digits.
    assert np.abs(found - expected).max() <= 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize(("size", "m"), SIZES)
def test_told_is_the_share_that_data_have(size, m, rng):
    information, rows = excited(size, m, rng), rng.normal(size=(m, size))
    np.testing.assert_allclose(information.told(rows), lapack.told(information, rows), atol=1e-12)
    assert information.told(np.zeros((1, size)))[0] == 0


@pytest.mark.parametrize(("size", "m"), SIZES)
def test_inverse_iteration_finds_the_smallest_eigenvalue(size, m, rng):
    """After a thousand steps, to a millionth."""
    information = excited(size, m, rng)
    direction = np.full(size, 1 / np.sqrt(size))
    for _ in range(1000):
        least, direction = kernels.smallest(information.triangle, direction)
    upper = information.triangle[:-1, :-1]
    assert least == pytest.approx(np.linalg.svd(upper, compute_uv=False)[-1] ** 2, rel=1e-6)


def test_a_singular_triangle_has_no_direction():
    start = np.array([0.6, 0.8])
    assert kernels.smallest(np.zeros((3, 3)), start)[0] == 0


def test_rotated_rows_are_orthogonal_and_say_the_same(rng):
    """Rows of one direction too, of which one is then left."""
    for omega in (rng.normal(size=(7, 40)), np.outer(np.arange(1.0, 5.0), rng.normal(size=9))):
        rows = np.column_stack([omega, omega @ rng.normal(size=omega.shape[1])])
        turned = rows.copy()
        kernels.orthogonal_rows(turned)
        gram = turned[:, :-1] @ turned[:, :-1].T
        assert np.abs(gram - np.diag(np.diag(gram))).max() <= 1e-13 * gram.max()
        np.testing.assert_allclose(turned.T @ turned, rows.T @ rows, atol=1e-12 * np.abs(gram).max())


@pytest.mark.parametrize("scatter", [0.0, 1e-6, 1.0, 1e4])
@pytest.mark.parametrize(("size", "m"), SIZES)
def test_what_is_sure_is_its_formula(size, m, scatter, rng):
    """A combination less the prior's doubt and its deviations, whether or not the sum stops where nothing is
    left; below the least, nothing."""
    information, theta = excited(size, m, rng), rng.normal(size=size)
    rows, noise = rng.normal(size=(2 * m, size)), rng.uniform(size=m)
    variance = kernels.variances(information.triangle, rows)
    doubt = 1 - 10.0 * information.prior * variance / np.sum(rows**2, axis=1)
    value = rows @ theta
    left = np.abs(value) * np.maximum(doubt, 0) - 3.0 * np.sqrt(scatter * np.tile(noise, 2) * variance)
    expected = np.copysign(np.maximum(left, 0), value)
    given = (information.triangle, information.prior, rows, theta, noise, scatter, 10.0, 3.0)
    # The rounding of l products, and of a difference that may lose all digits.
    np.testing.assert_allclose(kernels.surely(*given, -np.inf), expected, atol=1e-12 * np.abs(value).max())
    positive = np.where(value > 0, expected, 0.0)
    np.testing.assert_allclose(kernels.surely(*given, 0.0), positive, atol=1e-12 * np.abs(value).max())


@pytest.mark.parametrize(("size", "m"), LARGER)
@pytest.mark.parametrize("bounded", [1, 4])
def test_bounds_are_kept_where_that_costs_the_data_least(size, m, bounded, rng):
    """One bound: the exact minimum of d'T'T d. Four that are all passed: within them, and no worse than twice
    scipy's minimum. A plain limit is worse."""
    information = excited(size, m, rng)
    upper, theta = information.triangle[:-1, :-1], rng.normal(size=size)
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    for k in range(bounded):
        low[k], high[k] = theta[k] + 0.1, theta[k] + 0.2
    found = kernels.kept_within(information.triangle, theta, low, high)
    best = scipy.optimize.lsq_linear(upper, upper @ theta, (low, high)).x
    cost = {name: np.sum((upper @ (x - theta)) ** 2) for name, x in (("found", found), ("best", best))}
    assert np.all((found >= low) & (found <= high))
    assert cost["found"] <= (1 + 1e-6 if bounded == 1 else 2) * cost["best"]
    assert np.sum((upper @ (np.clip(theta, low, high) - theta)) ** 2) > cost["found"]
