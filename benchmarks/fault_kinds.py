"""What goes wrong with a panda: readings, drives, hands and goals that `fault_cases` are made of.

Joints are counted from 1, as on the arm.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import eladapt as ea
from eladapt.robot.protocols import Plant
from eladapt.simulation.faults import Drive, Force, Misdriven, Misread, Push, Reading

ROBOT = ea.Robot.load("panda")
HOME, TARGET = ROBOT.configuration(ROBOT.home), ROBOT.configuration(ROBOT.target)
ALL = range(1, ROBOT.nv + 1)

Kind = Callable[[Plant, float], Plant]  # a plant that has it, from a time [s] on
Goals = Callable[[float], np.ndarray]


def only(*joints: int) -> np.ndarray:
    """(nv,) whether it is one of these."""
    return np.isin(ALL, joints)


def misread(change: Reading) -> Kind:
    return lambda plant, begins: Misread(plant, change, begins)


def misdriven(change: Drive) -> Kind:
    return lambda plant, begins: Misdriven(plant, change, begins)


def pushed(force: tuple[float, float, float] | Force, lasts: float) -> Kind:
    return lambda plant, begins: Push(plant, force, start=begins, end=begins + lasts)


def opposite(*joints: int, q: bool = True) -> Kind:
    """Velocities of the wrong sign, and positions too."""
    sign = np.where(only(*joints), -1.0, 1.0)
    return misread(lambda m, _: m._replace(q=sign * m.q if q else m.q, v=sign * m.v))


def backwards(joint: int) -> Kind:
    """An encoder that counts the wrong way from where it was."""
    sign = np.where(only(joint), -1.0, 1.0)
    return misread(lambda m, good: m._replace(q=good.q + sign * (m.q - good.q), v=sign * m.v))


def swapped(one: int, other: int) -> Kind:
    order = np.arange(ROBOT.nv)
    order[[one - 1, other - 1]] = other - 1, one - 1
    return misread(lambda m, _: m._replace(q=m.q[order], v=m.v[order]))


def shifted(joint: int, by: float) -> Kind:
    """A position that is ``by`` [rad] too much."""
    return misread(lambda m, _: m._replace(q=m.q + by * only(joint)))


def scaled(share: float) -> Kind:
    """Velocities that are a share of what they are."""
    return misread(lambda m, _: m._replace(v=share * m.v))


def dead_encoder(joint: int) -> Kind:
    """An encoder that stays where it was, at no speed."""
    one = only(joint)
    return misread(lambda m, good: m._replace(q=np.where(one, good.q, m.q), v=np.where(one, 0.0, m.v)))


def clock_set(by: float) -> Kind:
    return misread(lambda m, _: m._replace(t=m.t + by))


def clock_shaken(plant: Plant, begins: float) -> Plant:
    """Time stamps that are off by up to 2 ms."""
    rng = np.random.default_rng(0)
    return Misread(plant, lambda m, _: m._replace(t=m.t + rng.uniform(-2e-3, 2e-3)), begins)


def reversed_motors(*joints: int) -> Kind:
    return misdriven(lambda tau, _: np.where(only(*joints), -tau, tau))


def stronger(share: float) -> Kind:
    return misdriven(lambda tau, _: share * tau)


def dead_motor(joint: int) -> Kind:
    return misdriven(lambda tau, _: np.where(only(joint), 0.0, tau))


def stuck_motor(joint: int) -> Kind:
    """A motor that holds its last torque."""
    return misdriven(lambda tau, good: np.where(only(joint), good, tau))


def full_motor(joint: int) -> Kind:
    return misdriven(lambda tau, _: np.where(only(joint), ROBOT.effort_limit, tau))


def swung(by: float) -> Kind:
    """A hand that holds the tool for 4 s, by 1 kN/m and 50 N s/m, and swings it sideways by ``by`` [m] at 0.5
    Hz, all of it after a second."""

    def held(plant: Plant, begins: float) -> Plant:
        grasp: list[np.ndarray] = []

        def force(t: float, x: np.ndarray, speed: np.ndarray) -> np.ndarray:
            if not grasp:
                grasp.append(x)
            aside = by * np.sin(np.pi * (t - begins)) * min(1.0, t - begins)
            return 1e3 * (grasp[0] + aside * np.array([0.0, 1.0, 0.0]) - x) - 50.0 * speed

        return Push(plant, force, start=begins, end=begins + 4.0)

    return held


def jumping(every: float, by: float) -> Goals:
    """Goals within ``by`` [rad] of the target and the joint limits, a new one ``every`` so many seconds."""
    rng = np.random.default_rng(0)
    goals = [np.clip(TARGET + rng.uniform(-by, by, ROBOT.nv), ROBOT.lower, ROBOT.upper) for _ in range(400)]
    return lambda t: goals[int(t / every + 1e-6) % len(goals)]


def nan_from(begins: float) -> Goals:
    return lambda t: TARGET if t < begins else np.full_like(TARGET, np.nan)
