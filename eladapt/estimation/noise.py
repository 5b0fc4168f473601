"""Measurement noise from a quiet record, from which a controller's horizon and information floor follow."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from eladapt.errors import ArgumentError
from eladapt.robot.model import Robot
from eladapt.signals import Measurement

LEAST_SAMPLES = 50  # a standard deviation is then known to about 15 %
MAD_TO_STD = 1.482602  # of a Gaussian
SECOND_DIFFERENCE = np.sqrt(6.0)  # standard deviation of n[k+1] - 2 n[k] + n[k-1] for white n of 1
# Encoders whose noise is below a count repeat themselves, so the median is 0. Then the mean square counts,
# less the largest hundredth; its root is this part of a Gaussian's standard deviation.
KEPT, KEPT_STD = 0.99, 0.9616


class MeasuredNoise(NamedTuple):
    """Standard deviations by joint; the names are those of `CompositeController.for_robot`."""

    position_noise: np.ndarray  # (nv,) [rad or m]
    velocity_noise: np.ndarray  # (nv,) [rad/s or m/s]


def measure_noise(robot: Robot, measurements: Iterable[Measurement]) -> MeasuredNoise:
    """White noise of positions and velocities, from evenly sampled measurements of an arm at rest.

    ``for_robot(robot, **measure_noise(robot, measurements)._asdict())`` takes it into account. The arm
    should stand on its brakes, or hold still under a constant torque: feedback turns noise into motion,
    which then counts as noise. What counts is the median absolute second difference, which neither drift
    nor glitches change much.

    A velocity that comes from a filter has noise that is not white, of which this sees the part that changes
    from sample to sample; tell ``for_robot`` the filter's velocity_lag too. Raises ArgumentError for fewer
    than 50 measurements, and for what is no measurement of this robot.
    """
    taken = list(measurements)
    if len(taken) < LEAST_SAMPLES:
        raise ArgumentError(f"measurements: expected at least {LEAST_SAMPLES}, got {len(taken)}")
    for measurement in taken:
        robot.check_measurement(measurement)
    steps = [robot.difference(a.q, b.q) for a, b in pairwise(taken)]
    velocities = np.array([measurement.v for measurement in taken])
    return MeasuredNoise(_deviation(np.diff(steps, axis=0)), _deviation(np.diff(velocities, n=2, axis=0)))


def _deviation(second_differences: np.ndarray) -> np.ndarray:
    """Standard deviation by column (nv,) of white noise with these second differences (N, nv)."""
    size = np.sort(np.abs(second_differences), axis=0)
    robust = MAD_TO_STD * np.median(size, axis=0)
    kept = size[: max(1, int(KEPT * len(size)))]
    mean_square = np.sqrt(np.mean(kept**2, axis=0)) / KEPT_STD
    return np.where(robust > 0, robust, mean_square) / SECOND_DIFFERENCE
