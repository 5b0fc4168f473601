"""2 kg that come to a panda at 3 s, unannounced: how soon the error is back, and what the load weighs.

One move from home to the target at 1 kHz, then the load, in four controllers, which all have the URDF: the
composite one; the same without adaptation; a finite-time PD with the URDF's gravity and the same gains; and
Slotine and Li's (C4) with its own. The composite one then moves back home with the load, or has it released
again. All with and without noise.
"""

from __future__ import annotations

import argparse
import dataclasses
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD
from eladapt.errors import SimulationError

DT = 1e-3
MASS, COM = 2.0, (0.0, 0.0, 0.05)  # [kg], [m] in the tool frame
ATTACHED, RELEASED = 3.0, 6.0  # [s]
BACK = 1e-3  # [rad]
ATTACH, RELEASE = "attached", "released"
MOVES = {"attached, home 1 s later": 1.0, "attached, home 3 s later": 3.0}  # [s]
NOISE = ea.Noise(1e-4, 1e-3)
CONTROLLERS = ("composite", "without adaptation", "PD with the URDF's gravity", "Slotine-Li (C4)")


class Run(NamedTuple):
    """What followed a change of the load."""

    controller: str
    noise: bool
    event: str
    noticed: float  # [s] after the load came or went; nan without a detector
    sag: float  # [rad] largest error
    back: float  # [s] from when on every error stays below 1e-3 rad; inf if it does not
    left: float  # [rad] largest error of the last half second
    mass: float  # [kg] estimate; nan where there is none
    mass_std: float  # [kg]
    com: float  # [m] error of the centre of mass
    com_std: float  # [m]
    misfit: float  # the part of the change that no load explains
    alarms: int  # changes noticed in all


def controller_of(kind: str, robot: ea.Robot, noise: bool) -> Any:
    known: dict[str, Any] = {}
    if noise:
        known = {"position_noise": NOISE.position, "velocity_noise": NOISE.velocity}
    composite = ea.CompositeController.for_robot(robot, DT, **known)
    if kind == "composite":
        return composite
    if kind == "without adaptation":
        frozen = dataclasses.replace(composite.law, direct=False, indirect=False)
        return dataclasses.replace(composite, law=frozen, detector=None)
    if kind == "PD with the URDF's gravity":
        return KnownGravityPD(robot, composite.control)
    return ea.SlotineLi.for_robot(robot, DT)


def run(job: tuple[str, bool, str]) -> Run:
    kind, noise, event = job
    release = event == RELEASE
    robot = ea.Robot.load("panda")
    controller = controller_of(kind, robot, noise)
    load = ea.Payload(MASS, COM, attach=ATTACHED, release=RELEASED if release else np.inf)
    plant = ea.PinocchioPlant(
        robot, robot.configuration(robot.home), payload=load, noise=NOISE if noise else None
    )
    changed = RELEASED if release else ATTACHED
    there, back = robot.configuration(robot.target), robot.configuration(robot.home)
    moved = changed + MOVES.get(event, np.inf)
    duration = min(changed + 3.0, moved) + (3.0 if event in MOVES else 0.0)

    def goal(t: float) -> np.ndarray:
        return back if t >= moved else there

    try:
        record = ea.simulate(controller, plant, goal, duration, DT, theta0="urdf", progress=False)
    except SimulationError:
        return Run(
            kind, noise, event, np.nan, np.inf, np.inf, np.inf, np.nan, np.nan, np.nan, np.nan, np.nan, 0
        )
    since = record.t > changed
    size = np.abs(record.error).max(axis=1)
    before_move = record.t < moved
    outside = record.t[before_move & (size >= BACK)]
    settled = np.inf if outside[-1] > record.t[before_move][-1] - 0.01 else outside[-1]
    noticed = mass = std = com = com_std = misfit = np.nan
    alarms = 0
    change = getattr(record.final_state, "change", None)
    if change is not None:
        alarms = change.noticed
        if change.t > changed:
            noticed = change.t - changed
            estimate = ea.payload(controller, record.final_state)
            mass, std = estimate.mass, estimate.mass_std
            com, com_std = float(np.linalg.norm(estimate.com - COM)), float(np.linalg.norm(estimate.com_std))
            misfit = estimate.misfit
    return Run(
        kind, noise, event, noticed, float(size[since & before_move].max()),
        max(settled - changed, 0.0),
        float(size[-round(0.5 / DT) :].max()), mass, std, com, com_std, misfit,
        alarms,
    )  # fmt: skip


def _place(r: Run) -> str:
    return f"{r.com:.1e} (+- {r.com_std:.0e})" if np.isfinite(r.com) else "unknown"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    jobs = [(kind, noise, ATTACH) for noise in (False, True) for kind in CONTROLLERS]
    jobs += [("composite", noise, event) for event in (*MOVES, RELEASE) for noise in (False, True)]
    with ProcessPoolExecutor(options.jobs) as pool:
        runs = list(tqdm(pool.map(run, jobs), total=len(jobs), unit="run"))
    head = [
        "controller", "noise", "event", "noticed after [s]", "sags to [rad]", "back below 1e-3 rad after [s]",
        "error left [rad]", "mass [kg]", "mass error", "centre of mass error [m]", "misfit",
        "changes noticed",
    ]  # fmt: skip
    rows: list[list[object]] = []
    for r in runs:
        true = -MASS if r.event == RELEASE else MASS
        weighed = np.isfinite(r.mass)
        nothing = "unknown" if np.isfinite(r.noticed) else "-"
        rows.append(
            [
                r.controller, "yes" if r.noise else "no", r.event,
                f"{r.noticed:.3f}" if np.isfinite(r.noticed) else "-", f"{r.sag:.3f}",
                f"{r.back:.2f}" if np.isfinite(r.back) else "never", f"{r.left:.0e}",
                f"{r.mass:.4f} +- {r.mass_std:.0e}" if weighed else nothing,
                f"{abs(r.mass / true - 1):.2g}" if weighed else nothing,
                _place(r) if weighed else nothing,
                f"{r.misfit:.0e}" if np.isfinite(r.misfit) else "-",
                r.alarms,
            ]
        )  # fmt: skip
    notes = (
        f"The load: {MASS:g} kg at {COM} m in the tool frame, from {ATTACHED:g} s on, or until "
        f"{RELEASED:g} s. Asked: back within 2 s; mass within 2 %, with noise within 5 %. Noise: "
        "1e-4 rad and 1e-3 rad/s, of which the controllers (but Slotine-Li's) are told. Back, sag: before "
        "the next move; error left: of the last half second. A released load is a negative mass. +-: "
        "standard deviations as estimated. Unknown: what no motion has told; to an arm at rest, offsets of "
        "its joints explain a load as well. Misfit: the part of the change that no load explains. The two "
        "composite rows feed a disturbance estimate forward, with adaptation or without. With noise the "
        "law's horizon is longer, which leaves a PD softer against a load that nothing compensates."
    )
    write("payload", "A load that comes unannounced (panda)", head, rows, notes)


if __name__ == "__main__":
    main()
