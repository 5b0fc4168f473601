"""The paper's simulation section as it is typeset: two-link arm, C1 to C4, Cases 1 and 2.

Plain numpy, every derivative by hand, nothing shared with the library: this file is what the library is
judged against. Numbers in brackets are the paper's equation labels. Where the paper has a slip, the
corrected equation stands here:

- (443a) has Omega' (y - Omega rho); alpha = beta_0 = xi = 10, and the norm of F is the matrix 2-norm;
- in Cramer's rule the column is replaced by rho - z f0 F rho_0 (443) or by Phi_1 (510), not by Y;
- (419) decays Omega_D2 itself;
- (329) and (471) use one exponent, c = b;
- P = K1 K2 = 3 and D = K1 = 2, as C1 states them, not the other way round;
- C4 adapts along Omega' e_p, with a weight that is 1 in the paper.

The paper does not give, and this file takes: uniform rods, l_c = l / 2 and I = m l^2 / 12; theta(0) = 0;
lambda_0 = lambda_1 = pole; filters that start at Omega(0) = 0, y(0) = 0; lambda_2 = 1 in C3; a floor under
the singular |e|^(a - 1) of C3. It gives no pole, no D_L and no d either: these are arguments of ``run``.

Time runs by explicit Euler: with every state at k, x_{k+1} = x_k + dt xdot_k, and tau_k is a function of the
states at k. theta is ordered delta_1 .. delta_5, and theta_U is (delta_4, delta_5).
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
States = dict[str, Array]
Mixing = Callable[[States, Array], tuple[Array, Array, States]]

# What a controller makes of the states, the measured q and v, and Omega: tau, the rates of its own states,
# and what else is recorded.
Outcome = tuple[Array, States, States]

# The arm: masses [kg], lengths [m], gravity [m/s^2], centres of mass [m], inertias [kg m^2].
m1, m2, l1, l2, gravity_acceleration = 2.0, 1.0, 0.3, 0.2, 9.81
lc1, lc2 = l1 / 2, l2 / 2
I1, I2 = m1 * l1**2 / 12, m2 * l2**2 / 12

delta1 = (l1**2 + lc2**2) * m2 + lc1**2 * m1 + I1 + I2
delta2 = l1 * lc2 * m2
delta3 = lc2**2 * m2 + I2
delta4 = m2 * lc2 * gravity_acceleration
delta5 = (m1 * lc1 + m2 * l1) * gravity_acceleration
THETA = np.array([delta1, delta2, delta3, delta4, delta5])

# The task.
Q_D = np.array([2.0, 2.0])
Q_0 = np.array([3.0, 0.0])

# (ExponeHom) with r_1 = 1.5, r_2 = 1: m_c = 1/2, a = 1/3, b = 1/2; c = b.
r1, r2 = 1.5, 1.0
m_c = 2 * r2 - r1
a, b = m_c / r1, m_c / r2
c = b

# C1 and C2: (278), (318).
P, D = 3.0, 2.0
gamma1, gamma2, d1 = 0.3, 0.7, 5.0
Gamma_U, Upsilon_U = 1.0, 50.0

# C1: (443), with rho_0 = 0. C4 shares the four numbers: p_0 = f0, k_0 = xi.
alpha, beta0, xi, f0 = 10.0, 10.0, 10.0, 1.0
RHO_0 = np.zeros(5)

# (510): lambda_2 of C2 and C3, lambda_3 of C2 and of C3.
lambda2, lambda3_C2, lambda3_C3 = 1.0, 1.3, 1.0

# C3 and C4.
K1, K2, Ks = 2.0, 1.5, 0.6


def power(x: Array, exponent: float) -> Array:
    """Signed power of each element: sign(x) |x|^exponent."""
    return np.sign(x) * np.abs(x) ** exponent


def unit(x: Array) -> Array:
    """x / ||x||, and 0 at x = 0."""
    norm = np.linalg.norm(x)
    return x / norm if norm > 0 else np.zeros_like(x)


def mass_matrix(q: Array) -> Array:
    """M(q) of (237), (2, 2)."""
    c2 = np.cos(q[1])
    return np.array([[delta1 + 2 * delta2 * c2, delta3 + delta2 * c2], [delta3 + delta2 * c2, delta3]])


def coriolis_matrix(q: Array, v: Array) -> Array:
    """C(q, v) of (237), (2, 2); Mdot = C + C' is (205)."""
    s2 = np.sin(q[1])
    return np.array([[-delta2 * s2 * v[1], -delta2 * s2 * (v[0] + v[1])], [delta2 * s2 * v[0], 0.0]])


