"""Which of the paper's conditions a set of gains meets, and by when a run must have settled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from eladapt.control.finite_time import FiniteTimePD
from eladapt.errors import UnknownNameError, require_number
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.theory.bounds import (
    ModelBounds,
    Search,
    States,
    Terms,
    mass_eigenvalues,
    model_bounds,
    require_twin,
    sample_states,
)  # fmt: skip
from eladapt.theory.gates import Run, WindowLevel, gate_integral, gates_along, window_excitation
from eladapt.theory.lyapunov import (
    LyapunovFunctions,
    coupling,
    d2_limit,
    d3_limit,
    dissipation,
    log_cosh,
    require_composite,
    v_0,
)  # fmt: skip
from eladapt.theory.meaning import meaning

SIZES = np.logspace(-6, 3, 28)  # of e1 [rad] and e2 [rad/s] in the sampled conditions
# Of e1, e2 and theta_error in the sampling of c_3, down to where V_FT is homogeneous: on the panda
# sizes from 1e-5 on would give a c_3 that is 60 times too large, from 1e-12 on one 14 % too large.
LEVELS = np.logspace(-15, 3, 28)


class Row(NamedTuple):
    """One condition."""

    name: str  # with the paper's label
    value: float
    limit: float
    holds: bool
    note: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Certificate:
    """The conditions as rows; ``certificate["(530)"]`` is the row with that in its name."""

    title: str
    bounds: ModelBounds
    rows: tuple[Row, ...]

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, label: str) -> Row:
        found = [row for row in self.rows if label in row.name]
        if len(found) != 1:
            raise UnknownNameError("condition", [label], [row.name for row in self.rows])
        return found[0]

    def __repr__(self) -> str:
        holding = sum(row.holds for row in self.rows)
        return f"Certificate({self.title!r}: {holding} of {len(self.rows)} conditions hold)"

    def _repr_html_(self) -> str:
        from eladapt.display import inline

        return inline.certificate(self)

    def __str__(self) -> str:
        cells = [("condition", "value", "limit", "holds")]
        cells += [(r.name, f"{r.value:.4g}", f"{r.limit:.4g}", "yes" if r.holds else "no") for r in self.rows]
        widths = [max(len(row[k]) for row in cells) for k in range(4)]
        lines = [
            f"{name:<{widths[0]}} | {value:>{widths[1]}} | {limit:>{widths[2]}} | {holds}"
            for name, value, limit, holds in cells
        ]
        rule = "-+-".join("-" * width for width in widths)
        mu_m, mu_M, L_c, k_Psi, _ = self.bounds
        sampled = f"mu_m = {mu_m:.4g}, mu_M = {mu_M:.4g}, L_c = {L_c:.4g}, k_Psi = {k_Psi:.4g}"
        notes = [f"{row.name}: {row.note}" for row in self.rows if row.note]
        head = [self.title, f"sampled estimates, no proofs: {sampled}", lines[0], rule]
        return "\n".join([*head, *lines[1:], *notes, *meaning(self.rows)])


def certify(
    controller: Any,
    robot: Robot | None = None,
    dt: float | None = None,
    *,
    d2: float | None = None,
    d3: float | None = None,
    samples: int = 200,
    seed: int = 0,
) -> Certificate:
    """The conditions of the propositions for a controller's gains, with the paper's slips corrected.

    They are on d1 (530), gamma_A1 (602), the weights d2 (660b) and d3 (d4value), V_1 > 0 (SLFV1), v(e) > 0.

    robot: the one that moves, the controller's nominal one when None. dt [s]: adds the sampling
    limits. d2, d3: weights of the cross terms of V_A2 and V_FT, the largest allowed when None.
    The paper's conditions are sufficient; the sampled ones try V_1 and v(e) themselves on ``samples``
    postures, errors from 1e-6 to 1e3, and no sample proves anything.
    Raises ArgumentError for a controller that (278) and (318) do not describe.
    """
    controller = require_composite(controller)
    law, control, regressors = controller.law, controller.control, controller.regressors
    robot = require_twin(robot, regressors)
    bounds = model_bounds(regressors, seed=seed, robot=robot)
    search = Search(robot, samples, seed)
    rows = [*_gain_rows(law, control, bounds, search, robot), *_weight_rows(law, control, bounds, d2, d3)]
    rows += _sampled_rows(law, control, robot, regressors, samples, seed)
    if dt is not None:
        rows += _sampling_rows(control, bounds, search, robot, regressors.robot, require_number("dt", dt, 0))
    plain = (Row(r.name, float(r.value), float(r.limit), bool(r.holds), r.note) for r in rows)
    return Certificate(f"{type(controller).__name__} on {robot.name}", bounds, tuple(plain))


def _gain_rows(
    law: CompositeLaw, control: FiniteTimePD, bounds: ModelBounds, search: Search, robot: Robot
) -> Iterator[Row]:
    d_Lm, nv = float(np.min(control.D_L)), robot.nv
    mu_m, mu_M, L_c, *_ = bounds
    limit = d_Lm * mu_m / mu_M**2
    yield Row("d1 <= d_Lm mu_m / mu_M^2 (530)", law.d1, limit, law.d1 <= limit, "d_Lm = min D_L, not min D")
    limit = d_Lm / mu_M
    note = "sufficient where (530) stands, by completing the square"
    yield Row("d1 <= d_Lm / mu_M", law.d1, limit, law.d1 <= limit, note)
    value = np.inf if law.d1 else 0.0
    if d_Lm > 0 and law.d1:
        scale = 1 / np.sqrt(control.D_L)
        value = law.d1 * search.maximum(lambda x: mass_eigenvalues(robot, x, scale)[-1])
    note = "the same joint by joint: max eigenvalue of d1 D_L^-1 M(q), sampled"
    yield Row("D_L >= d1 M(q)", value, 1.0, value <= 1, note)
    # Appendix "On the non-negativity of v_2", Q_x and Q_y as (587) has them: nu_2 = b/(1 + b), and
    # alpha = 0, since alpha only shares Q_x with a cross term whose coefficient varpi_3 is zero here.
    a, b = control.a, control.b
    gamma_A1 = law.gamma1 / (law.gamma1 + law.gamma2)
    nu_2 = b / (1 + b)
    cross = nv ** ((1 - b) / 2) * float(np.max(control.D)) * nv ** ((b - a) / (2 * (1 + b)))
    share = float(np.min(control.P)) / (2 * cross * (1 - nu_2))
    friction = share ** ((1 - nu_2) / nu_2) * float(np.min(control.D)) / (2 * cross * nu_2)
    inertia = d_Lm / (2 * (mu_M + np.sqrt(nv) * L_c))
    for what, most in (("friction", friction), ("inertia", inertia)):
        limit = most / law.d1 if law.d1 else np.inf
        note = "nu_2 = b/(1 + b), alpha -> 0" if what == "friction" else "mu_M where (587) prints m_2"
        yield Row(f"gamma_A1, {what} bound (602)", gamma_A1, limit, gamma_A1 <= limit, note)


def _weight_rows(
    law: CompositeLaw, control: FiniteTimePD, bounds: ModelBounds, d2: float | None, d3: float | None
) -> Iterator[Row]:
    chosen = (
        ("d2", d2, d2_limit(law, control, bounds), "(660b), V_A2 > 0"),
        ("d3", d3, d3_limit(law, control, bounds), "(d4value), V_FT > 0"),
    )
    for name, given, limit, label in chosen:
        value = limit if given is None else require_number(name, given, 0)
        note = "the largest, chosen" if given is None else ""
        yield Row(f"{name} {label}", value, limit, 0 < value <= limit, note)


def _sampled_rows(
    law: CompositeLaw, control: FiniteTimePD, robot: Robot, regressors: Regressors, samples: int, seed: int
) -> Iterator[Row]:
    """The smallest ratio of V_1 and of v(e) to what each would be without its cross terms."""
    least, where, fails = [np.inf, np.inf], [(0.0, 0.0)] * 2, [np.inf, np.inf]
    none = np.zeros(1)
    grid = sample_states(
        robot, regressors, SIZES, regressors.n_potential, errors=none, postures=samples, seed=seed
    )
    for e1, e2, _, terms in grid:
        certain = (law.gamma1 + law.gamma2) * v_0(control, e1, e2, terms)
        certain = certain + law.gamma1 * law.d1 * np.sum(control.D_L * log_cosh(e1), axis=-1)
        cross = law.gamma1 * law.d1 * np.sum(np.tanh(e1) * terms.momentum, axis=-1)
        lost = np.sum(dissipation(law, control, e1, e2), axis=-1)
        mixed = np.sum(coupling(law, control, e1, e2, terms), axis=-1)
        for k, ratio in enumerate((1 + cross / certain, 1 + mixed / lost)):
            i, j, _ = np.unravel_index(np.argmin(ratio), ratio.shape)
            if ratio[i, j, 0] < least[k]:
                least[k], where[k] = float(ratio[i, j, 0]), (SIZES[i], SIZES[j])
            fails[k] = min(fails[k], np.min(SIZES[np.any(ratio <= 0, axis=(0, 2))], initial=np.inf))
    for k, name in enumerate(("V_1 > 0 (SLFV1), sampled", "v(e) > 0 (defvtta), sampled")):
        at_1, at_2 = where[k]
        note = f"least share that cross terms leave, at ||e1|| = {at_1:.2g}, ||e2|| = {at_2:.2g}"
        if least[k] <= 0:
            note += f"; not positive from ||e2|| = {fails[k]:.2g} on"
        yield Row(name, least[k], 0.0, least[k] > 0, note)


def _sampling_rows(
    control: FiniteTimePD, bounds: ModelBounds, search: Search, robot: Robot, nominal: Robot, dt: float
) -> Iterator[Row]:
    value, limit = float(np.max(control.D_L)) * dt, 2 * bounds.mu_m
    yield Row("max D_L dt < 2 mu_m", value, limit, value < limit, "explicit steps of D_L alone")
    D, nv = np.broadcast_to(control.D, (robot.nv,)), robot.nv

    def fastest(x: np.ndarray) -> float:
        q = robot.configuration(x)
        if control.evaluation == "semi_implicit":
            horizon = np.maximum(dt, dt if control.horizon is None else control.horizon)
            root = np.broadcast_to(1 / np.sqrt(horizon), (nv,))
            slope = nominal.mass_matrix(q) * np.outer(root, root)
        else:
            slope = np.diag(np.broadcast_to(control.D_L, (nv,)) + (D if control.linear else limited(q)))
        return dt * float(scipy.linalg.eigh(slope, robot.mass_matrix(q), eigvals_only=True)[-1])

    def limited(q: np.ndarray) -> np.ndarray:
        """Slope at rest of D |v|^b where it is rounded off, c M_ii / (2 dt)."""
        mass = nominal.mass_matrix(q)
        scale = 1 / np.sqrt(np.diag(mass))
        return 0.5 * np.linalg.eigvalsh(mass * np.outer(scale, scale))[0] * np.diag(mass) / dt

    def chatter(x: np.ndarray) -> float:
        mass = 1 / np.diag(np.linalg.inv(robot.mass_matrix(robot.configuration(x))))
        return float(np.max(D * (dt * D / (2 * mass)) ** (control.b / (1 - control.b))))

    name = "lambda_max((D_L + slope) dt M^-1) <= 1"
    if control.evaluation == "explicit" and not control.linear:
        note = f"|v|^b has no finite slope at rest: chatters by up to about {search.maximum(chatter):.2g} N m"
        yield Row(name, np.inf, 1.0, False, note)
    else:
        value = search.maximum(fastest)
        note = f"slope at rest of the {control.evaluation} evaluation; diverges somewhat above 1"
        yield Row(name, value, 1.0, value <= 1 + 1e-9, note)


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
