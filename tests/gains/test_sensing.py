"""What is known of noise and delay chooses horizon and information floor, and the loop is better for it."""

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.gains.derived import derive_gains
from eladapt.gains.sensing import DELAY_MARGIN, MOST_NOISE, NOISE_SHARE, Hardware
from eladapt.robot.rotors import ASSUMED_ROTOR_ACCELERATION
from eladapt.simulation.instruments import Delay, Encoders, NoisyReadings


def test_without_noise_or_delay_the_step_chooses_the_horizon():
    for dt in (1e-3, 2e-3):
        gains = derive_gains(ea.Regressors(load("panda")), dt)
        np.testing.assert_allclose(gains.horizon, 1.3 * dt)
        assert gains.floor == 0


@pytest.mark.parametrize(
    ("known", "active"),
    [
        ({"delay": 2e-3}, "delay"),
        ({"velocity_lag": 5e-3}, "velocity lag"),
        ({"delay": 2e-3, "velocity_lag": 5e-3}, "delay and lag"),
        ({"velocity_noise": 1e-2}, "velocity noise"),
        ({"position_noise": 1e-4}, "position noise"),
        ({"position_noise": 1e-9, "velocity_noise": 1e-9}, "sampling"),
    ],
)
def test_the_horizon_says_what_chose_it(known, active):
    gains = ea.CompositeController.for_robot(load("panda"), **known).gains
    rule = next(rule for rule in gains.rules if rule.gain == "horizon")
    assert rule.active == active
    assert np.all(gains.horizon == 1.3 * DT) == (active == "sampling")


def test_noise_makes_the_torque_that_is_allowed():
    """M sigma_v / H and M sigma_q / H^2 are NOISE_SHARE of the effort limit in every joint, or MOST_NOISE, M
    with the rotor that is assumed: 0.33 N m on the Panda's shoulder, 0.05 on its wrist."""
    robot = load("panda")
    for noise, power in (({"velocity_noise": 0.02}, 1), ({"position_noise": 1e-3}, 2)):
        controller = ea.CompositeController.for_robot(robot, **noise)
        rng = np.random.default_rng(0)  # the postures over which the gains took M's extremes
        inertia = np.max(
            [np.diag(robot.mass_matrix(robot.random_configuration(rng))) for _ in range(200)], axis=0
        )
        inertia += robot.effort_limit / ASSUMED_ROTOR_ACCELERATION
        (sigma,) = noise.values()
        torque = inertia * sigma / controller.gains.horizon**power
        allowed = np.minimum(NOISE_SHARE * robot.effort_limit, MOST_NOISE)
        np.testing.assert_allclose(torque, allowed, rtol=1e-9)


def stiff_pd_growth(horizon: float, delay: int) -> float:
    """Largest eigenvalue over a step of e'' = u, u = -(e/H^2 + v/H) held, and ``delay`` steps late."""
    size = 2 + delay
    matrix = np.zeros((size, size))
    matrix[0, :2], matrix[1, 1] = [1, DT], 1
    command = np.array([-1 / horizon**2, -1 / horizon])
    effect = np.array([DT**2 / 2, DT])
    if delay == 0:
        matrix[:2, :2] += np.outer(effect, command)
    else:
        matrix[:2, 2] = effect  # the oldest command acts
        for k in range(delay - 1):
            matrix[2 + k, 3 + k] = 1
        matrix[-1, :2] = command
    return float(np.abs(np.linalg.eigvals(matrix)).max())


@pytest.mark.parametrize("delay", [1, 2, 5, 20])
def test_the_delay_margin_is_that_of_the_stiff_pd(delay):
    """At H = (delay + dt/2) / 0.71 the loop is within 15 % of where it turns unstable; at twice that, damped.

    15 %: a step held is a delay of half of it only to first order, which shows at a delay of one step.
    """
    horizon = (delay * DT + DT / 2) / DELAY_MARGIN
    assert stiff_pd_growth(0.85 * horizon, delay) > 1
    assert stiff_pd_growth(1.15 * horizon, delay) < 1
    chosen = ea.CompositeController.for_robot(load("two_link"), delay=delay * DT).gains.horizon
    np.testing.assert_allclose(chosen, 2 * horizon, rtol=1e-2)
    assert stiff_pd_growth(chosen[0], delay) < 1


def test_rows_of_noise_alone_count_for_nothing():
    """A resting arm's rows, less what gravity makes of them, stay below the floor in 99 of 100 samples, and
    not below a third of it: by 2000 samples at one posture, where the rule averages over postures."""
    robot, sigma = load("panda"), 0.01
    controller = ea.CompositeController.for_robot(robot, velocity_noise=sigma, joint_terms=())
    regressors, gains, rng = controller.regressors, controller.gains, np.random.default_rng(3)
    q, zero = robot.configuration(robot.home), np.zeros(robot.nv)
    weightless = np.zeros(len(regressors), dtype=bool)
    weightless[: len(regressors) - regressors.n_potential] = True
    filters, sizes = controller.regression.init(ea.Measurement(0.0, q, zero, zero)), []
    for k in range(2000):
        sample = ea.Measurement((k + 1) * DT, q, sigma * rng.normal(size=robot.nv), zero)
        filters, regression = controller.regression.step(filters, sample, DT)
        sizes.append(np.linalg.norm(regression.omega[:, weightless], axis=1))
    sizes = np.median(np.array(sizes)[500:], axis=1)
    assert np.quantile(sizes, 0.99) < gains.floor < 10 * np.median(sizes)