def gravity(q: Array) -> Array:
    """g(q) = grad U(q) of (209), (2,)."""
    s1, s12 = np.sin(q[0]), np.sin(q[0] + q[1])
    return np.array([delta4 * s12 + delta5 * s1, delta4 * s12])


def potential_gradient(q: Array) -> Array:
    """Psi(q) of (415), (2, 2), the same as varphi_2 of (419): Psi theta_U = g. Columns delta_4, delta_5."""
    s1, s12 = np.sin(q[0]), np.sin(q[0] + q[1])
    return np.array([[s12, s1], [s12, 0.0]])


def momentum(q: Array, v: Array) -> Array:
    """varphi_3 of (419), (2, 3): columns M_k(q) v for delta_1, delta_2, delta_3."""
    c2 = np.cos(q[1])
    return np.array([[v[0], c2 * (2 * v[0] + v[1]), v[1]], [0.0, c2 * v[0], v[0] + v[1]]])


def kinetic_gradient(q: Array, v: Array) -> Array:
    """Columns grad_q {v' M_k(q) v} of (401), (2, 3). Only M_2 depends on q, and only on q_2:
    v' M_2 v = cos(q_2) (2 v_1^2 + 2 v_1 v_2)."""
    s2 = np.sin(q[1])
    return np.array([[0.0, 0.0, 0.0], [0.0, -s2 * (2 * v[0] ** 2 + 2 * v[0] * v[1]), 0.0]])


def torque_regressor(q: Array, v: Array, vr: Array, ar: Array) -> Array:
    """W of (defW), (2, 5): W theta = M ar + C vr + g."""
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    s1, s12 = np.sin(q[0]), np.sin(q[0] + q[1])
    W12 = c2 * (2 * ar[0] + ar[1]) - s2 * (v[1] * vr[0] + (v[0] + v[1]) * vr[1])
    W21 = c2 * ar[0] + s2 * v[0] * vr[0]
    return np.array([[ar[0], W12, ar[1], s12, s1], [0.0, W21, ar[0] + ar[1], s12, 0.0]])


def force_balance(x: States, q: Array, v: Array, pole: float) -> Array:
    """Omega = [Omega_D1, Omega_D2] of (419), (2, 5), with Omega_D1 = z + lambda_0 varphi_3."""
    return np.hstack([x["z_D1"] + pole * momentum(q, v), x["omega_D2"]])


def force_balance_rates(x: States, q: Array, v: Array, tau: Array, pole: float) -> States:
    """Rates of y (399), Omega_D2 and z (419)."""
    lambda0 = lambda1 = pole
    phi1 = lambda0 * momentum(q, v) + lambda0 / (2 * lambda1) * kinetic_gradient(q, v)
    return {
        "y": -lambda1 * x["y"] + lambda0 * tau,
        "omega_D2": -lambda1 * x["omega_D2"] + lambda0 * potential_gradient(q),
        "z_D1": -lambda1 * (x["z_D1"] + phi1),
    }


def forgetting(F: Array) -> Array:
    """beta of (443), and of (estimadorDREMorig) with F = P: a scalar; the norm is the 2-norm."""
    return np.asarray(beta0 * (1 - np.linalg.norm(F, 2) / xi))


def cramer(Phi: Array, phi: Array) -> tuple[Array, Array]:
    """Y = adj{Phi} phi (5,) by Cramer's rule, and Delta = det Phi: column j of Phi replaced by phi."""
    Y = np.zeros(5)
    for j in range(5):
        Phi_j = Phi.copy()
        Phi_j[:, j] = phi
        Y[j] = np.linalg.det(Phi_j)
    return Y, np.asarray(np.linalg.det(Phi))


def least_squares(x: States, omega: Array) -> tuple[Array, Array, States]:
    """(488) and (443): Y, Delta, and the rates of rho, F and z."""
    rho, F, z = x["rho"], x["F"], x["z"]
    beta = forgetting(F)
    Y, Delta = cramer(np.eye(5) - z * f0 * F, rho - z * f0 * F @ RHO_0)
    rates = {
        "rho": alpha * F @ omega.T @ (x["y"] - omega @ rho),
        "F": -alpha * F @ omega.T @ omega @ F + beta * F,
        "z": -beta * z,
    }
    return Y, Delta, rates


