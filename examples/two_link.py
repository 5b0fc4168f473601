"""The paper's 2-link arm, regulated from no knowledge of gravity by C1 and C2 (Case 1).

Runs both controllers to the letter of the paper (explicit Euler at 5e-4 s) and with the library's
numerics, prints the paper's claims beside the figures obtained, and writes the plot and the
animation under out/. With --view it also opens the live view in the browser.
"""

import argparse
from pathlib import Path

import numpy as np

import eladapt as ea

CLAIMS = "error < 1e-3 rad by 4 s | theta_U within 1 % by 2.5 s | chatter <= 0.015 N m"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--view", action="store_true", help="open the live view, until interrupted")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the files (default: out)")
    options = parser.parse_args()

    runs = []
    for name in ("C1", "C2"):
        runs.append((f"{name}, to the letter", ea.paper.run(name, case=1)))
        controller = ea.paper.controller(name)
        plant = ea.PinocchioPlant(controller.robot, ea.paper.START)
        title = f"{name}, library at 1 kHz"
        goal = np.array(ea.paper.GOAL)
        runs.append((title, ea.simulate(controller, plant, goal, duration=5.0, theta0="zero", title=title)))

    print(f"\nPaper, Case 1: {CLAIMS}")
    print(f"{'':24} {'settled [s]':>12} {'theta_U [s]':>12} {'chatter [N m]':>14} {'steady error [rad]':>19}")
    for title, record in runs:
        m = record.metrics()
        print(
            f"{title:24} {m.settling_time:12.2f} {m.parameter_settling:12.2f} "
            f"{m.chatter / 2:14.1e} {m.steady_error:19.1e}"
        )
    print("chatter: half the largest peak-to-peak torque of the last second, over both joints\n")

    records = dict(runs)
    letter = [records[f"{name}, to the letter"] for name in ("C1", "C2")]
    ea.plot(letter, options.out / "two_link.png")
    for name in ("C1", "C2"):
        path = records[f"{name}, to the letter"].save(options.out / f"two_link_{name}.npz")
        print(f"wrote {path}")
    ea.view(letter[0], html=options.out / "two_link.html")
    print(f"wrote {options.out / 'two_link.png'}\nwrote {options.out / 'two_link.html'}")
    if options.view:
        ea.view(letter[0]).wait()


if __name__ == "__main__":
    main()
