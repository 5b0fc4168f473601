"""How well a motion tells an arm's parameters: the library's excitation beside random ones.

The condition number of the torque regressor, stacked over a motion of 10 s from rest to rest at home within
the limits, for the whole theta but Coulomb friction; of the optimised Fourier series, of the best of the ten
random ones that its search begins with, and of a hundred others.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from table import write

import eladapt as ea

DURATION = 10.0  # [s]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", nargs="*", default=["two_link", "ur5", "panda"], choices=ea.robots())
    parser.add_argument("--random", type=int, default=100, help="others to compare with (default: 100)")
    parser.add_argument(
        "--output", default="excitation", help="table in benchmarks/results, or a path without .md"
    )
    options = parser.parse_args()
    rows: list[list[object]] = []
    for name in options.robots:
        robot, began = ea.Robot.load(name), time.monotonic()
        found = ea.excitation(robot, DURATION)
        took = time.monotonic() - began
        rounds = range(1, 1 + -(-options.random // len(found.random)))
        others = [c for seed in rounds for c in ea.excitation(robot, DURATION, rounds=0, seed=seed).random]
        cells = [found.condition, min(found.random), np.median(others), min(others)]
        rows.append([name, *(f"{c:.0f}" for c in cells), f"{took:.0f}"])
    head = ["robot", "optimised", "best of its ten random ones", f"median of {options.random} others",
            f"best of {options.random} others", "search [s]"]  # fmt: skip
    write(options.output, "Condition numbers of motions that excite", head, rows, "Lower is better.")


if __name__ == "__main__":
    main()
