"""Many estimators in one call, compiled or not: the same figures as one by one."""

import dataclasses
import sys

import numpy as np
import pytest
from shared import load

import eladapt as ea
import eladapt.estimation
from eladapt import batches
from eladapt.compiling import kernel_module
from eladapt.errors import ArgumentError
from eladapt.estimation.excitation import GateMonitor
from eladapt.estimation.extensions import Information
from eladapt.estimation.triangle import Directions, accumulate, directions, kernels

DT, MANY, STEPS = 1e-3, 3, 60
PATHS = [False, pytest.param(True, id="compiled")]
ROUNDING = 1e-10  # of the largest entry: sums in another order, through a triangle that divides


def trajectories(robot: ea.Robot, rng: np.random.Generator) -> list[list[ea.Measurement]]:
    """Free motions under random held torques."""
    runs = []
    for _ in range(MANY):
        plant = ea.PinocchioPlant(robot, robot.random_configuration(rng), rng.normal(size=robot.nv))
        effort = 0.2 * np.where(np.isfinite(robot.effort_limit), robot.effort_limit, 5.0)
        runs.append(
            [plant.reset(), *(plant.step(effort * rng.normal(size=robot.nv), DT) for _ in range(STEPS))]
        )
    return runs


def stacked(runs: list[list[ea.Measurement]], k: int) -> ea.Measurement:
    return ea.Measurement(runs[0][k].t, *(np.array([run[k][i] for run in runs]) for i in (1, 2, 3)))


def chain(regression, extension, mixing, law, reg, run, rng_theta, lead=()):
    """The line of estimation over a trajectory: (information, mixed, theta) at its end."""
    filters, information = regression.init(run[0]), extension.init(len(reg), *([lead] if lead else []))
    theta, mixed = rng_theta, mixing.mix(information, reg.n_potential)
    monitor = GateMonitor()
    excitation = monitor.init(np.shape(mixed.delta) or (1,))
    still = np.zeros((*lead, reg.robot.nv))
    for measurement in run[1:]:
        filters, found = regression.step(filters, measurement, DT)
        information = extension.step(information, found, DT)
        mixed = mixing.mix(information, reg.n_potential)
        excitation = monitor.step(excitation, mixed, DT)
        psi = np.zeros((*lead, reg.robot.nv, reg.n_potential))
        theta = law.step(theta, psi, still, still, mixed, DT, excitation.gates)
    return information, mixed, theta


def close(one, other, what):
    size = max(np.abs(one).max(initial=0), 1e-300)
    assert np.abs(np.asarray(one) - other).max(initial=0) <= ROUNDING * size, what


@pytest.mark.parametrize("compiled", PATHS)
@pytest.mark.parametrize("name", ["two_link", "ur5", "kinova", "talos_left_arm"])
@pytest.mark.parametrize("balance", [ea.ForceBalance, ea.PowerBalance])
@pytest.mark.parametrize("extension", [ea.LeastSquares(), ea.Kreisselmeier()], ids=["ls", "kre"])
def test_many_estimators_in_one_call_are_the_single_ones(name, balance, extension, compiled, rng):
    """Regression, extension, directional mixing and law with a leading axis, against one by one in numpy."""
    reg = ea.Regressors(load(name))
    runs = trajectories(reg.robot, rng)
    theta = rng.normal(size=(MANY, reg.n_potential))
    law = ea.CompositeLaw()
    together = [stacked(runs, k) for k in range(STEPS + 1)]
    many = dataclasses.replace(extension, compiled=compiled)
    balances = balance(reg)
    if compiled and balance is ea.ForceBalance:
        balances = dataclasses.replace(balances, compiled=True)
    information, mixed, last = chain(
        balances, many, ea.Directional(compiled), dataclasses.replace(law, compiled=compiled), reg, together,
        theta, (MANY,),
    )  # fmt: skip
    for b, run in enumerate(runs):
        one, lone, single = chain(balance(reg), extension, ea.Directional(), law, reg, run, theta[b])
        close(one.triangle.T @ one.triangle, information.triangle[b].T @ information.triangle[b], "R")
        close(one.prior, np.broadcast_to(information.prior, (MANY,))[b], "prior")
        close(lone.delta, mixed.delta[b], "gates")
        assert np.abs(single - last[b]).max() <= 1e-6, "theta, a square root away from rounding"


@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_compiled_controller_is_the_default_one(name):
    """A closed-loop run with every kernel compiled, beside the same run in numpy."""
    robot = load(name)
    records = []
    for compiled in (False, True):
        controller = ea.CompositeController.for_robot(robot, compiled=compiled)
        plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
        records.append(
            ea.simulate(controller, plant, robot.configuration(robot.target), 2.0, DT, progress=False)
        )
    plain, fast = records
    # Rounding grows along the motion, through fractional powers, until both have arrived.
    assert np.abs(plain.q - fast.q).max() <= 1e-6
    assert np.abs(plain.theta - fast.theta)[-1].max() <= 1e-5 * np.abs(plain.theta[-1]).max()
    assert np.abs(fast.error[-1]).max() <= max(1e-6, 2 * np.abs(plain.error[-1]).max())


