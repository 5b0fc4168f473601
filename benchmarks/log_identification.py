"""Identification from logs: a real Panda's, and 200 simulated ones of which everything is known.

Simulated: a Panda with its hand, published friction and sensors' noise, controlled from a file whose masses
are up to 20 % wrong and that lacks the hand, through an excitation of 20 s; then once more with 1 kg at the
tool. Takes 50 minutes on two cores; ``--seeds 10`` three.
"""

from __future__ import annotations

import argparse
import functools
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import table
from tqdm import tqdm

import eladapt as ea
from eladapt.regressors.standard import pseudo_inertia
from eladapt.signals import Measurement
from eladapt.simulation.instruments import Wrapper
from eladapt.urdf.editing import Edits

LOG = Path(__file__).resolve().parents[2] / "shared" / "logs" / "panda_exciting.npz"
VISCOUS = np.array([0.7, 0.7, 0.7, 0.7, 0.3, 0.3, 0.3])  # [N m s/rad]
COULOMB = np.array([0.55, 0.87, 0.64, 1.28, 0.84, 0.30, 0.57])  # [N m] Gaz and others, 2019
NOISE = ea.Noise(1e-4, 1e-3)
LOAD, CENTRE = 1.0, (0.02, -0.01, 0.05)  # [kg], [m] in the tool's frame
DURATION, DT = 20.0, 1e-3
POSTURES = 100


class Logged(Wrapper):
    """A plant whose measurements are kept, as a user's log keeps them."""

    def __init__(self, plant: Any):
        super().__init__(plant)
        self.kept: list[Measurement] = []

    def reset(self) -> Measurement:
        self.kept = [self.plant.reset()]
        return self.kept[0].copy()

    def step(self, tau: np.ndarray, dt: float) -> Measurement:
        self.kept.append(self.plant.step(tau, dt))
        return self.kept[-1].copy()

    def log(self) -> ea.Log:
        t, q, v, tau = (np.array([getattr(m, name) for m in self.kept]) for name in ("t", "q", "v", "tau"))
        return ea.Log(t, q, v, tau, self.robot.joint_names, held=True)


class Outcome(NamedTuple):
    """Of one seed."""

    scores: np.ndarray  # (l,) (found - true) / standard deviation
    torque: float  # relative error of another motion's torques
    physical: float  # the same by physical parameters
    gravity: float  # error of the gravity of the new file, as a share of the old one's
    mass: float  # [kg] found
    mass_std: float
    com: np.ndarray  # (3,) [m]
    com_std: np.ndarray
    before: float  # relative error of the wrong file
    seconds: float


def wrong_file(true: ea.Robot, seed: int) -> ea.Robot:
    """Masses and moments of each link up to 20 % off, all to one side of it or the other; no hand."""
    rng = np.random.default_rng(seed)
    bodies: dict[str, list[float] | None] = dict.fromkeys(
        ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    )
    bare = true.edited(Edits(bodies, {}))
    for k in range(1, 8):
        parameters = rng.uniform(0.8, 1.2) * bare.model.inertias[k].toDynamicParameters()
        bodies[f"panda_link{k}"] = [float(x) for x in parameters]
    return true.edited(Edits(bodies, {}))


def logged(robot: ea.Robot, true: ea.Robot, motion: ea.Motion, seed: int, load: bool) -> ea.Log:
    """What a user records."""
    plant = Logged(
        ea.PinocchioPlant(
            true, motion.q0, friction=ea.Friction(VISCOUS, COULOMB), noise=NOISE, seed=seed,
            payload=ea.Payload(LOAD, CENTRE) if load else None,
        )
    )  # fmt: skip
    controller = ea.CompositeController.for_robot(
        robot, DT, position_noise=NOISE.position, velocity_noise=NOISE.velocity
    )
    ea.simulate(controller, plant, motion, DURATION, DT, progress=False)
    return plant.log()


@functools.cache
def motion_for_all() -> ea.Motion:
    """That of a file that is wrong in its own way."""
    return ea.excitation(wrong_file(ea.Robot.load("panda"), 1000), DURATION, rounds=20, progress=False)


