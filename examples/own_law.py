"""Your own control law in place of the finite-time one: a PD law that saturates, on a UR5.

The estimator and its adaptation stay as they are. Prints both laws side by side, and writes plot,
animation and record under out/. With --view it also opens the live view in the browser.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import eladapt as ea
from eladapt.gains.extremes import extremes


@dataclasses.dataclass(frozen=True)
class SaturatedPD:
    """tau = -P tanh(e1 / reach) - D tanh(e2 / speed): never more than P + D."""

    P: np.ndarray  # (nv,) [N m]
    D: np.ndarray  # (nv,) [N m]
    reach: float = 0.2  # [rad] the position error at which P begins to saturate
    speed: float = 1.0  # [rad/s]
    b: float = 0.5  # exponent of the adaptation law that goes with it

    @classmethod
    def for_robot(cls, robot: ea.Robot) -> "SaturatedPD":
        """Half of the torque that gravity leaves, or less where the inertia asks for less; damping 0.8."""
        gravity, inertia = extremes(robot)
        P = 0.5 * np.minimum(robot.effort_limit - gravity, 30 * inertia)
        return cls(P, D=1.6 * cls.speed * np.sqrt(P / cls.reach * inertia))

    def torque(self, e1: np.ndarray, e2: np.ndarray, mass_matrix: np.ndarray, dt: float) -> np.ndarray:
        """(nv,) [N m] for the position error e1 [rad] and the velocity e2 [rad/s]."""
        return -self.P * np.tanh(e1 / self.reach) - self.D * np.tanh(e2 / self.speed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    robot = ea.Robot.load("ur5")
    finite_time = ea.CompositeController.for_robot(robot)
    law = SaturatedPD.for_robot(robot)
    own = dataclasses.replace(finite_time, control=law, gains=None)

    records = []
    for title, controller in {"finite-time PD": finite_time, "saturated PD": own}.items():
        plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
        goal = robot.configuration(robot.target)
        record = ea.simulate(controller, plant, goal, duration=4.0, title=title)
        records.append(record)
        off = np.abs(controller.regressors.gravity(record.q[-1]) @ record.theta_error[-1]).max()
        print(f"{title}: all joints below 1e-3 rad after {record.settling_time():.2f} s; at the end, error "
              f"{np.abs(record.error[-1]).max():.1e} rad, gravity torque off by {off:.1e} N m")  # fmt: skip
    bound = np.array2string(law.P + law.D, precision=1)
    print(f"The feedback of the saturated PD is at most {bound} N m, whatever the error.")
    print("It is linear near the goal, so its error decays exponentially: it is never quite there.")

    ea.plot(records, options.out / "own_law.png")
    ea.view(records[1], html=options.out / "own_law.html")
    records[1].save(options.out / "own_law.npz")
    print(f"wrote {options.out}/own_law.png, own_law.html and own_law.npz")
    if options.view:
        ea.view(records[1]).wait()


if __name__ == "__main__":
    main()
