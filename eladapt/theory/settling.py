"""By when a run must have settled, by the paper's proofs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from eladapt.errors import require_number
from eladapt.theory.bounds import States, Terms, require_twin, sample_states
from eladapt.theory.gates import Run, WindowLevel, gate_integral, gates_along, window_excitation
from eladapt.theory.lyapunov import LyapunovFunctions

# Of e1, e2 and theta_error in the sampling of c_3, down to where V_FT is homogeneous: on the panda
# sizes from 1e-5 on would give a c_3 that is 60 times too large, from 1e-12 on one 14 % too large.
LEVELS = np.logspace(-15, 3, 28)


class SettlingBounds(NamedTuple):
    """Times by which x = 0, as the proofs of prop:SFT and prop:UFT-IE bound them, and by which the
    parameters alone are there."""

    level: float  # V_FT(x(0)), or alpha_2(R): sampled estimate
    c_3: float  # of (dotVft) on {V_FT <= level}: sampled estimate, 0 where there is none
    needed: float  # integral of the gate [s] that brings V_FT from that level to 0
    window: WindowLevel  # measured
    short_ft: float  # [s] prop:SFT, (Tf1), with that window
    measured: float  # [s] when the run's own integral of the gate has reached ``needed``; inf if it has not
    t_ie: float  # [s] from when on the gate >= phi_m in the run, measured
    phi_m: float
    interval: float  # [s] prop:UFT-IE, T_0
    parameters: float  # [s] by when the indirect term on its own has made theta_error 0; inf if it has not


def settling_bounds(
    functions: LyapunovFunctions,
    record: Run,
    radius: float | None = None,
    *,
    samples: int = 60,
    seed: int = 0,
) -> SettlingBounds:
    """Bounds from a run's gate and from c_3, a sampled estimate; inf where no bound results.

    The gate g is zeta_1 with a scalar mixing and `Unmixed.gate` with none, see `gates_along`.

    (dotVft) as typeset cannot hold for all x: the decay near 0 is of the order of V^sigma_1, which is
    less than V^sigma_2, and far away along e1 it is less than V^sigma_1. What the proofs use does hold
    on {V_FT <= level}: dV_FT/dt <= -gamma3 c_3 zeta_1 V_FT^sigma_1, as in (776). Then the integral of
    zeta_1 that is needed is level^(1 - sigma_1) / ((1 - sigma_1) gamma3 c_3), the first of the two in
    phi_R; the second does not belong to sigma_2, for which 1 - sigma_2 = (2 r_1 + r_2)/(2 m_2).

    The level is V_FT at the start or, with a radius, alpha_2(radius), a sampled estimate too. Assumed:
    that the gates stay as they were after the run (Kreisselmeier's do not, and prop:UFT-IE is about
    least squares), and that every run from within the radius is as excited.

    parameters: |theta_error(0)|^(1 - b) <= (1 - b) rate times the integral of g, parameter by parameter with
    a scalar mixing, of the whole vector with none; the direct term, which moves theta too, is left out.
    """
    weights = functions.weights
    error = functions.estimation_error(record)[:1]
    start = [*(x[:1] for x in (record.error, record.v, record.q)), error]
    level = float(functions("V_FT", *start)[0]) if radius is None else alpha_2(functions, radius, seed=seed)
    c_3 = decay_constant(functions, level, samples, seed)
    rate = (1 - weights.sigma_1) * functions.gamma3 * c_3
    needed = level ** (1 - weights.sigma_1) / rate if rate > 0 else np.inf
    t, gate = record.t, gates_along(functions.controller, record)
    integral, window = gate_integral(t, gate), window_excitation(t, gate)
    floor = np.minimum.accumulate(gate[::-1])[::-1]
    with np.errstate(divide="ignore"):
        times = t - t[0] + needed / floor
    k = int(np.argmin(times))
    short_ft = window.ell * (1 + 2 * needed / window.w) if window.w > 0 else np.inf
    law = functions.controller.law
    size = np.linalg.norm(error) if functions.vector else np.abs(error[0])
    distance = size ** (1 - law.b) / ((1 - law.b) * law.rate) if law.b < 1 else np.inf

    def reached(level: float) -> float:
        return float(t[np.argmax(integral >= level)] - t[0]) if integral[-1] >= level else np.inf

    return SettlingBounds(
        level, c_3, needed, window, short_ft, reached(needed), float(t[k] - t[0]), float(floor[k]),
        float(times[k]), reached(float(np.max(distance))),
    )  # fmt: skip


def alpha_2(functions: LyapunovFunctions, radius: float, samples: int = 200, seed: int = 0) -> float:
    """Sampled estimate of max V_FT over ||x|| <= radius, x = (e1, e2, theta_error) (742)."""
    radius = require_number("radius", radius, 0)
    shares = np.linspace(0, 1, 9)
    best = 0.0
    for e1, e2, error, terms in _states(functions, shares, samples, seed):
        size = np.sqrt(sum(np.sum(x**2, axis=-1) for x in (e1, e2, error)))
        scale = np.divide(radius, size, where=size > 0, out=np.zeros_like(size))[..., None]
        scaled = Terms(scale * terms.momentum, scale**2 * terms.gradient, scale * terms.gravity)
        V = functions.value("V_FT", scale * e1, scale * e2, scale * error, scaled)
        best = max(best, float(V.max()))
    return best


def decay_constant(functions: LyapunovFunctions, level: float, samples: int = 60, seed: int = 0) -> float:
    """Sampled estimate of the largest c_3 with dV_FT/dt <= -gamma3 c_3 zeta_1 V_FT^sigma_1 on
    {V_FT <= level}, whatever zeta_1; 0 if V_FT grows somewhere on it without excitation."""
    best = np.inf
    for e1, e2, error, terms in _states(functions, LEVELS, samples, seed):
        V = functions.value("V_FT", e1, e2, error, terms)
        inside = (level >= V) & (V > 0)
        idle, full = (functions.rate("V_FT", e1, e2, error, terms, zeta)[inside] for zeta in (0.0, 1.0))
        if np.any(idle > 0):
            return 0.0
        best = min(best, float(np.min(-full / V[inside] ** functions.weights.sigma_1, initial=np.inf)))
    return best / functions.gamma3


def _states(functions: LyapunovFunctions, sizes: np.ndarray, samples: int, seed: int) -> Iterator[States]:
    regressors = functions.controller.regressors
    robot, adapted = require_twin(functions.robot, regressors), functions.n_adapted
    return sample_states(robot, regressors, sizes, adapted, errors=sizes, postures=samples, seed=seed)
