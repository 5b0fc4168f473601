"""Logs tell the parameters of the arm that made them, how sure they are, and what they do not tell."""

import dataclasses
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from known_logs import ALL, COULOMB, OFFSET, VISCOUS, heavier, known_log, truth
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, EladaptError, LogWarning
from eladapt.identification.rows import rows_of
from eladapt.regressors.standard import pseudo_inertia

ROBOTS = ("two_link", "ur5", "kinova", "panda", "talos_left_arm")


@pytest.mark.parametrize("name", ROBOTS)
def test_rows_hold_without_acceleration(name):
    """y = Omega theta over windows, but for what the acceleration does within a step of 2 ms: its change
    times the step's square, some 1e-6 of the torque."""
    robot = load(name)
    regressors = ea.Regressors(robot, joint_terms=ALL)
    rows = rows_of(known_log(robot), regressors, window=0.2, stiction_speed=0.01)
    assert rows.holds.mean() > 0.5
    assert not rows.omega[~rows.holds].any()
    assert np.abs(rows.omega @ truth(regressors) - rows.y).max() < 1e-5 * np.abs(rows.y).max()


def test_a_window_between_the_samples_of_a_slow_log_has_no_row():
    """25 Hz with lost messages: some windows of 0.1 s lie within a step of 0.2 s. Nothing is nan, and the
    torques that are left are right but for what the acceleration does within a step."""
    robot, log = load("ur5"), known_log(load("ur5"), 16.0, dt=5e-3)
    kept = np.flatnonzero(np.random.default_rng(0).uniform(size=len(log) // 8) > 0.3) * 8
    slow = dataclasses.replace(log, t=log.t[kept], q=log.q[kept], v=log.v[kept], tau=log.tau[kept])
    assert len(slow.segments) == 1
    found = ea.identify(robot, slow, progress=False)
    assert found.errors["identified"].filtered[-1] < 0.05


@pytest.mark.parametrize("name", ROBOTS)
def test_a_log_tells_the_arm_whatever_the_file_says(name):
    """From masses that are 30 % wrong: torques of another motion within 1e-4, by both sets of parameters."""
    robot = load(name)
    found = ea.identify(heavier(robot), known_log(robot, 16.0), held_out=0, progress=False)
    true = truth(found.regressors, robot.model)
    another = ea.excitation(robot, 5.0, rounds=0, seed=3, progress=False)
    _, course = another.sampled(0.05)
    W = np.array([found.regressors.torque(*at) for at in zip(course.q, course.v, course.a, strict=True)])
    right = W @ true
    wrong = np.linalg.norm(W @ found.regressors.theta - right)
    for theta in (found.theta, found.physical):
        assert np.linalg.norm(W @ theta - right) < 1e-4 * np.linalg.norm(right)
        assert np.linalg.norm(W @ theta - right) < 1e-2 * wrong
    assert found.friction.viscous == pytest.approx(np.full(robot.nv, VISCOUS), abs=1e-3)
    told = np.isfinite(found.std)[found.regressors.block("coulomb")]
    assert found.friction.coulomb[told] == pytest.approx(np.full(told.sum(), COULOMB), abs=1e-3)
    assert found.friction.offset[told] == pytest.approx(np.full(told.sum(), OFFSET), abs=1e-3)


@pytest.mark.slow
def test_standard_deviations_are_honest():
    """White noise of 1 N m in the torques of 40 logs: deviations have the size that is told. Of 58 x 40
    numbers (those of one log are not independent) the mean square is 1 within 25 %, and 99 % are within 3."""
    robot, scores = load("ur5"), []
    clean = known_log(robot)
    first = ea.identify(robot, clean, held_out=0, progress=False)
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(size=clean.tau.shape)
        log = dataclasses.replace(clean, tau=clean.tau + noise)
        found = ea.identify(robot, log, held_out=0, physical=False, progress=False)
        scores.append((found.theta - truth(first.regressors)) / found.std)
    assert np.mean(np.square(scores)) == pytest.approx(1, abs=0.25)
    assert np.mean(np.abs(scores) < 3) > 0.985


def test_rows_are_weighted_by_their_noise():
    """The first joint's torque is noise of 30 N m: the others' parameters do not suffer from it."""
    robot, clean = load("ur5"), known_log(load("ur5"))
    noise = np.zeros_like(clean.tau)
    noise[:, 0] = 30 * np.random.default_rng(0).normal(size=len(clean))
    found = ea.identify(robot, dataclasses.replace(clean, tau=clean.tau + noise), held_out=0, progress=False)
    assert found.fit.noise[0] > 1000 * found.fit.noise[1:].max()
    assert found.friction.coulomb[1:] == pytest.approx(np.full(5, COULOMB), abs=1e-3)
    assert found.friction.std[1, 0] > 0.1


def test_what_a_log_does_not_tell_stays_and_is_named():
    """A joint that stands still: its friction is the file's."""
    robot, log = load("ur5"), known_log(load("ur5"))
    still = np.arange(6) == 3
    rested = dataclasses.replace(log, q=np.where(still, log.q[0], log.q), v=np.where(still, 0.0, log.v))
    torque = [
        robot.inverse_dynamics(robot.configuration(q), v, np.where(still, 0, a))
        for q, v, a in zip(rested.q, rested.v, np.gradient(rested.v, rested.t, axis=0), strict=True)
    ]
    rested = dataclasses.replace(rested, tau=np.array(torque))
    with pytest.warns(LogWarning, match="wrist_1_joint stands still"):
        found = ea.identify(robot, rested, held_out=0, progress=False)
    for term in ("viscous", "coulomb", "offset"):
        at = found.regressors.block(term).start + 3
        assert found.theta[at] == pytest.approx(found.regressors.theta[at], abs=1e-12)
        assert np.isinf(found.std[at])
        assert any(f"{term}(wrist_1_joint)" in said for said in found.untold)
    assert np.isfinite(found.std[found.regressors.block("viscous").start])
    assert "not told by the log" in str(found)
    assert np.isnan(found.errors["identified"].filtered[3])
    assert re.search(r"^identified( +[\d.]+){3} +-( +[\d.]+){3} filtered$", str(found), re.MULTILINE)


def test_columns_of_ones_own():
    """A wrist whose gears couple the friction of two joints: without the columns both are wrong."""
    robot, log = load("ur5"), known_log(load("ur5"))
    coupled = 0.8 * np.sign(log.v[:, 4] + log.v[:, 5]) + 0.5 * (log.v[:, 4] + log.v[:, 5])
    tau = log.tau + np.outer(coupled, [0, 0, 0, 0, 1, 1])
    log = dataclasses.replace(log, tau=tau)

    def both(f):
        return lambda q, v, a: f(v[4] + v[5]) * np.array([0, 0, 0, 0, 1, 1])

    columns = {"viscous(5 with 6)": both(lambda v: v), "coulomb(5 with 6)": both(np.sign)}
    found = ea.identify(robot, log, columns=columns, progress=False)
    assert found.labels[-2:] == tuple(columns)
    # the sum of two speeds may turn round within a window, whose steps count then by their halves
    assert found.theta[-2:] == pytest.approx([0.5, 0.8], abs=5e-3)
    assert found.friction.coulomb == pytest.approx(np.full(6, COULOMB), abs=5e-3)
    assert found.errors["identified"].filtered[-1] < 1e-3
    without = ea.identify(robot, log, progress=False)
    assert without.errors["identified"].filtered[4] > 0.02
    with pytest.raises(ArgumentError, match=r"columns: viscous\(elbow_joint\) is a parameter already"):
        ea.identify(robot, log, columns={"viscous(elbow_joint)": lambda q, v, a: v}, progress=False)
    with pytest.raises(ArgumentError, match="columns: expected functions by name, got list"):
        ea.identify(robot, log, columns=["x"], progress=False)
    with pytest.raises(ArgumentError, match="columns: 'x' should give 6 finite numbers"):
        ea.identify(robot, log, columns={"x": lambda q, v, a: 1.0}, progress=False)


def test_a_log_that_the_parameters_do_not_explain_is_doubted():
    """Joints in another order, and torques of the other sign: least squares explain these, no bodies do."""
    robot, log = load("ur5"), known_log(load("ur5"), 16.0)
    wrong = dataclasses.replace(log, q=log.q[:, ::-1], v=log.v[:, ::-1], tau=log.tau[:, ::-1])
    with pytest.warns(LogWarning, match="is it this robot's log"):
        found = ea.identify(robot, wrong, progress=False)
    assert any("is it this robot's log" in note for note in found.notes)
    with pytest.warns(LogWarning, match="no bodies that can be fit the log"):
        ea.identify(robot, known_log(robot, 16.0, noise=0.5, sign=-1), progress=False)
    assert not ea.identify(robot, log, progress=False).notes


def test_where_no_bodies_fit_the_rest_is_there(monkeypatch, tmp_path):
    """Torques of the other sign: least squares stay, what is missing is said, and asking for it says why."""
    from eladapt.identification import physical

    robot, log = load("two_link"), known_log(load("two_link"), 8.0, noise=0.01, sign=-1)
    answer = SimpleNamespace(status=physical.clarabel.SolverStatus.PrimalInfeasible)
    hopeless = SimpleNamespace(solve=lambda: answer)
    monkeypatch.setattr(physical.clarabel, "DefaultSolver", lambda *_: hopeless)
    with pytest.warns(LogWarning, match=r"there are no bodies that can be and fit .*sign"):
        found = ea.identify(robot, log, progress=False)
    assert found.physical is None
    assert found.errors["identified"].filtered[-1] < 0.05  # what noise of 0.01 N m leaves of some N m
    assert any("no bodies that can be" in note for note in found.notes)
    assert found.report(tmp_path / "page.html").stat().st_size > 10_000
    with pytest.raises(EladaptError, match=r"no physical parameters: .* found\.notes says"):
        found.save_urdf(tmp_path / "arm.urdf")


def test_a_library_that_is_missing_is_said_before_the_work(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    monkeypatch.delitem(sys.modules, "eladapt.identification.physical", raising=False)
    with pytest.raises(EladaptError, match=r"need clarabel, which is not installed"):
        ea.identify(load("ur5"), "a log that would be refused")
    with pytest.raises(ArgumentError, match="expected a Log"):
        ea.identify(load("ur5"), "a log that would be refused", physical=False)


def test_a_robot_is_asked_for():
    with pytest.raises(ArgumentError, match="robot: expected a Robot, got str"):
        ea.identify("ur5", known_log(load("ur5")))


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_bodies_are_physical_where_least_squares_are_not(name):
    """Noise and a short log: pseudo-inertias of all bodies positive definite, friction not negative, and the
    fit as good as noise allows (the parameters that it moves are those that are hardly told)."""
    robot = load(name)
    found = ea.identify(robot, known_log(robot, 5.0, noise=0.5), progress=False)
    loose = found.regressors.inertial_parameters(found.theta[: len(found.regressors)])
    least = [np.linalg.eigvalsh(pseudo_inertia(loose[k : k + 10]))[0] for k in range(0, 10 * robot.nv, 10)]
    assert min(least) < 0, "nothing to mend"
    for k in range(0, 10 * robot.nv, 10):
        assert np.linalg.eigvalsh(pseudo_inertia(found.parameters[k : k + 10]))[0] > 0
    for term in ("viscous", "coulomb"):
        assert (found.physical[found.regressors.block(term)] >= 0).all()
    assert (found.robot.armature >= 0).all()
    errors = found.errors
    assert errors["physical"].filtered[-1] < 1.2 * errors["identified"].filtered[-1] + 1e-3
    z = found.fit.triangle @ (found.physical - found.theta)
    assert z @ z < 9 * len(found.theta)


@pytest.mark.slow
def test_a_controllers_state_is_as_good_as_a_log():
    """What a run has learned, without a log: the masses that were 30 % wrong are right, and the file too."""
    robot = load("ur5")
    wrong = heavier(robot)
    motion = ea.excitation(robot, 6.0, rounds=0, progress=False)
    controller = ea.CompositeController.for_robot(wrong, 2e-3)
    record = ea.simulate(controller, ea.PinocchioPlant(robot, motion.q0), motion, 6.0, 2e-3, progress=False)
    found = ea.identify(wrong, record.final_state)
    rng = np.random.default_rng(0)
    for _ in range(10):
        q = robot.random_configuration(rng)
        assert found.robot.gravity(q) == pytest.approx(
            robot.gravity(q), abs=0.02 * np.abs(robot.gravity(q)).max()
        )
    gated = ea.GatedController.for_robot(controller, 2e-3)
    state = gated.init(ea.Measurement(0.0, motion.q0, np.zeros(6), robot.gravity(motion.q0)))
    assert len(ea.identify(wrong, state).untold) > 0
    with pytest.raises(ArgumentError, match="columns: a controller's state"):
        ea.identify(wrong, state, columns={"x": lambda q, v, a: v})


def test_a_load_between_two_logs_is_weighed():
    robot, rng = load("panda"), np.random.default_rng(1)
    logs = [
        known_log(robot, 16.0, noise=0.1, load=load_, rng=rng) for load_ in (None, (1.0, (0.02, -0.01, 0.05)))
    ]
    before, after = (ea.identify(robot, log, physical=False, progress=False) for log in logs)
    carried = after.load_since(before)
    assert carried.mass == pytest.approx(1.0, abs=0.01)
    assert carried.com == pytest.approx([0.02, -0.01, 0.05], abs=5e-3)
    assert abs(carried.mass - 1) < 3 * carried.mass_std < 0.05
    assert carried.is_load
    other = ea.identify(load("ur5"), known_log(load("ur5")), physical=False, progress=False)
    with pytest.raises(ArgumentError, match="same robot"):
        after.load_since(other)


def test_gains_of_currents_are_learned_with_a_load_that_is_known():
    """2.8 kg at the tool: each current's gain within three of its standard deviations, most within 2 %."""
    robot, rng = load("ur5"), np.random.default_rng(2)
    gains = np.array([14.0, 14.0, 11.0, 9.5, 9.0, 8.5])
    logs = [
        known_log(robot, 16.0, noise=0.05, load=load_, rng=rng) for load_ in (None, (2.8, (0.0, 0.02, 0.1)))
    ]
    currents = [dataclasses.replace(log, tau=log.tau / gains) for log in logs]
    found = ea.current_gains(robot, *currents, 2.8, progress=False)
    assert np.all(np.abs(found.gains - gains) < 3 * found.std)
    assert np.sum(found.std < 0.02 * gains) >= 4
    with pytest.raises(ArgumentError, match="loaded: expected a Log, got str"):
        ea.current_gains(robot, currents[0], "log.csv", 2.8)
    with pytest.raises(ArgumentError, match="mass: expected a finite number"):
        ea.current_gains(robot, *currents, 0.0)