def kreisselmeier_rates(x: States, omega: Array, lambda3: float) -> States:
    """(510): rates of Phi_1 and Phi_2."""
    return {
        "Phi1": -lambda2 * x["Phi1"] + lambda3 * omega.T @ x["y"],
        "Phi2": -lambda2 * x["Phi2"] + lambda3 * omega.T @ omega,
    }


def kreisselmeier(x: States, omega: Array) -> tuple[Array, Array, States]:
    """(832) and (510): Y, Delta, and the rates of Phi_1 and Phi_2, as C2 has them."""
    Y, Delta = cramer(x["Phi2"], x["Phi1"])
    return Y, Delta, kreisselmeier_rates(x, omega, lambda3_C2)


def composite(x: States, q: Array, v: Array, omega: Array, mix: Mixing, D_L: float, d: float) -> Outcome:
    """C1 and C2: the control law (278) with the adaptation law (318), (fphi), (471)."""
    e1, e2 = q - Q_D, v
    theta_U, Psi = x["theta"], potential_gradient(q)
    Y, Delta, rates = mix(x, omega)

    tau = -P * power(e1, a) - D * power(e2, b) - D_L * e2 + Psi @ theta_U

    Xi = power(Delta * theta_U - Y[3:], c)
    f = power(Delta, d) / (1 + np.abs(Delta) ** (c + d))
    rates["theta"] = (
        -Gamma_U * Psi.T @ (gamma1 * d1 * np.tanh(e1) + (gamma1 + gamma2) * e2)
        - (gamma1 + gamma2) * Gamma_U * Upsilon_U * f * Xi
    )
    return tau, rates, {"Y": Y, "delta": Delta}


def linear_reference(q: Array, v: Array) -> tuple[Array, Array]:
    """(AsymptoticAC): s (2,) and W(q, v, vr, ar) (2, 5) of C4, and of C3 where (795) is > 0."""
    e1 = q - Q_D
    return v + K2 * e1, torque_regressor(q, v, -K2 * e1, -K2 * v)


def terminal_reference(q: Array, v: Array, floor: float) -> tuple[Array, Array]:
    """(stsmvar): s and W of C3 where (795) is <= 0; |e_i| is at least ``floor`` in ar, singular at 0."""
    e1 = q - Q_D
    vr = -K2 * power(e1, a)
    ar = -a * K2 * np.maximum(np.abs(e1), floor) ** (a - 1) * v
    return v + K2 * power(e1, a), torque_regressor(q, v, vr, ar)


def sliding(x: States, q: Array, v: Array, omega: Array, floor: float) -> Outcome:
    """C3: the switch (795), of the true M; where it is <= 0 tau_1 with (63), else tau_2 with its own law."""
    e1, e2, theta = q - Q_D, v, x["theta"]
    Theta = x["Phi2"] @ theta - x["Phi1"]
    M, surface = mass_matrix(q), K2 * power(e1, a)
    switch = e2 @ M @ e2 - np.linalg.eigvalsh(M)[-1] * (surface @ surface)

    rates = kreisselmeier_rates(x, omega, lambda3_C3)
    if switch <= 0:
        Gamma, k = 0.001, 5000.0
        s, W = terminal_reference(q, v, floor)
        rates["theta"] = -Gamma * W.T @ s - Gamma * k * x["Phi2"].T @ unit(Theta)
    else:
        Gamma, k = 1.0, 50.0
        s, W = linear_reference(q, v)
        rates["theta"] = -Gamma * W.T @ s - Gamma * k * Theta
    return W @ theta - K1 * s - Ks * unit(s), rates, {}


def slotine_li(x: States, q: Array, v: Array, omega: Array, weight: float) -> Outcome:
    """C4: tau_s of (AsymptoticAC) with the adaptation (estimadorDREMorig)."""
    theta, gain = x["theta"], x["P"]
    s, W = linear_reference(q, v)
    e_p = omega @ theta - x["y"]
    rates = {
        "theta": -gain @ (W.T @ s + weight * omega.T @ e_p),
        "P": -alpha * gain @ omega.T @ omega @ gain + forgetting(gain) * gain,
    }
    return W @ theta - K1 * s, rates, {}


