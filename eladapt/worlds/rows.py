"""What is kept of a trial: one row of fixed width, a column a quantity."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from eladapt.errors import printable

# By name, with what the number is; the world in plain numbers.
FACTORS = {
    "distance": "longest way of a joint [rad]",
    "pace": "of the fastest motion [-]",
    "load": "load [kg]",
    "load_offset": "its distance from the tool [m]",
    "attach": "when it comes [s]",
    "release": "when it goes [s]",
    "mass_error": "mean error of the masses [-]",
    "centre_error": "largest error of a centre of mass [m]",
    "rotor": "largest rotor [of effort / 400 rad/s²]",
    "coulomb": "largest Coulomb friction [of the effort]",
    "viscous": "largest viscous friction at full speed [of the effort]",
    "position_noise": "position noise [rad]",
    "velocity_noise": "velocity noise [rad/s]",
    "delay": "delay [s]",
    "velocity_lag": "lag of the velocity [s]",
    "delay_told": "delay, told less true [s]",
    "lag_told": "lag, told less true [s]",
    "jitter": "jitter [of a step]",
    "tilt": "tilt of the base [rad]",
}
MEASURES = {
    "settling": "settled after the last change [s]",
    "steady": "steady error [rad]",
    "tracking": "largest error while moving [rad]",
    "overshoot": "overshoot [rad]",
    "speed": "largest speed [of the limit]",
    "torque": "largest torque [of the limit]",
    "saturated": "time at a torque limit [s]",
    "chatter": "torque ripple at rest [N m]",
    "beyond": "beyond a range [rad]",
    "gravity_error": "error of the learned gravity [of the effort]",
    "weighed": "load, as weighed [kg]",
    "fault_at": "time of the fault [s]",
}
SAID = 160  # characters of an explanation that are kept; a replay gives all of it
ROW = np.dtype(
    [("seed", "<i8"), ("good", "?"), ("cause", "S32"), ("fault", "S16"), ("joint", "<i2")]
    + [(name, "<f8") for name in (*FACTORS, *MEASURES)]
    + [("said", f"S{SAID}"), ("check", "<u4")]
)
CHECKED = ROW.itemsize - 4  # bytes before the check


def row_of(found: Mapping[str, Any]) -> np.ndarray:
    """The row (); numbers that are not there are nan. Its check is that of all bytes before it."""
    row = np.zeros((), dtype=ROW)
    for name in (*FACTORS, *MEASURES):
        row[name] = np.nan
    row["joint"] = -1
    for name, value in found.items():
        row[name] = printable(value).encode("ascii", "replace") if isinstance(value, str) else value
    row["check"] = _check(row.tobytes())
    return row


def complete(rows: np.ndarray) -> np.ndarray:
    """(n,) which rows were written, and whole: not those of zeros, or that a kill cut short."""
    flat = np.ascontiguousarray(rows)
    raw, size = flat.tobytes(), ROW.itemsize
    found = (_check(raw[k * size : (k + 1) * size]) for k in range(len(flat)))
    return np.fromiter(found, dtype=np.uint32, count=len(flat)) == flat["check"]


def text(value: bytes) -> str:
    """A column of text, as text."""
    return value.decode("ascii")


def _check(row: bytes) -> int:
    return zlib.crc32(row[:CHECKED])
