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
# Of an effort limit: standard deviation of the torque that noise makes through M/H and M/H^2.
NOISE_SHARE = 0.04
# The gate that noise may open in a resting arm, and the range of xi over which that is kept: below 1e4 the
# estimate takes seconds (panda: 2.0 s to 5e-3 rad at 1e3, 1.3 s at 1e4).
NOISE_GATE = 0.01
LEAST_XI, QUIET_XI = 1e4, 1e8
NOISES = ("position_noise", "velocity_noise")


@dataclass(frozen=True)
class Hardware:
    """Measurement noise, delay and lag, as far as they are known; none of them by default.

    position_noise [rad], velocity_noise [rad/s]: standard deviations, scalar or (nv,), of what differs
    from one sample to the next. delay [s]: from a measurement to the torque that answers it, beyond the
    step that holds it. velocity_lag [s]: time constant of a first-order filter in the measured velocity.
    """

    position_noise: float | np.ndarray = 0.0
    velocity_noise: float | np.ndarray = 0.0
    delay: float = 0.0
    velocity_lag: float = 0.0

    def __post_init__(self) -> None:
        for name in NOISES:
            object.__setattr__(self, name, require_gain(name, getattr(self, name), zero=True))
        for name in ("delay", "velocity_lag"):
            time = require_number(name, getattr(self, name), 0, np.finfo(float).max, closed=True)
            object.__setattr__(self, name, time)

    def of(self, nv: int) -> Hardware:
        """The same by joint, noise (nv,). Raises ArgumentError where there are not nv of them."""
        position, velocity = (require_gain(n, getattr(self, n), nv, zero=True) for n in NOISES)
        return dataclasses.replace(self, position_noise=position, velocity_noise=velocity)


def choose_horizon(
    hardware: Hardware, inertia: np.ndarray, limit: np.ndarray, dt: float
) -> tuple[float, str, str]:
    """H [s], its rule and what was active; inertia max M_ii and limit, the effort limit, (nv,)."""
    late = MARGIN / DELAY_MARGIN * (hardware.delay + dt / 2) if hardware.delay else 0.0
    lag = LAG_MARGIN * hardware.velocity_lag
    allowed = inertia / (NOISE_SHARE * limit)
    choices = {
        "sampling": dt,
        "delay and lag" if late and lag else "delay" if late else "velocity lag": late + lag,
        "velocity noise": float(np.max(allowed * hardware.velocity_noise)),
        "position noise": float(np.max(np.sqrt(allowed * hardware.position_noise))),
    }
    active = max(choices, key=lambda name: choices[name])
    rule = (
        f"max(dt, {MARGIN / DELAY_MARGIN:.1f} (delay + dt/2) + {LAG_MARGIN:g} lag, "
        f"max M s_v / ({NOISE_SHARE:g} effort), max sqrt(M s_q / ({NOISE_SHARE:g} effort))): "
        "the law's slopes near rest are M/H and M/H^2"
    )
    return choices[active], rule, active


def choose_floor(
    regressors: Regressors,
    hardware: Hardware,
    postures: Sequence[np.ndarray],
    row_weight: np.ndarray,
    filters: tuple[float, float, float],
) -> tuple[float, str, str]:
    """xi, its rule and what was active; filters: pole, alpha and beta [1/s] of the estimator.

    White noise s_v passes the force balance's filter as pole M_k s_v, and accumulates
    alpha/beta |row_weight pole M_k s_v|^2 in gravity parameter k while the arm rests. The median over the
    parameters counts: one whose gravity is dust (so_arm101's first joint stands upright but for the last
    digit of its URDF) is scaled up a million times and says nothing of the others.
    """
    pole, alpha, beta = filters
    robot, noise = regressors.robot, np.broadcast_to(hardware.velocity_noise, regressors.robot.nv)
    information = np.zeros(regressors.n_potential)
    for q in postures:
        for joint in np.flatnonzero(noise):
            v = np.zeros(robot.nv)
            v[joint] = noise[joint]
            momentum = regressors.momentum(q, v)[:, len(regressors) - regressors.n_potential :]
            information += np.sum((row_weight[:, None] * pole * momentum) ** 2, axis=0) / len(postures)
    rest = alpha / beta * float(np.median(information)) if len(information) else 0.0
    wanted = NOISE_GATE / rest if rest else np.inf
    rule = (
        f"{NOISE_GATE:g} / (what noise accumulates in a resting arm), from {LEAST_XI:g} to {QUIET_XI:g}: "
        "the information floor 1/xi"
    )
    active = "no noise" if not rest else "noise" if LEAST_XI < wanted < QUIET_XI else "range"
    return float(np.clip(wanted, LEAST_XI, QUIET_XI)), rule, active