def test_stamps_that_are_off_raise_the_floor():
    """In proportion, and beside noise as standard deviations add."""
    robot = load("panda")
    floors = [
        ea.CompositeController.for_robot(robot, **known).gains.floor
        for known in ({"jitter": 1e-3}, {"jitter": 2e-3}, {"velocity_noise": 1e-3},
                      {"jitter": 1e-3, "velocity_noise": 1e-3})
    ]  # fmt: skip
    np.testing.assert_allclose(floors[1], 2 * floors[0], rtol=1e-12)
    assert floors[0] < floors[3]
    assert floors[2] < floors[3] < floors[0] + floors[2]


def test_what_stamps_that_are_off_make_of_rows_counts_for_nothing():
    """On a move, rows by such stamps differ from those by true ones by less than the floor in 99 of 100
    samples, and not by less than a thirtieth of it: one move, where the rule averages over postures."""
    robot, jitter, rng = load("panda"), 2e-4, np.random.default_rng(3)
    controller = ea.CompositeController.for_robot(robot, jitter=jitter)
    motion = ea.move(robot, robot.configuration(robot.home), robot.configuration(robot.target))
    kinds = [controller.regression.init(ea.Measurement(0.0, motion.q0, *np.zeros((2, robot.nv))))] * 2
    before, sizes = 0.0, []
    for k in range(1, round(motion.duration / DT)):
        now = motion(k * DT)
        sample = ea.Measurement(k * DT, now.q, now.v, robot.inverse_dynamics(now.q, now.v, now.a))
        stamp = k * DT + jitter / np.sqrt(2) * rng.normal()  # two of them make a step
        (kinds[0], true), (kinds[1], off) = (
            controller.regression.step(filters, sample, dt)
            for filters, dt in zip(kinds, (DT, stamp - before), strict=True)
        )
        before = stamp
        sizes.append(np.median(np.linalg.norm(off.omega - true.omega, axis=1)))
    assert np.quantile(sizes, 0.99) < controller.gains.floor < 30 * np.median(sizes)


def panda(wrap, duration: float = 2.0, **known) -> ea.Record:
    robot = load("panda")
    controller = ea.CompositeController.for_robot(robot, DT, **known)
    plant = wrap(ea.PinocchioPlant(robot, robot.configuration(robot.home)))
    return ea.simulate(controller, plant, robot.configuration(robot.target), duration, progress=False)


def test_a_delay_that_is_told_does_no_harm():
    """2 ms: as good as without delay, and no time is lost in finding the horizon, as `Patience` does."""
    told, free = panda(lambda plant: Delay(plant, 2e-3), delay=2e-3), panda(lambda plant: plant)
    assert told.final_state.ripple.ahead == 1.0
    assert told.settling_time(1e-3) < free.settling_time(1e-3) + 0.1, "the softer law arrives a little later"
    assert np.abs(told.error[-200:]).max() < 1e-5


def test_noise_encoders_and_delay_together():
    """The worst case without friction: below 1e-3 rad within 3 s (2.85; the horizon is up to 34 ms), torque
    ripple below 4 N m (2.1)."""
    noise = ea.Noise(1e-4, 1e-3)
    record = panda(
        lambda plant: NoisyReadings(Encoders(Delay(plant, 2e-3)), noise), 3.5,
        position_noise=1.01e-4, velocity_noise=2.8e-3, velocity_lag=5e-3, delay=2e-3,
    )  # fmt: skip
    assert record.settling_time(1e-3) < 3
    assert np.ptp(record.tau[-200:], axis=0).max() < 4
    assert record.final_state.change.noticed == 0


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"delay": -1e-3}, "delay: expected a finite number"),
        ({"velocity_noise": -1.0}, "velocity_noise: expected non-negative"),
        ({"position_noise": [1.0, np.nan]}, "position_noise: expected non-negative finite"),
        ({"velocity_lag": "long"}, "velocity_lag: expected a number"),
    ],
)
def test_bad_hardware_is_named(known, said):
    with pytest.raises(ArgumentError, match=said):
        Hardware(**known)


def test_noise_of_another_robot_is_refused():
    with pytest.raises(ArgumentError, match=r"velocity_noise: expected a scalar or shape \(2,\)"):
        ea.CompositeController.for_robot(load("two_link"), velocity_noise=[1e-3] * 3)


def test_a_delay_too_long_is_refused_with_what_would_do():
    """The delay counts in the sampling limits, and where no dt helps the message says so."""
    robot = load("panda")
    with pytest.raises(ArgumentError, match=r"a delay of 0.05 s.*no dt would do: a delay below") as caught:
        ea.CompositeController.for_robot(robot, delay=0.05)
    offered = float(str(caught.value).split("a delay below ")[-1].split(" s")[0])
    assert ea.CompositeController.for_robot(robot, dt=1e-3, delay=0.95 * offered - 1e-3).gains is not None