def noise(case: int, t: float) -> tuple[Array, Array]:
    """n_q and n_v at t: none in Case 1."""
    if case == 1:
        return np.zeros(2), np.zeros(2)
    n_q = 0.005 * np.array([np.sin(100 * t), np.cos(100 * t)])
    n_v = 0.005 * np.array([np.sin(100 * t), np.sin(100 * t)])
    return n_q, n_v


def friction(case: int, v: Array) -> Array:
    """tau_f of the true velocity, M vdot + C v + g + tau_f = tau: none in Case 1."""
    return np.zeros(2) if case == 1 else np.array([0.5, 0.4]) * np.sign(v)


def initial_states(name: str, case: int, pole: float) -> States:
    """Every state at t = 0; z_D1 = -lambda_0 varphi_3 makes Omega_D1(0) = 0."""
    n_q, n_v = noise(case, 0.0)
    x: States = {"q": Q_0.copy(), "v": np.zeros(2), "y": np.zeros(2), "omega_D2": np.zeros((2, 2))}
    x["z_D1"] = -pole * momentum(Q_0 + n_q, n_v)
    x["theta"] = np.zeros(2 if name in ("C1", "C2") else 5)
    if name == "C1":
        x |= {"rho": RHO_0.copy(), "F": np.eye(5) / f0, "z": np.ones(())}
    elif name == "C4":
        x |= {"P": np.eye(5) / f0}
    else:
        x |= {"Phi1": np.zeros(5), "Phi2": np.zeros((5, 5))}
    return x


def run(
    name: str,
    case: int = 1,
    *,
    pole: float,
    linear_damping: float | None = None,
    d: float | None = None,
    duration: float = 1.0,
    dt: float = 5e-4,
    floor: float = 1e-3,
    weight: float = 1.0,
) -> States:
    """Simulate controller ``name``, "C1" to "C4", in Case 1 or 2.

    pole: lambda_0 = lambda_1 [1/s]. linear_damping: D_L [N m s/rad] and d: exponent of (fphi) [-], which C1
    and C2 need. floor: least |e_i| [rad] in C3's reference acceleration. weight: of Omega' e_p in C4.

    Returns arrays with one row for each t = k dt, k = 0 .. N = round(duration / dt): t, the true q and v,
    tau, theta, (N+1, 2) for C1 and C2, (N+1, 5) for C3 and C4; y and omega of (NLRPE); and for C1 and C2 Y
    (N+1, 5) and delta (N+1,). The states of the filters at the end stand under "final_" and their name:
    y, omega_D2, z_D1, and rho, F, z (C1), Phi1, Phi2 (C2, C3) or P (C4).
    """
    controller: Callable[[States, Array, Array, Array], Outcome]
    if name in ("C1", "C2"):
        if linear_damping is None or d is None:
            raise ValueError(f"{name} needs linear_damping and d, for which the paper has no value")
        mix = least_squares if name == "C1" else kreisselmeier
        controller = partial(composite, mix=mix, D_L=linear_damping, d=d)
    elif name == "C3":
        controller = partial(sliding, floor=floor)
    elif name == "C4":
        controller = partial(slotine_li, weight=weight)
    else:
        raise ValueError(f"no controller {name!r}: there are C1, C2, C3 and C4")
    if case not in (1, 2):
        raise ValueError(f"no case {case!r}: there are 1 and 2")

    steps = round(duration / dt)
    x = initial_states(name, case, pole)
    rows: list[States] = []
    for k in range(steps + 1):
        n_q, n_v = noise(case, k * dt)
        q, v = x["q"] + n_q, x["v"] + n_v
        omega = force_balance(x, q, v, pole)
        tau, rates, mixed = controller(x, q, v, omega)
        true = {key: x[key] for key in ("q", "v", "theta", "y")}
        rows.append({"t": np.asarray(k * dt), "tau": tau, "omega": omega, **true, **mixed})
        if k == steps:
            break
        rates |= force_balance_rates(x, q, v, tau, pole)
        rates["q"] = x["v"]
        load = coriolis_matrix(x["q"], x["v"]) @ x["v"] + gravity(x["q"]) + friction(case, x["v"])
        rates["v"] = np.linalg.inv(mass_matrix(x["q"])) @ (tau - load)
        x = {key: x[key] + dt * rates[key] for key in x}

    record = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    return record | {f"final_{key}": x[key] for key in x if key not in ("q", "v", "theta")}
