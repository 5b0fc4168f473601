"""How well the regressor identities and the filtered regressions hold, robot by robot.

Relative errors, the largest over random states (identities) or along a regulation move at 1 kHz
(regressions). Each identity is judged by a formula that does not use regressors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD

ROBOTS = ("two_link", "double_pendulum", "panda", "ur5", "ur10", "xarm7", "kinova", "z1", "talos_left_arm")
JOINT_TERMS = ("rotor", "viscous", "coulomb", "offset")
STATES = 100
DT = 1e-3
H = 1e-5


def relative(found: list[np.ndarray], expected: list[np.ndarray]) -> float:
    left, right = (np.array([np.ravel(x) for x in side]) for side in (found, expected))
    return float(np.abs(left - right).max() / np.abs(right).max())


def identities(robot: ea.Robot, reg: ea.Regressors) -> dict[str, float]:
    rng = np.random.default_rng(0)
    theta, theta_u = reg.theta, reg.theta_potential
    pairs: dict[str, tuple[list[np.ndarray], list[np.ndarray]]] = {}

    def compare(name: str, found: np.ndarray, expected: np.ndarray) -> None:
        left, right = pairs.setdefault(name, ([], []))
        left.append(found)
        right.append(expected)

    reference = robot.random_configuration(rng)
    rest = np.zeros(robot.nv)
    for _ in range(STATES):
        q = robot.random_configuration(rng)
        v, a, vr, ar = rng.normal(size=(4, robot.nv))
        mass, coriolis, gravity = robot.mass_matrix(q), robot.coriolis_matrix(q, v), robot.gravity(q)
        lost = robot.damping * v + robot.friction * np.sign(v)
        compare("W θ = τ", reg.torque(q, v, a) @ theta, robot.inverse_dynamics(q, v, a) + lost)
        energy = robot.kinetic_energy(q, v) + robot.potential_energy(q) - robot.potential_energy(reference)
        compare("ω θ = E", (reg.energy(q, v) - reg.energy(reference, rest)) @ theta, np.array(energy))
        compare("p θ = M v", reg.momentum(q, v) @ theta, mass @ v)
        compare("Ψ θ_U = g", reg.gravity(q) @ theta_u, gravity)
        expected = mass @ ar + coriolis @ vr + gravity
        expected += robot.damping * vr + robot.friction * np.tanh(vr / reg.coulomb_speed)
        compare("W_r θ", reg.slotine_li(q, v, vr, ar) @ theta, expected)
        ahead, behind = robot.integrate(q, H * v), robot.integrate(q, -H * v)
        rate = (robot.mass_matrix(ahead) - robot.mass_matrix(behind)) / (2 * H)
        compare("Ṁ = C + C'", rate, coriolis + coriolis.T)
        ahead, behind = (robot.integrate(q, s * H * v + H**2 / 2 * a) for s in (1, -1))
        change = (reg.momentum(ahead, v + H * a) - reg.momentum(behind, v - H * a)) / (2 * H)
        balance = change - reg.kinetic_gradient(q, v) + reg.potential_gradient(q) + reg.joint_torque(v)
        compare("ṗ - ∇K + ∇U = W", balance, reg.torque(q, v, a))
    return {name: relative(*sides) for name, sides in pairs.items()}


def regression_errors(robot: ea.Robot, reg: ea.Regressors) -> dict[str, float]:
    """Along half a second of regulation from a non-zero velocity."""
    blocks: dict[str, Any] = {
        "y = Ω θ, force": ea.ForceBalance(reg),
        "force, hermite": ea.ForceBalance(reg, interpolation="hermite"),
        "y = Ω θ, power": ea.PowerBalance(reg),
    }
    controller = KnownGravityPD(robot, ea.CompositeController.for_robot(robot).control)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), np.full(robot.nv, 0.3))
    goal, measurement = robot.configuration(robot.target), plant.reset()
    state = controller.init(measurement)
    states: dict[str, Any] = {name: block.init(measurement) for name, block in blocks.items()}
    worst, largest = dict.fromkeys(blocks, 0.0), dict.fromkeys(blocks, 0.0)
    for _ in range(500):
        state, tau = controller.step(state, measurement, goal, DT)
        measurement = plant.step(tau, DT)
        for name, block in blocks.items():
            states[name], (y, omega) = block.step(states[name], measurement, DT)
            worst[name] = max(worst[name], float(np.abs(y - omega @ reg.theta).max()))
            largest[name] = max(largest[name], float(np.abs(y).max()))
    return {name: worst[name] / largest[name] for name in blocks}


def main() -> None:
    rows, head = [], ["robot"]
    for name in tqdm(ROBOTS, unit="robot"):
        robot = ea.Robot.load(name)
        shared, independent = ea.Regressors(robot), ea.Regressors(robot, "independent")
        terms = ea.Regressors(robot, joint_terms=JOINT_TERMS)
        errors = {**identities(robot, terms), **regression_errors(robot, shared)}
        head = [
            "robot",
            "shared",
            "independent",
            "gravity",
            "rank gap",
            "with joint terms",
            "rank gap",
            *errors,
        ]
        gap = min(shared.rank_gap, independent.rank_gap)
        sizes = [len(shared), len(independent), shared.n_potential, f"{gap:.0e}"]
        sizes += [len(terms), f"{terms.rank_gap:.0e}"]
        rows.append([name, *sizes, *(f"{error:.0e}" for error in errors.values())])
    notes = (
        "The identities are those of the regressors with a rotor, viscous and Coulomb friction and an offset "
        "for every joint; the filtered regressions those of bodies and the model's rotors. Central "
        "differences (H = 1e-5) judge the two columns with a dot; the others are exact formulas."
    )
    write("identities", "Regressor identities: largest relative error", head, rows, notes)


if __name__ == "__main__":
    main()
