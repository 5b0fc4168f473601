"""Records made without a simulation: a smooth move that ends at the set-point."""

from collections.abc import Callable

import numpy as np
import pytest

import eladapt as ea


def make_record(robot: ea.Robot, duration: float = 1.0, n_parameters: int = 3, **changes) -> ea.Record:
    """A move of a quarter of a radian per joint, at 1 kHz, with estimates that arrive half way."""
    n, rng = round(1000 * duration) + 1, np.random.default_rng(7)
    t = np.arange(n) * 1e-3
    left = np.clip(1 - 1.5 * t / duration, 0, 1)[:, None] ** 3
    away = rng.uniform(0.25, 0.5, robot.nv) * rng.choice([-1, 1], robot.nv)
    start = robot.home if robot.home is not None else np.zeros(robot.nv)
    goal = robot.configuration(start)
    error = left * away
    true = rng.normal(size=n_parameters)
    delta = np.outer(t / duration, np.linspace(1, 0.1, n_parameters)) ** 4
    values = {
        "t": t,
        "q": np.array([robot.integrate(goal, row) for row in error]),
        "v": np.gradient(error, 1e-3, axis=0),
        "tau": 5 * error,
        "goal": np.tile(goal, (n, 1)),
        "error": error,
        "parameters": true * np.clip(2 * t / duration, 0, 1)[:, None],
        "delta": delta,
        "zeta": delta / (delta + 0.1),
        "zeta_integral": np.cumsum(delta, axis=0) * 1e-3,
        "n_potential": n_parameters,
        "effort_limit": robot.effort_limit,
        "velocity_limit": robot.velocity_limit,
        "dt": 1e-3,
        "joint_names": robot.joint_names,
        "parameter_labels": tuple(f"parameter {k}" for k in range(n_parameters)),
        "parameters_true": true,
        "robot_source": robot.source,
        "title": f"{robot.name}, made up",
        "configuration": {},
    }
    return ea.Record(**{**values, **changes})


@pytest.fixture(scope="session")
def record_of() -> Callable[..., ea.Record]:
    """`make_record` by the robot or by its name in the library."""

    def make(robot: str | ea.Robot, *args, **changes) -> ea.Record:
        return make_record(ea.Robot.load(robot) if isinstance(robot, str) else robot, *args, **changes)

    return make
