"""A record with a load, made without a simulation."""

import numpy as np

import eladapt as ea


def loaded(n: int = 2001) -> ea.Record:
    """A two-link arm at rest that carries 2 kg; the estimate is 1 kg until 1 s, 2 kg from then on."""
    robot = ea.Robot.load("two_link")
    q = robot.configuration(robot.target)
    t = np.arange(n) * 1e-3
    times = np.arange(0, t[-1], 1 / 30)
    mass = np.where(times < 1, 1.0, 2.0)
    zeros = np.zeros((n, 2))
    plant = {"class": "PinocchioPlant", "seed": 0,
             "payload": {"class": "Payload", "mass": 2.0, "com": [0, 0, 0], "frame": None,
                         "attach": 0.0, "release": np.inf}}  # fmt: skip
    return ea.Record(
        t=t, q=np.tile(q, (n, 1)), v=zeros, tau=zeros, goal=np.tile(q, (n, 1)), error=zeros,
        parameters=np.zeros((n, 0)), n_potential=0, effort_limit=robot.effort_limit,
        velocity_limit=robot.velocity_limit, dt=1e-3, joint_names=robot.joint_names, parameter_labels=(),
        robot_source=robot.source,
        title="a load", configuration={"plant": plant},
        carried=np.column_stack([times, mass, np.zeros((len(times), 4))]),
    )  # fmt: skip
