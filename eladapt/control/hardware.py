"""What is known of the hardware around a controller, and what it asks of the gains.

Near rest the semi-implicit law is the stiff PD tau = -M (e/H^2 + v/H): its loop crosses at 1.27/H with
52 degrees of phase left, and its slopes turn measurement noise into torque. Delay and noise both ask for a
longer horizon H; without them H is the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eladapt.errors import require_gain, require_number

# The stiff PD loses its last degree of phase at a delay of 0.71 H (crossover w = 1.27/H, atan(w H) / w).
DELAY_MARGIN = 0.71
MARGIN = 2.0  # by which the delay stays below that
# Of an effort limit: standard deviation of the torque that velocity noise makes through M/H.
NOISE_SHARE = 0.01


@dataclass(frozen=True)
class Hardware:
    """Measurement noise and delay, as far as they are known; nothing of either by default.

    position_noise [rad], velocity_noise [rad/s]: standard deviations, scalar or (nv,), of what differs
    from one sample to the next. delay [s]: from a measurement to the torque that answers it, beyond the
    step that holds it; lag of a velocity filter counts too.
    """

    position_noise: float | np.ndarray = 0.0
    velocity_noise: float | np.ndarray = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        for name in ("position_noise", "velocity_noise"):
            object.__setattr__(self, name, require_gain(name, getattr(self, name), zero=True))
        delay = require_number("delay", self.delay, 0, np.finfo(float).max, closed=True)
        object.__setattr__(self, "delay", delay)

    @property
    def noisy(self) -> bool:
        """Whether any noise is known of."""
        return bool(np.any(self.position_noise) or np.any(self.velocity_noise))


def choose_horizon(
    hardware: Hardware, inertia: np.ndarray, limit: np.ndarray, dt: float
) -> tuple[float, str, str]:
    """H [s], its rule and what was active; inertia max M_ii and limit, the effort limit, (nv,)."""
    late = MARGIN / DELAY_MARGIN * (hardware.delay + dt / 2) if hardware.delay else 0.0
    noise = float(np.max(inertia * hardware.velocity_noise / (NOISE_SHARE * limit)))
    choices = {"sampling": dt, "delay": late, "velocity noise": noise}
    active = max(choices, key=lambda name: choices[name])
    rule = (
        f"max(dt, {MARGIN / DELAY_MARGIN:.1f} (delay + dt/2), max M sigma_v / ({NOISE_SHARE:g} effort)): "
        "the law's slopes near rest are M/H^2 and M/H"
    )
    return choices[active], rule, active