def directions_on(compiled: bool, factor, start, basis) -> Directions:
    return (
        Directions(*kernels().singular_directions(factor, start, basis))
        if compiled
        else directions(factor, start)
    )


@pytest.mark.parametrize("compiled", PATHS)
def test_directions_stay_orthogonal_over_many_steps(compiled, rng):
    """Warm-started rotations do not let rounding add up: V'V = I and T V = U Sigma after 3000 updates."""
    size, k = 9, 5
    factor, basis = np.zeros((size + 1, size + 1)), np.eye(k)
    for _ in range(3000):
        rows = ea.Regression(rng.normal(size=3), rng.normal(size=(3, size)) * np.logspace(0, -4, size))
        factor = accumulate(factor, 0.99, 0.01, rows, compiled)
        found = directions_on(compiled, factor, size - k, basis)
        basis = np.ascontiguousarray(found.basis)
    block = factor[size - k : size, size - k : size]
    np.testing.assert_allclose(basis.T @ basis, np.eye(k), atol=1e-13)
    np.testing.assert_allclose(found.singular, np.linalg.svd(block, compute_uv=False), rtol=1e-10)
    solved = np.linalg.solve(block, factor[size - k : size, size])
    np.testing.assert_allclose(basis @ found.estimate, solved, rtol=1e-8)


@pytest.mark.parametrize("compiled", PATHS)
@pytest.mark.parametrize("coupling", [0.0, 1e-9, 1e-8, 1e-4, 1.0])
def test_directions_are_found_in_whatever_order_the_columns_stand(compiled, coupling, rng):
    """Longer columns behind shorter ones, some decoupled: singular values and solution as by LAPACK."""
    for _ in range(200):
        size = int(rng.integers(2, 7))
        factor = np.triu(rng.normal(size=(size + 1, size + 1)))
        factor[0, 1:size] *= coupling
        factor[np.diag_indices(size)] = rng.permutation(np.logspace(-1, 1, size))
        found = directions_on(compiled, factor, 0, np.eye(size))
        block = factor[:size, :size]
        # Condition numbers stay below 1e4: singular values are good to the rounding of the largest, the
        # solution to ten thousand times that.
        largest = np.linalg.norm(block, 2)
        expected = np.linalg.svd(block, compute_uv=False)
        np.testing.assert_allclose(found.singular, expected, rtol=0, atol=1e-13 * largest)
        solved = np.linalg.solve(block, factor[:size, size])
        scale = 1 + np.abs(solved).max()
        np.testing.assert_allclose(found.basis @ found.estimate, solved, rtol=0, atol=1e-10 * scale)


def test_least_squares_never_forgets_below_the_floor(rng):
    """The weakest direction, followed by inverse iteration, keeps z f0 + lambda_min >= 1/xi, within 1 %."""
    extension = ea.LeastSquares(alpha=1.0, beta=50.0, xi=1e4, f0=1e-3)
    information = extension.init(6)
    direction = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    for k in range(4000):
        seen = direction[:, k // 500 % 5]  # one direction after the other; the sixth never
        information = extension.step(information, ea.Regression(np.zeros(1), seen[None]), DT)
        least = np.linalg.svd(information.triangle[:-1, :-1], compute_uv=False)[-1] ** 2
        assert information.prior + least >= 0.99e-4


def test_a_kernel_without_numba_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "eladapt.estimation.kernels", None)
    monkeypatch.delattr(eladapt.estimation, "kernels", raising=False)
    kernel_module.cache_clear()
    extension = ea.LeastSquares(compiled=True)
    information, rows = extension.init(2), ea.Regression(np.zeros(1), np.zeros((1, 2)))
    with pytest.raises(ea.EladaptError, match=r"eladapt\[fast\]"):
        extension.step(information, rows, DT)
    kernel_module.cache_clear()


def test_forgetting_faster_than_the_step_is_refused():
    extension = ea.LeastSquares(beta=2000.0)
    information = extension.init(2)._replace(triangle=np.diag([1e3, 1e3, 0.0]))
    with pytest.raises(ArgumentError, match="dt < 1/beta"):
        extension.step(information, ea.Regression(np.ones(2), np.eye(2)), DT)


