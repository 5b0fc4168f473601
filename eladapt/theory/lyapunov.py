"""The paper's Lyapunov functions V_0, V_1, V_A1, V_A2 and V_FT, and their derivatives.

Everything broadcasts over leading axes: e1, e2 (..., nv), q (..., nq), theta_error (..., j).
theta_error is estimate less true value, e1 = q - q_d, e2 = dq/dt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from eladapt.control.finite_time import FiniteTimePD
from eladapt.control.proximal import signed_power
from eladapt.errors import ArgumentError, UnknownNameError, require_number
from eladapt.estimation.adaptation import CompositeLaw
from eladapt.estimation.mixing import Unmixed
from eladapt.regressors.regressors import Regressors
from eladapt.robot.model import Robot
from eladapt.theory.bounds import ModelBounds, Terms, model_bounds, model_terms, require_twin
from eladapt.theory.gates import Run, gates_along

Name = Literal["V_0", "V_1", "V_A1", "V_A2", "V_FT"]
NAMES = ("V_0", "V_1", "V_A1", "V_A2", "V_FT")


class Composite(Protocol):
    """What is asked of a controller: `CompositeController` and `TypesetComposite` have it."""

    @property
    def regressors(self) -> Regressors: ...
    @property
    def law(self) -> CompositeLaw: ...
    @property
    def control(self) -> FiniteTimePD: ...


class Weights(NamedTuple):
    """r_1, r_2 and the degrees made of them; a = b = 1 has r_1 = r_2."""

    r1: float
    r2: float

    @classmethod
    def of(cls, control: FiniteTimePD) -> Weights:
        """Those of a control law (ExponeHom)."""
        return cls(1.0, 1.0) if control.linear else cls(control.r1, control.r2)

    @property
    def m_c(self) -> float:
        """2 r_2 - r_1."""
        return 2 * self.r2 - self.r1

    @property
    def m_2(self) -> float:
        """2 r_2 + r_1, of (SLFVA1)."""
        return 2 * self.r2 + self.r1

    @property
    def sigma_1(self) -> float:
        """(4 r_2 - r_1) / 3 r_2, of (dotVft)."""
        return (4 * self.r2 - self.r1) / (3 * self.r2)

    @property
    def sigma_2(self) -> float:
        """3 r_2 / 2 m_2, of (dotVft); the statement has the reciprocal, the proof this."""
        return 3 * self.r2 / (2 * self.m_2)


def require_composite(controller: Any) -> Composite:
    """ArgumentError for a controller that (278) and (318) do not describe."""
    law, control = getattr(controller, "law", None), getattr(controller, "control", None)
    if not isinstance(law, CompositeLaw) or not isinstance(control, FiniteTimePD):
        raise ArgumentError(
            "controller: expected a CompositeController or TypesetComposite (law: CompositeLaw, control: "
            f"FiniteTimePD), got {type(controller).__name__}"
        )
    return controller


def v_0(control: FiniteTimePD, e1: np.ndarray, e2: np.ndarray, terms: Terms) -> np.ndarray:
    """V_0 = r_1/(2 r_2) e1' P |e1|^a sign(e1) + 1/2 e2' M e2 (ISSLF)."""
    spring = control.P * np.abs(e1) ** (1 + control.a) / (1 + control.a)
    return np.sum(spring + 0.5 * e2 * terms.momentum, axis=-1)


def v_1(
    law: CompositeLaw, control: FiniteTimePD, e1: np.ndarray, e2: np.ndarray, error: np.ndarray, terms: Terms
) -> np.ndarray:
    """V_1 = (gamma1 + gamma2) V_0 + gamma1 d1 [tanh(e1)' M e2 + sum D_L ln cosh(e1)]
    + 1/2 error' Gamma^-1 error (SLFV1)."""
    cross = np.tanh(e1) * terms.momentum + control.D_L * log_cosh(e1)
    parameters = 0.5 * np.sum(error**2 / law.Gamma, axis=-1)
    total = law.gamma1 + law.gamma2
    return total * v_0(control, e1, e2, terms) + law.gamma1 * law.d1 * np.sum(cross, axis=-1) + parameters


def decay(
    law: CompositeLaw, control: FiniteTimePD, e1: np.ndarray, e2: np.ndarray, terms: Terms
) -> np.ndarray:
    """v(e), by which -dV_1/dt = (gamma1 + gamma2) [v(e) + zeta_1 theta_error' Upsilon |theta_error|^b].

    v = e2'(D |e2|^b + D_L e2)
        - k [e2' Sech^2(e1) M e2 + tanh(e1)' C' e2] + k tanh(e1)'(P |e1|^a + D |e2|^b),
    k = gamma1 d1 / (gamma1 + gamma2), every power signed. (defvtta) has a minus before the last
    bracket, and so a decay that is negative at rest; and the line before it has lost the factor
    gamma1 + gamma2. (588) and (587) have the right sign.
    """
    return np.sum(dissipation(law, control, e1, e2) + coupling(law, control, e1, e2, terms), axis=-1)


def dissipation(law: CompositeLaw, control: FiniteTimePD, e1: np.ndarray, e2: np.ndarray) -> np.ndarray:
    """(..., nv) the terms of v(e) that are never negative."""
    k = law.gamma1 * law.d1 / (law.gamma1 + law.gamma2)
    damping = control.D * np.abs(e2) ** (1 + control.b) + control.D_L * e2**2
    return damping + k * np.tanh(e1) * control.P * signed_power(e1, control.a)


def coupling(
    law: CompositeLaw, control: FiniteTimePD, e1: np.ndarray, e2: np.ndarray, terms: Terms
) -> np.ndarray:
    """(..., nv) the terms of v(e) that may have either sign."""
    k = law.gamma1 * law.d1 / (law.gamma1 + law.gamma2)
    inertia = (1 - np.tanh(e1) ** 2) * e2 * terms.momentum
    friction = np.tanh(e1) * (control.D * signed_power(e2, control.b) - terms.gradient)
    return k * (friction - inertia)


def log_cosh(x: np.ndarray) -> np.ndarray:
    """ln cosh(x), without overflow far from 0 and without cancellation near it."""
    size = np.abs(x)
    near = 0.5 * np.log1p(np.sinh(np.minimum(size, 1.0)) ** 2)
    return np.where(size < 1, near, size + np.log1p(np.exp(-2 * size)) - np.log(2))


@dataclass(frozen=True, eq=False)
class LyapunovFunctions:
    """V_0 (ISSLF), V_1 (SLFV1), V_A1 (SLFVA1), V_A2 (SLF3) and V_FT (SLF6) of a controller on a robot.

    Arguments broadcast over leading axes: e1, e2 (..., nv), q (..., nq), theta_error (..., n_adapted).

    gamma3, gamma4 > 0: weights of (SLF3) and (SLF6). d2, d3 > 0: weights of the cross terms of
    (660a) and (SLF6), the largest that (660b) and (d4value) allow when None, from ``bounds``. robot:
    the one that moves, the controller's nominal one when None. bounds: sampled when None.

    Raises ArgumentError for gamma1 or gamma2 = 0, for which V_A1 or the cross terms do not exist,
    and for weights that are not positive.
    """

    controller: Any
    gamma3: float = 0.5
    gamma4: float = 0.5
    d2: float | None = None
    d3: float | None = None
    robot: Robot | None = None
    bounds: ModelBounds | None = None

    def __post_init__(self) -> None:
        law = require_composite(self.controller).law
        for name in ("gamma1", "gamma2"):
            if getattr(law, name) == 0:
                raise ArgumentError(f"law.{name}: expected a positive value for (SLFVA1) and (SLF6), got 0")
        regressors = self.controller.regressors
        object.__setattr__(self, "robot", require_twin(self.robot, regressors))
        if self.bounds is None:
            object.__setattr__(self, "bounds", model_bounds(regressors, robot=self.robot))
        for name, limit in (("d2", d2_limit), ("d3", d3_limit)):
            if getattr(self, name) is None:
                largest = limit(law, self.controller.control, self.bounds)  # type: ignore[arg-type]
                object.__setattr__(self, name, min(largest, np.finfo(float).max))
        for name in ("gamma3", "gamma4", "d2", "d3"):
            object.__setattr__(self, name, require_number(name, getattr(self, name), 0))

    @property
    def weights(self) -> Weights:
        """r_1, r_2 and the degrees made of them (ExponeHom)."""
        return Weights.of(self.controller.control)

    def __call__(
        self, name: Name, e1: np.ndarray, e2: np.ndarray, q: np.ndarray, theta_error: np.ndarray
    ) -> np.ndarray:
        """The function of that name, one of NAMES; nan where V_1 < 0 and a power of it is asked for."""
        return self.value(name, e1, e2, theta_error, self.terms(q, e2, theta_error))

    def along(self, record: Run, name: Name = "V_1") -> np.ndarray:
        """(N,) the function at every sample. Raises RecordError where the true theta is not known."""
        return self(name, record.error, record.v, record.q, self.estimation_error(record))

    def rate_along(self, record: Run, name: Name = "V_1") -> np.ndarray:
        """(N,) the time derivative along (476) at every sample, from the states and the gate there; of an
        unmixed law a bound that it stays below."""
        error = self.estimation_error(record)
        terms = self.terms(record.q, record.v, error)
        gates = gates_along(self.controller, record)
        return self.rate(name, record.error, record.v, error, terms, gates)

    @property
    def vector(self) -> bool:
        """Whether theta follows a vector, and not parameter by parameter."""
        return isinstance(getattr(self.controller, "mixing", None), Unmixed)

    @property
    def n_adapted(self) -> int:
        """How many parameters, the last ones, are adapted: all of them, or theta_U."""
        regressors = self.controller.regressors
        whole = self.vector and self.controller.mixing.scope == "all"
        return len(regressors) if whole else regressors.n_potential

    def estimation_error(self, record: Run) -> np.ndarray:
        """(N, n_adapted) estimate less true value."""
        return record.parameter_error if self.n_adapted > record.theta_error.shape[1] else record.theta_error

    def terms(self, q: np.ndarray, e2: np.ndarray, theta_error: np.ndarray) -> Terms:
        """What the model contributes at each state."""
        arrays = [np.asarray(x, dtype=float) for x in (q, e2, theta_error)]
        return model_terms(self.robot, self.controller.regressors, *arrays)  # type: ignore[arg-type]

    def value(
        self, name: Name, e1: np.ndarray, e2: np.ndarray, theta_error: np.ndarray, terms: Terms
    ) -> np.ndarray:
        """The function of that name where ``terms`` are known already."""
        require_name(name, NAMES)
        law, control = self.controller.law, self.controller.control
        if name == "V_0":
            return v_0(control, e1, e2, terms)
        V = v_1(law, control, e1, e2, theta_error, terms)
        if name == "V_1":
            return V
        r1, r2 = self.weights
        total = self.gamma3 + self.gamma4
        with np.errstate(invalid="ignore"):
            V = V + law.gamma1 ** (-r1 / (2 * r2)) * V ** (self.weights.m_2 / (2 * r2))
            if name == "V_A1":
                return V
            if name == "V_A2":
                size = np.linalg.norm(terms.gravity, axis=-1)
                cross = np.tanh(size) ** (2 * r1 / self.weights.m_c) / (1 + size)
                cross = cross * np.sum(terms.gravity * terms.momentum, axis=-1)
                return total * (V + V ** ((2 * r1 + r2) / (2 * r2))) - self.gamma3 * self.d2 * cross  # type: ignore[operator]
            cross = np.sum(signed_power(e1, 2 * r2 / r1) * terms.momentum, axis=-1)
            return total * (V**1.5 + V**2) + self.gamma3 * self.d3 * cross  # type: ignore[operator]

    def rate(
        self, name: Name, e1: np.ndarray, e2: np.ndarray, theta_error: np.ndarray, terms: Terms,
        zeta: float | np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Time derivative along the closed loop (476) of V_0, V_1, V_A1 or V_FT; zeta: zeta_1 (...).

        Of an unmixed law, for which zeta is `Unmixed.gate`, it is a bound from above. (476) knows neither
        friction nor offsets nor a disturbance estimate: the bound is that of a controller and an arm without.
        That of V_FT has |e_1|^(2 r_2 / r_1) before the feedback, where the proof prints power a.
        """
        require_name(name, ("V_0", "V_1", "V_A1", "V_FT"))
        law, control = self.controller.law, self.controller.control
        feedback = control.law(e1, e2) + terms.gravity
        if name == "V_0":
            spring = control.P * signed_power(e1, control.a)
            return np.sum(e2 * (feedback + spring), axis=-1)
        if self.vector:
            indirect = float(np.min(law.Upsilon)) * np.linalg.norm(theta_error, axis=-1) ** (1 + law.b)
        else:
            indirect = np.sum(law.Upsilon * np.abs(theta_error) ** (1 + law.b), axis=-1)
        rate = -(law.gamma1 + law.gamma2) * (decay(law, control, e1, e2, terms) + zeta * indirect)
        if name == "V_1":
            return rate
        r1, r2 = self.weights
        V = v_1(law, control, e1, e2, theta_error, terms)
        with np.errstate(invalid="ignore"):
            power = law.gamma1 ** (-r1 / (2 * r2)) * V ** (r1 / (2 * r2))
            rate = rate * (1 + self.weights.m_2 / (2 * r2) * power)
            if name == "V_A1":
                return rate
            V = V * (1 + power)
            rate = (self.gamma3 + self.gamma4) * (1.5 * V**0.5 + 2 * V) * rate
        moved = 2 * r2 / r1 * np.abs(e1) ** control.a * e2 * terms.momentum
        pushed = signed_power(e1, 2 * r2 / r1) * (terms.gradient + feedback)
        return rate + self.gamma3 * self.d3 * np.sum(moved + pushed, axis=-1)  # type: ignore[operator]


def d2_limit(law: CompositeLaw, control: FiniteTimePD, bounds: ModelBounds) -> float:
    """The largest d_2 of (660b), with which V_A2 is positive.

    The exponent of k_Psi is (m_3 - r_2)/r_2 = 2 r_1/r_2, as the proof has it and the lemma needs it;
    (660b) prints (m_3 - r_2)/m_c, which is too little for k_Psi < 1.
    """
    r1, r2 = Weights.of(control)
    m_3 = 2 * r1 + r2
    largest = float(np.max(law.Gamma))
    size = (bounds.k_Psi ** (2 * r1 / r2) * bounds.mu_M) ** 2
    if size == 0:
        return float("inf")
    parameters = (m_3 / (2 * largest * (m_3 - r2))) ** ((m_3 - r2) / r2)
    return float(np.sqrt(law.gamma2 * bounds.mu_m * m_3 / (2 * size * r2) * parameters))


def d3_limit(law: CompositeLaw, control: FiniteTimePD, bounds: ModelBounds) -> float:
    """The largest d_3 with which V_FT is positive: (d4value), as its lemma (d1value0) gives it.

    d_3^2 <= gamma_2^3 (3 mu_m / 2 mu_M^2) [3 r_1 p_m / (4 r_2)]^2; printed are 3/4 and the power 1/2.
    """
    r1, r2 = Weights.of(control)
    stiffness = 3 * r1 * float(np.min(control.P)) / (4 * r2)
    return float(np.sqrt(law.gamma2**3 * 1.5 * bounds.mu_m) / bounds.mu_M * stiffness)


def require_name(name: str, legal: tuple[str, ...]) -> None:
    """UnknownNameError for any other name."""
    if name not in legal:
        raise UnknownNameError("Lyapunov function", [name], legal)
