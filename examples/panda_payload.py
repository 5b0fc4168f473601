"""A Panda picks up a load that nobody told it of, and says what the load weighs.

2 kg are attached to the hand at t = 3 s, while the arm holds its set-point. The controller notices,
starts afresh on excitation, brings the hand back and turns the change of its parameters into mass
and centre of mass. The same happens to a PD with the URDF's gravity and to Slotine-Li.
"""

import argparse
from pathlib import Path

import numpy as np

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD
from eladapt.robot.protocols import BareController

ATTACHED = 3.0  # [s]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--mass", type=float, default=2.0, help="of the load [kg] (default: 2)")
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    robot = ea.Robot.load("panda")
    goal = robot.configuration(robot.target)
    load = ea.Payload(options.mass, com=(0.0, 0.0, 0.05), attach=ATTACHED)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), payload=load)

    adaptive = ea.CompositeController.for_robot(robot)
    others: dict[str, BareController] = {
        "PD with the URDF's gravity": KnownGravityPD(robot, adaptive.control),
        "Slotine-Li": ea.SlotineLi.for_robot(robot),
    }
    record = ea.simulate(adaptive, plant, goal, 6.0, title=f"panda, {options.mass:g} kg attached at 3 s")
    runs = {"composite": record} | {
        name: ea.simulate(c, plant, goal, 6.0, title=name) for name, c in others.items()
    }
    print(f"\n{options.mass:g} kg attached at {ATTACHED:g} s:")
    for name, run in runs.items():
        late = run.t > ATTACHED
        size = np.abs(run.error).max(axis=1)
        away = run.t[late & (size > 1e-3)]
        back = "never left" if not len(away) else f"back below 1e-3 rad {away[-1] - ATTACHED:.2f} s later"
        if len(away) and away[-1] > run.t[-1] - 0.1:
            back = "not back below 1e-3 rad"
        sag, left = size[late].max(), size[-1]
        print(f"  {name:27} sags {sag:.3f} rad, {back}, {left:.0e} rad left at {run.t[-1]:g} s")

    # The estimate of the load, from the controller's last state; see ea.payload.
    print(f"\n{ea.payload(adaptive, record.final_state)}\n")

    ea.plot([runs["composite"], runs["PD with the URDF's gravity"]], options.out / "panda_payload.png")
    ea.view(record, html=options.out / "panda_payload.html")
    record.save(options.out / "panda_payload.npz")
    print(f"wrote {options.out}/panda_payload.png, .html and .npz")
    if options.view:
        ea.view(record).wait()


if __name__ == "__main__":
    main()