@pytest.mark.parametrize("lead", [(1,), (5,), (33,), (150,), (2, 3)], ids=str)
@pytest.mark.parametrize("extension", [ea.LeastSquares(compiled=True), ea.Kreisselmeier(compiled=True)])
def test_batches_of_every_size_are_their_members(lead, extension, rng):
    """Compiled, with one leading axis or two, over several blocks: each as alone."""
    size, k = 7, 4
    one = [extension.init(size) for _ in range(np.prod(lead))]
    many = extension.init(size, lead)
    mixing, mixed = ea.Directional(compiled=True), None
    for _ in range(12):
        y, omega = rng.normal(size=(*lead, 3)), rng.normal(size=(*lead, 3, size))
        omega[..., 1, 2] = 0.0  # a row that takes no part in one reflection
        many = extension.step(many, ea.Regression(y, omega), DT)
        mixed = mixing.mix(many, k, mixed)  # from the directions of the sample before
        rows = zip(y.reshape(-1, 3), omega.reshape(-1, 3, size), strict=True)
        one = [extension.step(each, ea.Regression(*row), DT) for each, row in zip(one, rows, strict=True)]
    for place, each in zip(np.ndindex(lead), one, strict=True):
        # A row's sign is arbitrary where it begins with rounding.
        close(np.abs(many.triangle[place]), np.abs(each.triangle), "triangle")
        close(many.innovation[place], each.innovation, "innovation")
        alone = ea.Directional().mix(each, k)
        close(mixed.delta[place], alone.delta, "gates")
        estimates = [
            m.basis @ (m.Y / m.delta) for m in (alone, ea.MixedRegression(*(a[place] for a in mixed)))
        ]
        close(*estimates, "estimate")


def test_a_batchs_directions_are_found_in_whatever_order_the_columns_stand(rng):
    """Longer columns behind shorter ones, some decoupled, all in one batch: as by LAPACK, one by one."""
    size, many = 6, 150
    factor = np.triu(rng.normal(size=(many, size + 1, size + 1)))
    for each, coupling in zip(factor, np.tile([0.0, 1e-9, 1e-8, 1e-4, 1.0], many // 5), strict=True):
        each[0, 1:size] *= coupling
        each[np.diag_indices(size)] = rng.permutation(np.logspace(-1, 1, size))
    information = Information(factor, np.ones(many), 0.0)
    mixed = ea.Directional(compiled=True).mix(information, size)
    singular = np.linalg.svd(factor[:, :size, :size], compute_uv=False)
    # As in the test of one triangle: rounding of the largest, and ten thousand times that for the solution.
    largest = singular[:, :1]
    np.testing.assert_allclose(np.sqrt(mixed.delta) / largest, singular / largest, rtol=0, atol=1e-13)
    solved = np.linalg.solve(factor[:, :size, :size], factor[:, :size, size:])[..., 0]
    found = (mixed.basis @ (mixed.Y / mixed.delta)[..., None])[..., 0]
    assert np.all(np.abs(found - solved).max(axis=1) <= 1e-10 * (1 + np.abs(solved).max(axis=1)))


@pytest.mark.parametrize("b", [0.3, 0.5, 1.0])
@pytest.mark.parametrize("many", [1, 40])
def test_a_batchs_law_is_the_single_one(b, many, rng):
    """The direct term and the flow of each direction, one of them without excitation."""
    law, n = ea.CompositeLaw(b=b), 5
    theta, Y, delta = rng.normal(size=(3, many, n))
    delta = np.abs(delta)
    delta[:, 2] = Y[:, 2] = 0.0
    basis = np.linalg.qr(rng.normal(size=(many, n, n)))[0]
    psi, (e1, e2) = rng.normal(size=(many, 3, n)), rng.normal(size=(2, many, 3))
    mixed = ea.MixedRegression(Y, delta, basis)
    together = dataclasses.replace(law, compiled=True).step(theta, psi, e1, e2, mixed, DT)
    for i in range(many):
        alone = law.step(theta[i], psi[i], e1[i], e2[i], ea.MixedRegression(*(a[i] for a in mixed)), DT)
        np.testing.assert_allclose(together[i], alone, rtol=0, atol=1e-13)


def test_a_batchs_directions_stay_orthogonal_over_many_steps(rng):
    """Rotations that start from the sample before do not let rounding add up, in a batch as in one."""
    size, k, many, mixed = 6, 4, 40, None
    extension, mixing = ea.LeastSquares(compiled=True), ea.Directional(compiled=True)
    information = extension.init(size, (many,))
    for _ in range(1000):
        rows = ea.Regression(rng.normal(size=(many, 3)), rng.normal(size=(many, 3, size)))
        information = extension.step(information, rows, DT)
        mixed = mixing.mix(information, k, mixed)
    product = np.swapaxes(mixed.basis, 1, 2) @ mixed.basis
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(k), product.shape), rtol=0, atol=1e-14)


