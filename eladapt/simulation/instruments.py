"""What stands between a controller and an arm: encoders that count, noise, a bus that takes its time.

Each wraps a plant and has its face, so that they can be put on top of each other.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from eladapt.errors import ArgumentError, require_number
from eladapt.robot.model import Robot
from eladapt.robot.protocols import Load, Plant, Rubbing, truth_of
from eladapt.signals import Measurement
from eladapt.simulation.disturbances import Noise
from eladapt.simulation.plants import NoiseModel


class Wrapper:
    """A plant seen through something; ``q`` and ``v`` stay the true state."""

    def __init__(self, plant: Plant):
        self.plant = plant

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.plant!r})"

    @property
    def robot(self) -> Robot:
        return self.plant.robot

    @property
    def payload(self) -> Load | None:
        """The load of the arm inside."""
        return truth_of(self.plant).load

    @property
    def rubbing(self) -> Rubbing | None:
        """The friction of the arm inside."""
        return truth_of(self.plant).rubbing

    @property
    def knows_parameters(self) -> bool:
        """Whether the arm inside is the robot's own model."""
        return truth_of(self.plant).known

    @property
    def q(self) -> np.ndarray:
        return self.plant.q

    @property
    def v(self) -> np.ndarray:
        return self.plant.v

    def brake(self) -> None:
        """Tell the brakes of the arm inside to close."""
        self.plant.brake()

    def release(self) -> None:
        """Open them."""
        self.plant.release()


class Encoders(Wrapper):
    """Positions in whole counts of a turn, velocities from their filtered differences.

    counts: of one turn (or of 2 pi m on a prismatic joint). time_constant [s]: of the first-order filter
    behind the differences, of which one count makes 2 pi / (counts dt).
    """

    def __init__(self, plant: Plant, counts: int = 2**17, time_constant: float = 5e-3):
        super().__init__(plant)
        if counts < 1:
            raise ArgumentError(f"counts: expected at least 1, got {counts}")
        self.resolution = 2 * np.pi / counts
        self.time_constant = require_number("time_constant", time_constant, 0)

    def reset(self) -> Measurement:
        """The plant's first measurement, counted; the velocity starts at the plant's."""
        measurement = self.plant.reset()
        self._q, self._v = self._counted(measurement.q), measurement.v
        return measurement._replace(q=self._q.copy(), v=self._v.copy())

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) for dt [s]."""
        measurement = self.plant.step(tau, dt)
        q = self._counted(measurement.q)
        speed = self.robot.difference(self._q, q) / dt
        share = -np.expm1(-dt / self.time_constant)
        self._q, self._v = q, self._v + share * (speed - self._v)
        return measurement._replace(q=q.copy(), v=self._v.copy())

    def noise(self, dt: float) -> Noise:
        """What counting amounts to in a moving joint, for steps of dt [s]: a uniform, white error
        of 1/sqrt(12) counts, of which the filtered differences make (s/dt) sqrt(2 / (2 - s)) as much
        velocity, s being the filter's share. A resting joint has none."""
        share = -np.expm1(-dt / self.time_constant)
        position = self.resolution / np.sqrt(12)
        return Noise(position, position * share / dt * np.sqrt(2 / (2 - share)))

    def _counted(self, q: np.ndarray) -> np.ndarray:
        coordinates = self.robot.coordinates(q)
        return self.robot.configuration(self.resolution * np.round(coordinates / self.resolution))


class FilteredVelocity(Wrapper):
    """Measured velocities behind a first-order filter with this time constant [s], as drives have them."""

    def __init__(self, plant: Plant, time_constant: float):
        super().__init__(plant)
        self.time_constant = require_number("time_constant", time_constant, 0)

    def reset(self) -> Measurement:
        """The plant's first measurement, with the filter at rest there."""
        measurement = self.plant.reset()
        self._t, self._v = measurement.t, measurement.v.copy()
        return measurement

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) for dt [s]."""
        measurement = self.plant.step(tau, dt)
        share = -np.expm1((self._t - measurement.t) / self.time_constant)
        self._t, self._v = measurement.t, self._v + share * (measurement.v - self._v)
        return measurement._replace(v=self._v.copy())


class NoisyReadings(Wrapper):
    """Noise on top of what the plant measures, as encoders do; a plant's own noise comes before them.

    seed: of the noise.
    """

    def __init__(self, plant: Plant, noise: NoiseModel, seed: int = 0):
        super().__init__(plant)
        self.readings, self.seed = noise, seed

    def reset(self) -> Measurement:
        """The plant's first measurement, with noise from its seed."""
        self._rng = np.random.default_rng(self.seed)
        return self._noisy(self.plant.reset())

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Hold the torque tau (nv,) for dt [s]."""
        return self._noisy(self.plant.step(tau, dt))

    def _noisy(self, measurement: Measurement) -> Measurement:
        dq, dv = self.readings.sample(measurement.t, self.robot.nv, self._rng)
        q = self.robot.integrate(measurement.q, np.asarray(dq))
        return measurement._replace(q=q, v=measurement.v + dv)


class Delay(Wrapper):
    """A torque that acts ``delay`` [s] after it was commanded, in whole steps; zero until the first does.

    The measurement's tau is the torque that acted, as a drive would report it.
    """

    def __init__(self, plant: Plant, delay: float):
        super().__init__(plant)
        self.delay = require_number("delay", delay, 0, np.finfo(float).max, closed=True)
        self._queue: deque[np.ndarray] = deque()

    def reset(self) -> Measurement:
        """The plant's first measurement, with nothing on its way."""
        self._queue.clear()
        return self.plant.reset()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        """Send the torque tau (nv,) and let dt [s] pass."""
        self._queue.append(np.array(tau, dtype=float))
        late = len(self._queue) > round(self.delay / dt)
        return self.plant.step(self._queue.popleft() if late else np.zeros(self.robot.nv), dt)
