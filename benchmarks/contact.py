"""What a panda feels of a push at its tool, and whether it tells a push from a load.

First: from no knowledge of itself it makes two moves, rests, and is pushed with 30 N in random directions;
the external torque that it reports 0.1 s later is compared with J' f. Second: it rests in a random posture,
and 0.6 s after the start it is either pushed with 20 N in a random direction or given 2 kg near its tool.
"""

from __future__ import annotations

import argparse
import itertools
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from drawn import direction, posture
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.robot.reading import frame_index
from eladapt.simulation.faults import Push

DT = 1e-3
NOISES = (ea.Noise(1e-5, 1e-3), ea.Noise(1e-4, 1e-3))
PUSH, PUSHED, BETWEEN, AFTER = 30.0, 0.2, 0.6, 0.1  # [N], [s] for which, from one to the next, and until read
ASKED = 0.05  # of the largest torque that the push makes in a joint
TOUCH, MASS, NEAR = 20.0, 2.0, 0.05  # [N], [kg], [m] of the load's centre from the tool's frame
CAME, WATCHED, IN_TIME = 0.6, 0.3, 0.05  # [s]
ARMS, PUSHES, RUNS = 8, 20, 150  # arms that learn, pushes at each; runs a row

NOTES = (
    f"Controllers are not told of the noise. Push after learning: from theta = 0 two moves, the second to a "
    f"random posture, 1 s of rest, then {PUSHES} pushes in random directions, {PUSHED:g} s each; the error "
    f"is that of `state.external` {1e3 * AFTER:g} ms after the push began, in the joint where it is largest, "
    f"as a part of the largest torque that the push makes in a joint; pushes of an arm that its gate has "
    f"stopped are left out. At rest: random postures, parameters "
    f"of the URDF; load centres within {100 * NEAR:g} cm of the tool frame. Told: a push is called a contact "
    f"within {1e3 * IN_TIME:g} ms, a load never is within {1e3 * WATCHED:g} ms."
)


class Felt(NamedTuple):
    """One push at an arm that has learned."""

    noise: ea.Noise
    largest: float  # [N m] that the push makes in a joint
    error: float  # [N m] of the external torque, in the joint where it is largest
    before: float  # [N m] the largest external torque just before the push
    learned: float  # [N m] the largest error of the gravity estimate there

    @property
    def share(self) -> float:
        """The error as a part of the push's largest torque."""
        return self.error / self.largest


class Told(NamedTuple):
    """One run with a push or a load."""

    noise: ea.Noise
    load: bool
    noticed: float  # [s] until it was; inf: it never was; negative: before it came
    contact: float  # [s] until it was called a contact; inf: it never was
    alike: bool  # whether its torque without any noise is one of a load

    @property
    def right(self) -> bool:
        """A contact within the time asked for, and a load never."""
        return bool(np.isinf(self.contact)) if self.load else 0 <= self.contact <= IN_TIME

    @property
    def cause(self) -> str:
        """Why it was not told as what it is."""
        if self.noticed < 0:
            return "noticed before it came"
        if np.isinf(self.noticed):
            return "too small to be noticed"
        if not self.load and self.alike:
            return "what the joints feel is what a load would make, without noise too"
        return "noise"


