"""What is known of the hardware around a controller, and what it asks of the gains.

Near rest the semi-implicit law is the stiff PD tau = -M (e/H^2 + v/H). Its loop crosses at 1.27/H with 52
degrees of phase left, and its slopes turn measurement noise into torque, so delay, lag and noise ask for a
longer horizon H than the step. What H costs is stiffness: the law answers where a standing torque f that
nothing else compensates would take the arm within H, w = H f/M away, so it gives way by H w and by what
D |w|^b takes (panda, 2 kg that are not compensated: 0.09 rad at 1 ms, 0.24 rad at 10 ms).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eladapt.errors import require_gain, require_number
from eladapt.regressors.regressors import Regressors

# The stiff PD loses its last degree of phase at a delay of 0.71 H: atan(1.27) = 0.71 * 1.27.
DELAY_MARGIN = 0.71
MARGIN = 2.0  # by which the delay stays below that: a plant lighter than its URDF crosses earlier
# A first-order lag T in the velocity alone never makes that PD unstable (Routh); at H = 2 T it keeps a third
# of critical damping.
LAG_MARGIN = 2.0
# Standard deviation of the torque that noise makes through M/H and M/H^2: of an effort limit, and [N m].
NOISE_SHARE, MOST_NOISE = 0.004, 0.33
FLOOR_DEVIATIONS = 3.0  # rows no longer than this many standard deviations of their noise are noise
NOISES = ("position_noise", "velocity_noise")


@dataclass(frozen=True)
class Hardware:
    """Measurement noise, delay, lag and jitter, as far as they are known; none of them by default.

    position_noise [rad], velocity_noise [rad/s]: standard deviations, scalar or (nv,), of what differs
    from one sample to the next. delay [s]: from a measurement to the torque that answers it, beyond the
    step that holds it. velocity_lag [s]: time constant of a first-order filter in the measured velocity.
    jitter [s]: standard deviation of what time stamps are off by, from one measurement to the next.
    """

    position_noise: float | np.ndarray = 0.0
    velocity_noise: float | np.ndarray = 0.0
    delay: float = 0.0
    velocity_lag: float = 0.0
    jitter: float = 0.0

    def __post_init__(self) -> None:
        for name in NOISES:
            object.__setattr__(self, name, require_gain(name, getattr(self, name), zero=True))
        for name in ("delay", "velocity_lag", "jitter"):
            time = require_number(name, getattr(self, name), 0, np.finfo(float).max, closed=True)
            object.__setattr__(self, name, time)

    def of(self, nv: int) -> Hardware:
        """The same by joint, noise (nv,). Raises ArgumentError where there are not nv of them."""
        position, velocity = (require_gain(n, getattr(self, n), nv, zero=True) for n in NOISES)
        return dataclasses.replace(self, position_noise=position, velocity_noise=velocity)


def choose_horizon(
    hardware: Hardware, inertia: np.ndarray, limit: np.ndarray, dt: float
) -> tuple[np.ndarray, str, str]:
    """H (nv,) [s], its rule and what was active; inertia (nv,): max M_ii and a rotor's; limit (nv,)."""
    late = MARGIN / DELAY_MARGIN * (hardware.delay + dt / 2) if hardware.delay else 0.0
    lag = LAG_MARGIN * hardware.velocity_lag
    allowed = inertia / np.minimum(NOISE_SHARE * limit, MOST_NOISE)
    # Held over dt, the law's slopes near rest are stable with an inertia that is taken for up to 2 H/dt times
    # too large: 2 at H = dt, 2.6 at 1.3 dt.
    choices = {
        "sampling": np.full(len(inertia), 1.3 * dt),
        "delay and lag" if late and lag else "delay" if late else "velocity lag": np.full(
            len(inertia), late + lag
        ),
        "velocity noise": allowed * hardware.velocity_noise,
        "position noise": np.sqrt(allowed * hardware.position_noise),
    }
    names = list(choices)
    longest = np.argmax(list(choices.values()), axis=0)
    active = ", ".join(dict.fromkeys(names[k] for k in longest))
    rule = (
        f"max(1.3 dt, {MARGIN / DELAY_MARGIN:.1f} (delay + dt/2) + {LAG_MARGIN:g} lag, "
        f"max M s_v / f, max sqrt(M s_q / f)), f = min({NOISE_SHARE:g} effort, {MOST_NOISE:g} N m): "
        "the law's slopes near rest are M/H and M/H^2"
    )
    return np.max(list(choices.values()), axis=0), rule, active


def choose_floor(
    regressors: Regressors,
    hardware: Hardware,
    postures: Sequence[np.ndarray],
    row_weight: np.ndarray,
    pole: float,
) -> tuple[float, str, str]:
    """The length of a row of Omega that is noise, its rule and what was active.

    White noise s_v passes the force balance's filter as pole M_k s_v in the row of joint i, weighted by
    row_weight; a sample that counts s_t too long or too short as pole s_t W, with W that of the arm at rest.
    """
    noise = np.broadcast_to(hardware.velocity_noise, regressors.robot.nv)
    still, square = np.zeros(regressors.robot.nv), 0.0
    for q in postures:
        mistimed = row_weight[:, None] * pole * hardware.jitter * regressors.torque(q, still, still)
        rows = mistimed**2
        for joint in np.flatnonzero(noise):
            v = np.zeros(regressors.robot.nv)
            v[joint] = noise[joint]
            rows += (row_weight[:, None] * pole * regressors.momentum(q, v)) ** 2
        square += float(np.median(rows.sum(axis=1))) / len(postures)
    rule = f"{FLOOR_DEVIATIONS:g} times what noise of the velocity and jitter make of a row"
    active = [name for name, value in (("noise", noise.any()), ("jitter", hardware.jitter)) if value]
    return FLOOR_DEVIATIONS * float(np.sqrt(square)), rule, " and ".join(active) or "no noise"