def one(seed: int) -> Outcome:
    true = ea.Robot.load("panda")
    robot = wrong_file(true, seed)
    logs = [logged(robot, true, motion_for_all(), 2 * seed + load, bool(load)) for load in (0, 1)]
    began = time.perf_counter()
    found = ea.identify(robot, logs[0], held_out=0, progress=False)
    seconds = time.perf_counter() - began
    loaded = ea.identify(robot, logs[1], held_out=0, physical=False, progress=False)
    regressors = found.regressors
    theta = regressors.theta_of(true.model)
    for name, values in (("viscous", VISCOUS), ("coulomb", COULOMB)):
        theta[regressors.block(name)] = regressors.scale[regressors.block(name)] * values
    _, course = ea.excitation(true, 10.0, rounds=0, seed=7, progress=False).sampled(0.05)
    W = np.array([regressors.torque(*at) for at in zip(course.q, course.v, course.a, strict=True)])
    right = np.linalg.norm(W @ theta)
    assert found.physical is not None
    by = (found.theta, found.physical, regressors.theta)
    errors = [float(np.linalg.norm(W @ (told - theta)) / right) for told in by]
    rng = np.random.default_rng(seed)
    gravity = np.zeros(2)
    for _ in range(POSTURES):
        q = true.random_configuration(rng)
        gravity += [np.sum((arm.gravity(q) - true.gravity(q)) ** 2) for arm in (found.robot, robot)]
    load = loaded.load_since(found)
    return Outcome(
        (found.theta - theta) / found.std, errors[0], errors[1], float(np.sqrt(gravity[0] / gravity[1])),
        load.mass, load.mass_std, load.com, load.com_std, errors[2], seconds,
    )  # fmt: skip


def real() -> tuple[list[list[object]], str]:
    """Rows about the real Panda's log, and a note."""
    if not LOG.is_file():
        return [], "The log of a real Panda was not there."
    robot = ea.Robot.load("panda")
    began = time.perf_counter()
    found = ea.identify(robot, ea.Log.read(LOG), progress=False)
    seconds = time.perf_counter() - began
    rows: list[list[object]] = []
    for name, errors in found.errors.items():
        for kind, values in (("below 10 Hz", errors.raw), ("filtered", errors.filtered)):
            rows.append([f"{name}, {kind}", *(f"{100 * value:.2f}" for value in values)])
    assert found.parameters is not None
    least = [np.linalg.eigvalsh(pseudo_inertia(found.parameters[k : k + 10]))[0] for k in range(0, 70, 10)]
    physical = sum(x > 0 for x in least)
    return rows, f"The log is read and identified in {seconds:.1f} s; {physical} of 7 bodies physical."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        found = list(
            tqdm(pool.map(one, range(options.seeds)), total=options.seeds, desc="seeds", disable=None)
        )
    scores = np.array([outcome.scores for outcome in found])
    of = {name: np.array([getattr(outcome, name) for outcome in found]) for name in Outcome._fields}
    centre = of["com"] - np.array(CENTRE)
    rows = [
        ["base parameters within three standard deviations", _share(np.abs(scores) < 3)],
        ["... root mean square of (found - true) / standard deviation", f"{np.sqrt(np.mean(scores**2)):.3f}"],
        ["... the worst one within three, by seeds", f"{_share((np.abs(scores) < 3).mean(axis=0).min())}"],
        ["torque error of another motion, the wrong file", _spread(100 * of["before"], "%")],
        ["torque error of another motion, identified", _spread(100 * of["torque"], "%")],
        ["torque error of another motion, physical bodies", _spread(100 * of["physical"], "%")],
        ["gravity of the new file, error as a share of the old one's", _spread(of["gravity"], "")],
        ["mass of the load, error", _spread(1e3 * np.abs(of["mass"] - LOAD), "g")],
        ["... within three standard deviations", _share(np.abs(of["mass"] - LOAD) < 3 * of["mass_std"])],
        ["centre of the load, error", _spread(1e3 * np.linalg.norm(centre, axis=1), "mm")],
        ["... its coordinates within three standard deviations", _share(np.abs(centre) < 3 * of["com_std"])],
        ["time to identify", _spread(of["seconds"], "s")],
    ]  # fmt: skip
    measured, note = real()
    head = ["real Panda, held out: torque error [%]", *(f"joint {k}" for k in range(1, 8)), "all"]
    extra = f"\n{table.markdown(head, measured)}\n{note}\n" if measured else f"\n{note}\n"
    said = " ".join(str(__doc__).split("Simulated: ")[1].split())
    head = ["simulated Panda", "figure: median (largest)"]
    table.write(
        "log_identification", f"Identification from logs, {options.seeds} seeds", head, rows, said + extra
    )


def _share(right: np.ndarray | float) -> str:
    return f"{100 * float(np.mean(right)):.2f} %"


def _spread(values: np.ndarray, unit: str) -> str:
    return f"{np.median(values):.3g} ({np.max(values):.3g}) {unit}".strip()


if __name__ == "__main__":
    main()
