"""A Staubli TX40's friction from the log that comes with FIGAROH's examples, beside what is published.

The table is part of `identification_peers`. Motor 6 turns with joint 5 too: what that adds are columns of
one's own.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt
from table import markdown

import eladapt as ea
from eladapt.errors import AssumedWarning, LogWarning
from eladapt.identification.identify import WINDOW
from eladapt.identification.rows import Column

# As FIGAROH's example configures it
RATIOS = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
OFFSETS = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])  # [rad]
STEP, TX40_CUTOFF = 2e-4, 100.0  # [s], [Hz] of the filter of its positions
PUBLISHED = {
    "viscous": np.array([8.05, 5.53, 1.97, 1.11, 1.86, 0.65]),  # [N m s/rad]
    "coulomb": np.array([7.14, 8.26, 6.34, 2.48, 3.03, 0.282]),  # [N m]
}
FIGAROH_FOUND = {  # in results/TX40_bp_5.csv of its repository, weighted, from the same data
    "viscous": np.array([8.08729, 5.593924, 1.98261, 1.112374, 1.854047, 0.647663]),
    "coulomb": np.array([7.014425, 8.134077, 6.282682, 2.490079, 3.041052, 0.304214]),
}
LISTED = WINDOW  # [s] window whose joints are listed: the default
WINDOWS = (0.02, 0.05, LISTED, 0.2)  # [s]
NEAR = 0.06  # of what is published


def tx40_log(folder: Path) -> ea.Log:
    """Joints' motion and torques from the motors': joint 5 turns motor 6 too."""
    gears = np.diag(RATIOS)
    gears[5, 4] = RATIOS[5]
    motors, currents = (
        np.loadtxt(folder / name, delimiter=",", skiprows=1)
        for name in ("pos_read_data.csv", "curr_data.csv")
    )
    q = motors @ np.linalg.inv(gears).T + OFFSETS
    low = butter(4, 2 * TX40_CUTOFF * STEP, output="sos")
    v = np.gradient(sosfiltfilt(low, q, axis=0), STEP, axis=0)
    return ea.Log(STEP * np.arange(len(q)), q, v, currents @ gears)


def wrist(of: Callable[[np.ndarray, np.ndarray], list[float]]) -> Column:
    """What motor 6 does to joints 5 and 6, from their velocities and accelerations (2,)."""
    return lambda q, v, a: np.concatenate([np.zeros(4), of(v[4:], a[4:])])


WRIST: dict[str, Column] = {
    "rotor(5 with 6)": wrist(lambda v, a: [a[1], a[0]]),
    "viscous(5 with 6)": wrist(lambda v, a: [v[1], v[0]]),
    "coulomb(5 with 6)": wrist(lambda v, a: [np.sign(v.sum())] * 2),
}


def tx40_table(folder: Path) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AssumedWarning)  # its last link has no inertia
        warnings.simplefilter("ignore", LogWarning)
        robot = ea.Robot.from_urdf(folder / "tx40_mdh_modified.urdf")
        log = tx40_log(folder)
        results = {
            window: ea.identify(
                robot, log, held_out=0, columns=WRIST, physical=False, window=window, progress=False
            ).friction
            for window in WINDOWS
        }
    kinds = list(PUBLISHED)
    at = results[LISTED]
    found = {"viscous": at.viscous, "coulomb": at.coulomb}
    head = [
        "joint",
        *(f"{kind}, {of}" for kind in kinds for of in ("published", "eladapt", "[%]", "FIGAROH")),
    ]
    rows = [
        [str(j + 1), *(
            cell for kind in kinds for cell in (
                f"{PUBLISHED[kind][j]:g}", f"{found[kind][j]:.3f} +- {at.std[kinds.index(kind), j]:.2g}",
                f"{100 * (found[kind][j] / PUBLISHED[kind][j] - 1):+.1f}", f"{FIGAROH_FOUND[kind][j]:.3f}",
            )
        )]
        for j in range(robot.nv)
    ]  # fmt: skip
    off = {window: worst(friction) for window, friction in results.items()}
    windows = [[f"{window:g}", *(f"{100 * part:.1f}" for part in parts)] for window, parts in off.items()]
    within = sum(np.sum(np.abs(found[kind] / PUBLISHED[kind] - 1) <= NEAR) for kind in kinds)
    return f"""
## A Staubli TX40's friction

{markdown(head, rows)}
Viscous [N m s/rad] and Coulomb [N m] friction with windows of {LISTED:g} s, +- one standard deviation;
within {NEAR:.0%} of what is published: {within} of {2 * robot.nv}. Published: as FIGAROH's example has it;
FIGAROH: its results on the same data, as its repository has them. The wrist's coupling is three columns of
one's own: rotor, viscous and Coulomb friction of motor 6 on joints 5 and 6.

Joint 6's Coulomb friction is hardly told: see its standard deviation. The worst joint's error [%] by window:

{markdown(["window [s]", "viscous", "Coulomb", "Coulomb, joints 1 to 5"], windows)}"""


def worst(friction: ea.FrictionEstimate) -> tuple[float, float, float]:
    """Of viscous and Coulomb friction, relative to what is published, and of the latter without joint 6."""
    viscous, coulomb = (np.abs(getattr(friction, kind) / PUBLISHED[kind] - 1) for kind in PUBLISHED)
    return float(viscous.max()), float(coulomb.max()), float(coulomb[:5].max())
