"""What real hardware does to the panda: noise, encoders, Coulomb friction, delay, each alone and together.

One move from home to the target at 1 kHz, from theta = 0, with `CompositeController.for_robot`. "told": the
controller's gains are derived with what is known of the hardware (``velocity_noise=``, ``delay=`` and so on);
"not told": with the URDF alone. Of friction nobody tells; it is learned.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from table import write
from tqdm import tqdm

import eladapt as ea
from eladapt.errors import SimulationError
from eladapt.gains.extremes import extremes
from eladapt.robot.protocols import Plant
from eladapt.simulation.instruments import Delay, Encoders, NoisyReadings

DT = 1e-3
NOISE = ea.Noise(1e-4, 1e-3)
COULOMB = 1.0  # [N m]
LATE = 2e-3  # [s]


class Case(NamedTuple):
    """One kind of hardware."""

    friction: ea.Friction | None = None
    before: ea.Noise | None = None  # noise of the position that the encoders count
    wrap: Callable[[Plant], Plant] = lambda plant: plant
    known: Mapping[str, Any] = {}


def counted(noise: ea.Noise | None = None) -> dict[str, Any]:
    """What a user of 2^17 counts a turn and a 5 ms velocity filter would tell."""
    encoders = Encoders(ea.PinocchioPlant(ea.Robot.load("two_link"), [0, 0]))
    own = encoders.noise(DT)
    position, velocity = own.position, own.velocity
    if noise is not None:
        position, velocity = np.hypot(position, noise.position), np.hypot(velocity, noise.velocity)
    return {"position_noise": position, "velocity_noise": velocity, "velocity_lag": encoders.time_constant}


def ahead() -> dict[str, Any]:
    """The same where the position is noisy before it is counted: the differences multiply that noise."""
    known = counted()
    gain = known["velocity_noise"] / known["position_noise"]
    position = float(np.hypot(known["position_noise"], NOISE.position))
    return known | {"position_noise": position, "velocity_noise": gain * position}


def together(plant: Plant) -> Plant:
    """Noisy readings of counted positions of an arm that acts late."""
    return NoisyReadings(Encoders(Delay(plant, LATE)), NOISE)


RUB = ea.Friction(coulomb=COULOMB)
CASES: dict[str, Case] = {
    "ideal": Case(),
    "noise": Case(
        wrap=lambda p: NoisyReadings(p, NOISE), known={"position_noise": 1e-4, "velocity_noise": 1e-3}
    ),
    "encoders": Case(wrap=Encoders, known=counted()),
    "Coulomb friction": Case(RUB),
    "delay": Case(wrap=lambda p: Delay(p, LATE), known={"delay": LATE}),
    "noise, encoders, delay": Case(wrap=together, known=counted(NOISE) | {"delay": LATE}),
    "all": Case(RUB, wrap=together, known=counted(NOISE) | {"delay": LATE}),
    "all, noise ahead of the encoders": Case(
        RUB, before=NOISE, wrap=lambda p: Encoders(Delay(p, LATE)), known=ahead() | {"delay": LATE}
    ),
}  # fmt: skip


class Run(NamedTuple):
    """What one move gave."""

    case: str
    told: bool
    horizon: str  # [ms], from the joint where it is shortest to the one where it is longest
    ahead: float  # [steps] that the law looked ahead at least in the end
    settled: float  # [s] below 1e-3 rad
    roughly: float  # [s] below 5e-3 rad
    steady: float  # [rad] largest true error of the last second
    gravity: float  # [N m] error of the gravity torque at the end
    ripple: float  # [N m] largest peak-to-peak torque of the last second
    effort: float  # largest share of a torque limit
    alarms: int  # changes noticed, of which there was none
    diverged: bool


def run(job: tuple[str, bool, float]) -> Run:
    name, told, duration = job
    robot, case = ea.Robot.load("panda"), CASES[name]
    controller = ea.CompositeController.for_robot(robot, DT, **(case.known if told else {}))
    arm = ea.PinocchioPlant(robot, robot.configuration(robot.home), friction=case.friction, noise=case.before)
    plant = case.wrap(arm)
    times = 1e3 * controller.gains.horizon if controller.gains else np.zeros(1)
    horizon = f"{times.min():.1f}" + (f" to {times.max():.1f}" if np.ptp(times) else "")
    try:
        record = ea.simulate(
            controller, plant, robot.configuration(robot.target), duration, DT, theta0="zero",
            progress=False,
        )  # fmt: skip
    except SimulationError:
        return Run(name, told, horizon, np.inf, np.inf, np.inf, np.inf, np.inf, np.inf, np.inf, 0, True)
    metrics = record.metrics()
    reg = controller.regressors
    gravity = reg.gravity(record.q[-1]) @ (record.theta[-1] - reg.theta_potential)
    return Run(
        name, told, horizon, record.final_state.ripple.ahead, record.settling_time(1e-3),
        record.settling_time(5e-3), metrics.steady_error, float(np.abs(gravity).max()), metrics.chatter,
        float(np.max(np.abs(record.tau) / record.effort_limit)), record.final_state.change.noticed, False,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--duration", type=float, default=4.0, help="[s] of each run (default: 4)")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES), help="default: all")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--output", default="hardware_effects",
        help="name of the table in benchmarks/results, or a path without .md (default: hardware_effects)",
    )  # fmt: skip
    options = parser.parse_args()
    jobs = [
        (name, told, options.duration)
        for name in options.cases
        for told in ([False, True] if CASES[name].known else [False])
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        runs = list(tqdm(pool.map(run, jobs), total=len(jobs), unit="run"))
    head = [
        "hardware", "controller", "horizon [ms]", "at least, in the end [ms]", "below 1e-3 rad after [s]",
        "below 5e-3 rad after [s]", "steady error [rad]", "gravity error [N m]", "torque ripple [N m]",
        "largest effort / limit", "false alarms",
    ]  # fmt: skip
    rows: list[list[object]] = []
    for r in runs:
        told = "-" if not CASES[r.case].known else "told" if r.told else "not told"
        rows.append(
            [
                r.case, told, r.horizon, f"{1e3 * DT * r.ahead:.1f}", _time(r.settled), _time(r.roughly),
                "diverged" if r.diverged else f"{r.steady:.1e}", f"{r.gravity:.1e}", f"{r.ripple:.1e}",
                f"{r.effort:.2f}", r.alarms,
            ]
        )  # fmt: skip
    diverged = sum(r.diverged for r in runs)
    bound = extremes(ea.Robot.load("panda")).gravity.max()
    notes = (
        f"Diverged: {diverged} of {len(runs)}. Noise: 1e-4 rad and 1e-3 rad/s, white. Encoders: 2^17 counts "
        "a turn, velocity from their differences through a 5 ms filter. Coulomb friction: "
        f"{COULOMB:g} N m in every joint. Delay: {1e3 * LATE:g} ms from command to torque. Together, the "
        "noise is that of the readings; in the last case it is the position's, before it is counted, which "
        f"makes {1e3 * ahead()['velocity_noise']:.0f} mrad/s of velocity noise. Error: the true one, of the "
        f"last second; ripple: peak to peak, less its trend. The arm's gravity torque is at most {bound:.0f} "
        "N m; its error is that of theta_U alone, against which noise moves the joints' offsets, since at "
        "one posture nothing tells them apart. False alarms: changes noticed where there was none."
    )
    write(options.output, "Hardware and what it costs (panda)", head, rows, notes)


def _time(seconds: float) -> str:
    return f"{seconds:.2f}" if np.isfinite(seconds) else "never"


if __name__ == "__main__":
    main()
