"""Which of the paper's conditions a set of gains meets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

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
    mass_eigenvalues,
    model_bounds,
    require_twin,
    sample_states,
)  # fmt: skip
from eladapt.theory.lyapunov import (
    coupling,
    d2_limit,
    d3_limit,
    dissipation,
    log_cosh,
    require_composite,
    v_0,
)  # fmt: skip
from eladapt.theory.meaning import Row, meaning

SIZES = np.logspace(-6, 3, 28)  # of e1 [rad] and e2 [rad/s] in the sampled conditions


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
