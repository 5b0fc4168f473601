"""Encoders count, readings are noisy, torques come late; the true state stays the plant's."""

import numpy as np
import pytest
from shared import DT, load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.simulation.instruments import Delay, Encoders, FilteredVelocity, NoisyReadings

SPEED = np.array([0.7, -0.31])  # [rad/s], no whole ratio to the counts of a step


class Turntable:
    """Two joints that turn steadily, whatever the torque; it remembers what acted."""

    def __init__(self):
        self.robot = load("two_link")
        self.reset()

    def reset(self) -> ea.Measurement:
        self.t, self.q, self.v, self.acted = 0.0, np.array([0.1, 0.2]), SPEED, []
        return ea.Measurement(self.t, self.q, self.v, np.zeros(2))

    def step(self, tau: np.ndarray, dt: float) -> ea.Measurement:
        self.t, self.q = self.t + dt, self.q + dt * SPEED
        self.acted.append(tau)
        return ea.Measurement(self.t, self.q, self.v, tau)


def test_encoders_count_and_say_how_noisy_that_is():
    """Whole counts; in motion the errors are as large as `noise` says.

    5 %: the scatter of 20000 samples whose velocity errors are correlated over the filter's five is 2 %, and
    a steady motion's rounding is only nearly white.
    """
    encoders = Encoders(Turntable())
    encoders.reset()
    position, velocity = [], []
    for _ in range(20_000):
        measured = encoders.step(np.zeros(2), DT)
        position.append(measured.q - encoders.q)
        velocity.append(measured.v - SPEED)
    counts = measured.q / encoders.resolution
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    expected = encoders.noise(DT)
    assert np.std(position) == pytest.approx(expected.position, rel=0.05)
    assert np.std(velocity[100:]) == pytest.approx(expected.velocity, rel=0.05)


def test_a_resting_joint_reads_the_same_count():
    robot = load("asr_twodof")  # without gravity, so it rests by itself
    encoders = Encoders(ea.PinocchioPlant(robot, robot.configuration([0.1, 0.2])))
    first = encoders.reset()
    for _ in range(5):
        measured = encoders.step(np.zeros(2), DT)
        np.testing.assert_array_equal(measured.q, first.q)
        np.testing.assert_array_equal(measured.v, 0)


def test_a_torque_acts_after_its_delay():
    """2 ms at 1 kHz: two steps of nothing, then each in its turn; reset forgets what is on its way."""
    arm = Turntable()
    late = Delay(arm, 2e-3)
    late.reset()
    sent = [np.array([k, -k], dtype=float) for k in range(1, 6)]
    measured = [late.step(tau, DT).tau for tau in sent]
    for k, tau in enumerate([np.zeros(2), np.zeros(2), *sent[:3]]):
        np.testing.assert_array_equal(arm.acted[k], tau)
        np.testing.assert_array_equal(measured[k], tau)
    late.reset()
    late.step(sent[0], DT)
    np.testing.assert_array_equal(arm.acted[-1], 0)


def test_noise_of_the_readings_repeats_and_is_as_large_as_told():
    """Standard deviations within 3 %: four times the scatter of 20000 samples (0.7 % at one sigma)."""
    noise = ea.Noise(1e-4, [1e-3, 2e-3])
    noisy = NoisyReadings(Turntable(), noise, seed=5)
    runs = []
    for _ in range(2):
        first = noisy.reset()
        runs.append([first, *(noisy.step(np.zeros(2), DT) for _ in range(10_000))])
    for one, other in zip(*runs, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.v, other.v)
    drift = np.array([m.q - np.array([0.1, 0.2]) - m.t * SPEED for m in runs[0]])
    assert drift.std() == pytest.approx(1e-4, rel=0.03)
    np.testing.assert_allclose(np.std([m.v for m in runs[0]], axis=0), noise.velocity, rtol=0.03)


def test_the_load_shows_through_every_wrapper():
    robot = load("two_link")
    arm = ea.PinocchioPlant(robot, robot.configuration([0.0, 0.0]), payload=0.5)
    wrapped = NoisyReadings(Encoders(Delay(arm, 1e-3)), ea.Noise(1e-4, 1e-3))
    assert wrapped.payload is arm.payload
    assert wrapped.robot is robot


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda arm: Encoders(arm, counts=0), "counts: expected at least 1, got 0"),
        (lambda arm: Encoders(arm, time_constant=0.0), "time_constant: expected"),
        (lambda arm: Delay(arm, -1e-3), "delay: expected"),
    ],
)
def test_bad_hardware_is_named(make, said):
    with pytest.raises(ArgumentError, match=said):
        make(Turntable())


def test_a_filtered_velocity_lags_by_its_time_constant():
    """A plant that begins to turn: 1 - exp(-t/T) of its speed after t, to rounding, in any steps."""

    class Starting(Turntable):
        def reset(self):
            return super().reset()._replace(v=np.zeros(2))

    filtered, rng = FilteredVelocity(Starting(), 5e-3), np.random.default_rng(0)
    filtered.reset()
    for _ in range(20):
        measurement = filtered.step(np.zeros(2), rng.uniform(0.5, 1.5) * DT)
        np.testing.assert_allclose(measurement.v, -np.expm1(-measurement.t / 5e-3) * SPEED, rtol=1e-12)
    with pytest.raises(ArgumentError, match="time_constant"):
        FilteredVelocity(Turntable(), 0.0)