def felt(robot: ea.Robot, q: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(nv,) [N m] J' f of a force (3,) [N] at the tool."""
    tool, axes = frame_index(robot.model, robot.tool), pin.LOCAL_WORLD_ALIGNED
    jacobian = pin.computeFrameJacobian(robot.model, robot.model.createData(), q, tool, axes)
    return np.asarray(jacobian[:3].T @ force)


def pushes(job: tuple[ea.Noise, int, int]) -> list[Felt]:
    """So many pushes after two moves, the second to a random posture."""
    noise, seed, count = job
    robot, rng = ea.Robot.load("panda"), np.random.default_rng(seed)
    inner = ea.CompositeController.for_robot(robot, DT)
    controller = ea.Shaped(ea.GatedController.for_robot(inner, DT))
    home, first = robot.configuration(robot.home), robot.configuration(robot.target)
    second = posture(robot, rng)
    moved = ea.move(robot, home, first).duration + 0.5
    start = moved + ea.move(robot, first, second).duration + 1.0
    forces = [PUSH * direction(rng) for _ in range(count)]

    def acting(t: float, *_: np.ndarray) -> np.ndarray:
        number, since = divmod(t - start, BETWEEN)
        return forces[int(number)] if number < count and since < PUSHED else np.zeros(3)

    plant = Push(ea.PinocchioPlant(robot, home, noise=noise, seed=seed), acting, start=start)
    record = ea.simulate(
        controller, plant, lambda t: first if t < moved else second, start + count * BETWEEN, DT,
        theta0="zero", progress=False,
    )  # fmt: skip
    assert record.external is not None
    held = record.faults[0].t if record.faults else np.inf  # from then on the controller feels nothing
    found = []
    for number, force in enumerate(forces):
        k = int(np.searchsorted(record.t, start + number * BETWEEN + AFTER))
        if record.t[k] >= held:
            break
        acted = felt(robot, record.q[k], force)
        before = record.external[k - round(AFTER / DT) - 1]
        learned = inner.regressors.gravity(record.q[k]) @ record.theta[k] - robot.gravity(record.q[k])
        sizes = (acted, record.external[k] - acted, before, learned)
        found.append(Felt(noise, *(float(np.abs(size).max()) for size in sizes)))
    return found


def told(job: tuple[ea.Noise, int, bool]) -> Told:
    """An arm that rests, and then a load or a push."""
    noise, seed, load = job
    robot, rng = ea.Robot.load("panda"), np.random.default_rng(seed)
    controller = ea.CompositeController.for_robot(robot, DT)
    q, towards, share = posture(robot, rng), direction(rng), np.cbrt(rng.uniform())
    force = TOUCH * towards
    payload = ea.Payload(MASS, tuple(NEAR * share * towards), attach=CAME) if load else None
    arm = ea.PinocchioPlant(robot, q, noise=noise, seed=seed, payload=payload)
    plant = arm if load else Push(arm, force, start=CAME)
    measurement = plant.reset()
    state, noticed, contact = controller.init(measurement), np.inf, np.inf
    for _ in range(round((CAME + WATCHED) / DT)):
        state, tau = controller.step(state, measurement, q, DT)
        since = measurement.t - CAME
        acting = state.contact is not None and state.contact.acting
        noticed = since if acting and np.isinf(noticed) else noticed
        contact = since if state.touching and np.isinf(contact) else contact
        measurement = plant.step(tau, DT)
    exact = felt(robot, q, force)
    alike = controller.touch is None or not controller.touch.unlike_a_load(exact, q, 0 * exact)
    return Told(noise, load, noticed, contact, alike)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        learned = [(noise, seed, PUSHES) for noise in NOISES for seed in range(ARMS)]
        felts = list(itertools.chain(*tqdm(pool.map(pushes, learned), total=len(learned), unit="arm")))
        rested = [(noise, seed, load) for noise in NOISES for load in (False, True) for seed in range(RUNS)]
        tolds = list(tqdm(pool.map(told, rested, chunksize=10), total=len(rested), unit="run"))
    rows: list[list[object]] = []
    for noise in NOISES:
        said = f"{noise.position:g} rad, {noise.velocity:g} rad/s"
        some = [one for one in felts if one.noise == noise]
        shares = np.array([one.share for one in some])
        worst = some[int(shares.argmax())]
        rows.append(
            [
                f"push of {PUSH:g} N after learning", said,
                f"{np.mean(shares < ASKED):.1%} of {len(some)} within {ASKED:.0%}",
                f"error: median {np.median(shares):.1%}, 99 % of them {np.quantile(shares, 0.99):.1%}, "
                f"largest {shares.max():.1%} ({worst.error:.2f} of {worst.largest:.1f} N m)",
                f"of it before the push {worst.before:.2f} N m; of gravity {worst.learned:.2f} N m",
            ]
        )  # fmt: skip
        for load, name in ((False, f"push of {TOUCH:g} N at rest"), (True, f"load of {MASS:g} kg at rest")):
            runs = [one for one in tolds if one.noise == noise and one.load == load]
            right = [one for one in runs if one.right]
            causes = Counter(one.cause for one in runs if not one.right)
            times = [1e3 * one.contact for one in runs if 0 <= one.contact < np.inf]
            when = f"contact after {np.median(times):.0f} ms, at most {max(times):.0f}" if times else "-"
            rows.append(
                [
                    name, said, f"{len(right) / len(runs):.1%} of {len(runs)} told", when,
                    "; ".join(f"{count}: {cause}" for cause, count in causes.items()) or "-",
                ]
            )  # fmt: skip
    head = ["what came", "noise", "as it should be", "figures", "what was not, and why"]
    write("contact", "What a panda feels from outside", head, rows, NOTES)


if __name__ == "__main__":
    main()
