"""A robot in another process, driven at 1 kHz over a socket, as through a vendor's fast interface.

MuJoCo plays the arm, in real time, behind UDP on loopback; the controller starts from what the URDF says of
it and learns the rest from what it measures. Writes plot and record under out/, and the controller's state,
with which --resume starts the next run: that one knows from the first sample what this one learned.
"""

import argparse
import multiprocessing
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

import eladapt as ea
from eladapt.hardware.udp import serve

DT = 1e-3


def arm(name: str, pipe: Connection) -> None:
    """The other process: the robot, at home, with the brakes on."""
    robot = ea.Robot.load(name)
    served = serve(ea.MujocoPlant(robot, robot.configuration(robot.home)), DT, ready=pipe.send)
    pipe.send(f"{served.commands} torques taken, {served.without} periods without one, end: {served.ended}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robot", default="panda", choices=ea.robots(), help="(default: panda)")
    parser.add_argument("--duration", type=float, default=5.0, help="[s] (default: 5)")
    parser.add_argument("--resume", action="store_true", help="go on from the state of the last run")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    robot = ea.Robot.load(options.robot)
    # A torque acts one to two periods after the measurement that it answers: gains should know.
    inner = ea.CompositeController.for_robot(robot, DT, delay=2 * DT)
    controller = ea.GatedController.for_robot(inner, DT)
    saved = options.out / f"hardware_loop_{robot.name}_state.npz"
    state = ea.load_state(saved, controller) if options.resume else None

    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=arm, args=(options.robot, there))
    process.start()
    there.close()
    interface = ea.UdpRobot(robot, port=here.recv(), dt=DT)
    result = ea.run_loop(
        controller,
        interface,
        robot.configuration(robot.target),
        options.duration,
        DT,
        state=state,
        checkpoint=saved,
    )
    print(f"robot: {here.recv()}")
    process.join()

    record = result.record
    print(f"loop: {result.timing}")
    print(f"fault: {result.fault or 'none'}")
    left = np.abs(record.error[-1]).max()
    print(f"all joints below 2e-3 rad after {record.settling_time(2e-3):.2f} s, {left:.1e} rad at the end")
    ea.plot(record, options.out / "hardware_loop.png")
    record.save(options.out / "hardware_loop.npz")
    print(f"wrote {options.out}/hardware_loop.png, hardware_loop.npz and {saved.name}")


if __name__ == "__main__":
    main()