def test_what_counts_for_all_of_a_batch_need_not_be_repeated(rng):
    """Arguments without leading axes, or, without the direct term, none; axes that do not fit are named."""
    many, n, nv = 40, 3, 2
    theta, Y, delta = np.abs(rng.normal(size=(3, many, n)))
    psi, e1, e2, basis = (
        rng.normal(size=(nv, n)),
        *rng.normal(size=(2, nv)),
        np.linalg.qr(rng.normal(size=(n, n)))[0],
    )
    whole = [np.broadcast_to(array, (many, *array.shape)) for array in (psi, e1, e2, basis)]
    law = ea.CompositeLaw(compiled=True)
    found = law.step(theta, psi, e1, e2, ea.MixedRegression(Y, delta, basis), DT)
    np.testing.assert_array_equal(
        found, law.step(theta, *whole[:3], ea.MixedRegression(Y, delta, whole[3]), DT)
    )
    alone = ea.CompositeLaw(compiled=True, direct=False)
    expected = dataclasses.replace(alone, compiled=False).step(
        theta, *whole[:3], ea.MixedRegression(Y, delta, basis), DT
    )
    found = alone.step(theta, None, None, None, ea.MixedRegression(Y, delta, basis), DT)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    extension = ea.LeastSquares(compiled=True)
    with pytest.raises(ArgumentError, match=r"expected the leading axes \(40,\), got \(20,\)"):
        extension.step(extension.init(n, (many,)), ea.Regression(np.ones((20, 1)), np.ones((20, 1, n))), DT)


def test_a_batch_without_rows_or_parameters_is_a_batch(rng):
    """No new rows: the information only fades. No gravity parameters: nothing to learn."""
    many, size = 40, 4
    extension, law = ea.Kreisselmeier(compiled=True), ea.CompositeLaw(compiled=True)
    rows = ea.Regression(rng.normal(size=(many, 2)), rng.normal(size=(many, 2, size)))
    before = extension.step(extension.init(size, (many,)), rows, DT)
    after = extension.step(before, ea.Regression(np.zeros((many, 0)), np.zeros((many, 0, size))), DT)
    kept = np.exp(-extension.forgetting * DT)
    np.testing.assert_allclose(after.triangle, np.sqrt(kept) * before.triangle, rtol=1e-14)
    nothing, still = np.zeros((many, 0)), np.zeros((many, 2))
    mixed = ea.MixedRegression(nothing, nothing, np.zeros((many, 0, 0)))
    assert law.step(nothing, np.zeros((many, 2, 0)), still, still, mixed, DT).shape == (many, 0)


def test_one_broken_member_leaves_a_batchs_others_alone(rng):
    """What is not a number in one stays there, and without excitation does not reach its theta either."""
    many, n = 40, 3
    theta, still, psi = np.ones((many, n)), np.zeros((many, 2)), np.zeros((many, 2, n))
    Y, delta, basis = rng.normal(size=(many, n)), np.ones((many, n)), np.tile(np.eye(n), (many, 1, 1))
    law = ea.CompositeLaw(compiled=True)
    expected = law.step(theta, psi, still, still, ea.MixedRegression(Y, delta, basis), DT)
    Y[5], delta[5], basis[5], expected[5] = 0.0, 0.0, np.nan, theta[5]
    found = law.step(theta, psi, still, still, ea.MixedRegression(Y, delta, basis), DT)
    np.testing.assert_array_equal(found, expected)


def test_a_batchs_memory_is_used_again_only_when_nothing_shows_it(monkeypatch):
    made, fresh = [], batches._fresh
    monkeypatch.setattr(batches, "_fresh", lambda *args, **more: made.append(args) or fresh(*args, **more))
    shape = (71, 4, 256)  # of no other test
    first = batches.aligned(shape)
    address, part = first.ctypes.data, first[3:5].transpose(2, 1, 0)
    part[:] = 7.0
    assert address % 64 == 0
    del first
    for _ in range(8):
        batches.aligned(shape)[:] = 0.0
    assert len(made) == 2, "the second serves all eight, since a view still shows the first"
    np.testing.assert_array_equal(part, 7.0)
    del part
    pair = batches.aligned(shape), batches.aligned(shape)
    assert len(made) == 2
    assert address in {array.ctypes.data for array in pair}


def test_a_batchs_triangles_cannot_be_written_to(rng):
    """What is below their diagonals is never written again, so nobody may."""
    extension = ea.LeastSquares(compiled=True)
    information = extension.init(4, (40,))
    for _ in range(5):
        rows = ea.Regression(rng.normal(size=(40, 2)), rng.normal(size=(40, 2, 4)))
        information = extension.step(information, rows, DT)
    np.testing.assert_array_equal(np.tril(information.triangle, -1), 0.0)
    with pytest.raises(ValueError, match="read-only"):
        information.triangle[0, 1, 0] = 1.0
