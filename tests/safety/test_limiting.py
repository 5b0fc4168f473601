"""The kernels of gate, barrier and guard are what numpy makes of the same words."""

import numpy as np
import pytest

from eladapt.safety import barrier, guards, limiting, samples

NV = 5
SIZES = (1e-3, 1.0, 30.0)  # of random speeds and ways: within all limits, about them, beyond


def draws():
    """300 sources of random numbers, from fixed seeds."""
    return map(np.random.default_rng, range(300))


def some(rng, scale=1.0):
    """(NV,) random numbers, in a fifth of all cases with one that is zero."""
    return scale * rng.normal(size=NV) * (rng.random(NV) < 0.96)


def limits(rng):
    """(NV,) positive, some not set."""
    return np.where(rng.random(NV) < 0.2, np.inf, rng.uniform(0.5, 2.0, NV))


def most(excess):
    """The joint with the largest, -1 where none is positive."""
    i = int(np.argmax(excess))
    return i if excess[i] > 0 else -1


def test_torque_is_limited_by_rate_and_effort():
    for rng in draws():
        tau, last, rate, effort = some(rng, 5.0), some(rng), limits(rng), limits(rng)
        expected = np.clip(np.clip(tau, last - rate * 0.1, last + rate * 0.1), -effort, effort)
        np.testing.assert_array_equal(limiting.near(tau, last, rate, effort, 0.1), expected)
        larger = np.where(np.abs(tau) >= np.abs(last), tau, last)
        full = np.sign(larger) * (np.abs(larger) >= limiting.FULL * effort)
        np.testing.assert_array_equal(limiting.at_limit(tau, last, effort), full)


def test_the_joint_furthest_beyond_its_limits_is_found():
    for rng in draws():
        x, v, velocity, lower, upper = some(rng), some(rng), limits(rng), -limits(rng), limits(rng)
        assert limiting.too_fast(v, velocity) == most(np.abs(v) - velocity)
        ahead = x + 0.5 * v
        beyond = np.where(v > 0, ahead - upper, np.where(v < 0, lower - ahead, -np.inf))
        assert limiting.leaving(x, v, lower, upper, 0.5) == most(beyond)


def test_the_barrier_s_room_is_between_its_bounds_of_speed():
    for rng in draws():
        x, v, wanted = some(rng), some(rng), some(rng, 10.0)
        time, horizon = np.full(NV, 0.4), np.full(NV, 0.1)
        velocity, lower, upper = limits(rng), -limits(rng), limits(rng)
        fastest = np.minimum(0.9 * velocity, np.maximum(upper - x, 0) / time)
        slowest = np.maximum(-0.9 * velocity, np.minimum(lower - x, 0) / time)
        least, largest = (slowest - v) / horizon, (fastest - v) / horizon
        found, passed = barrier.room(x, v, wanted, velocity, lower, upper, 0.9, time, horizon)
        np.testing.assert_array_equal(found, [least, largest, np.clip(wanted, least, largest)])
        assert passed == np.any((wanted < least) | (wanted > largest))


@pytest.mark.parametrize("size", SIZES)
def test_a_sample_is_unlikely_for_the_first_reason_that_holds(size):
    """Too fast for any arm, frozen, out of reach, a velocity out of reach."""
    for rng in draws():
        velocity, before, elapsed, dt, age, resolution = limits(rng), some(rng), 2e-3, 1e-3, 5e-3, 1e-4
        frozen = rng.random() < 0.3
        moved = np.zeros(NV) if frozen else some(rng, 1e-2 * size)
        v = before.copy() if frozen else before + some(rng, size)
        if rng.random() < 0.1:
            v[rng.integers(NV)] = -2 * samples.FASTEST
        reasons = (
            int(np.argmax(np.abs(v))) if np.abs(v).max() > samples.FASTEST else -1,
            int(np.argmax(np.abs(before)))
            if not moved.any() and np.array_equal(v, before) and np.abs(before).max() * age > resolution
            else -1,
            most(np.abs(moved) - 2 * velocity * (elapsed + dt)),
            most(np.abs(v - before) - velocity * (1 + elapsed / 0.02)),
        )
        expected = next(((why, i) for why, i in enumerate(reasons) if i >= 0), (-1, -1))
        assert samples.unlikely(moved, before, v, velocity, elapsed, dt, age, 0.02, resolution) == expected


def test_a_half_wave_ends_where_a_joint_turns():
    """What `DivergenceGuard` remembers of each joint, with a set-point that rests or jumps."""
    for rng in draws():
        moved = some(rng) * (rng.random() < 0.5)
        error, v, sign = some(rng), some(rng), np.sign(some(rng))
        asked, peak, before = np.abs([some(rng), some(rng), some(rng)])
        length, stalled, yielded = rng.uniform(0, 1, (3, NV))
        yielding = rng.uniform(0, 1, NV) * (rng.random(NV) < 0.5)
        growths, lasting = rng.integers(0, 5, (2, NV)) * 1.0
        full = rng.integers(-1, 2, NV) * 1.0
        kept, margin, slow, least, slowest, growth, decay, dt = 0.9, 0.5, 0.1, 0.2, 0.5, 1.05, 0.9, 0.01
        now = kept * asked
        if moved.any():
            now = np.where(np.abs(moved) > margin, np.abs(error), now + np.abs(moved))
            lasting_now = np.zeros(NV)
        else:
            lasting_now = lasting
        turned = (np.sign(v) != sign) & (v != 0)
        swings = (peak > least) & (before > 0) & (length + dt < slowest)
        expected = [
            now,
            np.where(turned, np.sign(v), sign),
            np.where(turned, np.abs(v), np.maximum(peak, np.abs(v))),
            np.where(turned, peak, before),
            np.where(turned, np.where(swings & (peak > growth * before), growths + 1, 0), growths),
            np.where(turned, 0, length + dt),
            np.where(turned, np.where(swings & (peak > decay * before), lasting_now + 1, 0), lasting_now),
            np.where((full != 0) & (np.abs(v) < slow), stalled + dt, 0),
            np.where(full * v < 0, yielding + dt, 0),
            np.where(yielding > 0, yielded, np.abs(v)),
        ]
        found = guards.watched(
            asked, sign, peak, before, growths, length, lasting, stalled, yielding, yielded, error,
            moved, v, full, kept, margin, slow, least, slowest, growth, decay, dt,
        )  # fmt: skip
        np.testing.assert_array_equal(found, expected)
