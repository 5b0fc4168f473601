"""What all curves have in common, on paper and on a page."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from eladapt.records.record import Record

# Neighbours differ in lightness, so that they differ in grey too.
COLOURS = (
    "#14213d", "#e07a1f", "#1d6f8a", "#d6609a", "#2f6b22", "#9c8af0",
    "#8c2f1b", "#45b5a6", "#5b2a86", "#b5a01a", "#5c6773", "#e39b8b",
)  # fmt: skip
DASHES = ("-", (0, (6, 1.5)), (0, (5, 1.2, 1, 1.2)), (0, (2, 1)), (0, (7, 1, 1, 1, 1, 1)))
ALL_ALIKE = "#1d6f8a"  # of lines that have no names of their own
FAULT_COLOUR = "#c1121f"
SMALLEST = 1e-12  # the end of a logarithmic axis: what is below is rounding
NOTHING = 1e-30  # what is drawn for a 0 on a logarithmic axis, far below its end
MOST_POINTS = 3000  # of one curve; its extremes are kept
ARRIVED = 1e-3  # [rad], the error below which the arm counts as settled

FELT = 0.05  # of the largest torque of the run; less from outside may be noise
TERM = re.compile(r"\b([A-Za-z]+)\(([^()]*)\)")  # of a label: a quantity and whose it is


def felt(record: Record) -> bool:
    """Whether torque from outside was recorded and is something to be shown."""
    if record.external is None:
        return False
    most = [float(np.nanmax(np.abs(torque), initial=0.0)) for torque in (record.external, record.tau)]
    return most[0] > FELT * most[1]


def look(index: int) -> dict[str, Any]:
    """The colour and the dashes of curve ``index``; 60 differ."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": DASHES[index % len(DASHES)]}


def reduced(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The curve by at most `MOST_POINTS` points: the least and the greatest value of each interval."""
    width = -(-2 * len(t) // MOST_POINTS)
    if width <= 2:
        return t, values
    starts = np.arange(0, len(t), width)
    extremes = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    return np.repeat(t[starts], 2), np.stack(extremes, axis=1).ravel()


def links_of(record: Record) -> dict[str, str]:
    """By joint, the link that it moves; the joint itself where the record does not say."""
    return dict(zip(record.joint_names, record.link_names or record.joint_names, strict=True))


def short_label(label: str, links: Mapping[str, str]) -> str:
    """``my(panda_link2), ...`` for a combination that begins with my(panda_joint2): by its first, largest
    term. A label of another form stays as it is."""
    terms = TERM.findall(label)
    if not terms or terms[0][1] not in links:
        return label
    quantity, joint = terms[0]
    return f"{quantity}({links[joint]})" + (", ..." if len(terms) > 1 else "")
