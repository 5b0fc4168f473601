"""A Panda whose file is wrong: 20 s of motion tell its parameters, and a better file is written.

The arm that moves has its hand, rotors and friction as published; the file that the controller knows has
masses that are up to 20 % off, no hand and no friction. An excitation is planned from that file, its log is
identified, and the new file is tried: gravity held by a PD, and a move that the controller follows from its
first sample.
"""

import argparse
from pathlib import Path

import numpy as np

import eladapt as ea
from eladapt.comparison.baselines import KnownGravityPD
from eladapt.urdf.editing import Edits

VISCOUS = np.array([0.7, 0.7, 0.7, 0.7, 0.3, 0.3, 0.3])  # [N m s/rad]
COULOMB = np.array([0.55, 0.87, 0.64, 1.28, 0.84, 0.30, 0.57])  # [N m]


def wrong_file(true: ea.Robot) -> ea.Robot:
    """Somebody's Panda: no hand, and links that weigh something else."""
    rng = np.random.default_rng(1)
    hand = dict.fromkeys(("panda_hand", "panda_leftfinger", "panda_rightfinger"))
    links = {
        f"panda_link{k}": (rng.uniform(0.8, 1.2) * body.toDynamicParameters()).tolist()
        for k, body in enumerate(list(true.edited(Edits(hand, {})).model.inertias)[1:], 1)
    }
    return true.edited(Edits({**links, **hand}, {}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--duration", type=float, default=20.0, help="of the excitation [s] (default: 20)")
    parser.add_argument(
        "--view", action="store_true", help="open the live view of the move, until interrupted"
    )
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    rotors = {joint: {"armature": 0.1} for joint in ea.Robot.load("panda").joint_names}
    true = ea.Robot.load("panda").edited(Edits({}, rotors))
    robot = wrong_file(ea.Robot.load("panda"))

    # 1. Move as the file allows, and record.
    motion = ea.excitation(robot, options.duration)
    print(motion)
    plant = ea.PinocchioPlant(true, motion.q0, friction=ea.Friction(VISCOUS, COULOMB))
    controller = ea.Shaped(ea.CompositeController.for_robot(robot))
    record = ea.simulate(controller, plant, motion, motion.duration, title="excitation of a Panda")
    record.save(options.out / "identify_panda.npz")

    # 2. Identify, and write what was found.
    found = ea.identify(robot, ea.Log.read(options.out / "identify_panda.npz"))
    print(f"\n{found}\n\n{found.friction}\n")
    path = found.save_urdf(options.out / "identify_panda.urdf")
    found.report(options.out / "identify_panda.html")

    # 3. Try the new file beside the old one.
    better = ea.Robot.from_urdf(
        path, locked=robot.locked, package_dirs=robot.package_dirs, name="panda, identified"
    )
    start, goal = true.configuration(true.home), true.configuration(true.target)
    move = ea.move(better, start, goal)
    print(f"{'':32} {'old file':>10} {'new file':>10}")
    held, followed = [], []
    for known in (robot, better):
        adaptive = ea.CompositeController.for_robot(known)
        plant = ea.PinocchioPlant(true, start, friction=ea.Friction(VISCOUS, COULOMB))
        pd = ea.simulate(KnownGravityPD(known, adaptive.control), plant, goal, 4.0, progress=False)
        held.append(np.abs(pd.error[-1]).max())
        record = ea.simulate(
            adaptive, plant, move, move.duration, progress=False, title=f"move, {known.name}"
        )
        followed.append(np.abs(record.error).max())
    for said, (old, new) in (
        ("PD with the file's gravity, at rest", held),
        ("the move, largest error", followed),
    ):
        print(f"{said:36} {old:10.1e} {new:10.1e}  rad")
    ea.plot(record, options.out / "identify_panda.png")
    print(f"wrote {options.out}/identify_panda.urdf, .html, .npz and .png")
    if options.view:
        ea.view(record).wait()


if __name__ == "__main__":
    main()
