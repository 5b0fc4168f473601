"""What a log told, in tables of plain HTML: errors, what is not told, parameters and bodies."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from eladapt.display import tables
from eladapt.identification.prediction import percent

if TYPE_CHECKING:
    from eladapt.identification.found import Identified

ERRORS = (
    "<p>|predicted - measured| / |measured|. Sample by sample: torques below 10 Hz, with accelerations "
    "differenced from the velocities. Filtered: averages over windows, without any acceleration, where the "
    "joint moves.</p>"
)
PARAMETERS = (
    "<p>θ in N m: each parameter is the torque that it typically makes; what is behind the factor is in SI "
    "units. Identified: by weighted least squares, with the standard deviation that its residuals justify. "
    "Physical: of bodies that can be, nearest the URDF's.</p>"
)


def judged(found: Identified) -> str:
    """Of which part of the log errors are."""
    if not found.errors:
        return ""
    return f" on the last {found.held_out:.0%}, held out" if found.held_out else " on the log itself"


def errors(found: Identified) -> str:
    """Errors of predicted torques, by joint and by parameters."""
    if not found.errors:
        return "<p>There is no log to judge by: these are a controller's parameters.</p>"
    head = ["parameters", "in %", *found.original.joint_names, "all"]
    kinds: Mapping[str, Any] = {"raw": "sample by sample", "filtered": "filtered"}
    rows = [
        [name, said, *map(percent, getattr(of, kind))]
        for kind, said in kinds.items()
        for name, of in found.errors.items()
    ]
    return tables.table(head, rows, numbers=range(2, len(head))) + ERRORS


def not_told(found: Identified) -> str:
    """Directions of theta that the log does not tell, and the notes."""
    source = "log" if found.errors else "run"
    parts = [f"<h2>What the {source} does not tell</h2>"]
    if found.untold:
        told = "".join(f"<li>{html.escape(said)}</li>" for said in found.untold)
        parts.append(f"<p>There the URDF's values stay, in these directions of θ:</p><ul>{told}</ul>")
    else:
        parts.append("<p>It tells all base parameters.</p>")
    notes = [*found.notes, *(found.merged if found.parameters is not None else ())]
    if notes:
        parts.append("<h2>Notes</h2><ul>" + "".join(f"<li>{html.escape(n)}</li>" for n in notes) + "</ul>")
    return "".join(parts)


def parameters(found: Identified) -> str:
    """theta before and after, with standard deviations."""
    head = ["θ", "URDF", "identified", "standard deviation", "physical"]
    start = np.concatenate([found.regressors.theta, np.zeros(len(found.columns))])
    physical = found.physical if found.physical is not None else np.full(len(start), np.nan)
    rows = [
        [label, *(tables.figure(value) if np.isfinite(value) else "not told" for value in values)]
        for label, *values in zip(found.labels, start, found.theta, found.std, physical, strict=True)
    ]
    if found.physical is None:
        head, rows = head[:-1], [row[:-1] for row in rows]
    return PARAMETERS + tables.table(head, rows, numbers=range(1, len(head)))


def bodies(found: Identified) -> str:
    """Masses, centres and friction, before and after."""
    before, after = found.original.model, found.robot.model
    rows = []
    for k, joint in enumerate(found.original.joint_names):
        row = [joint]
        for model in (before, after):
            body = model.inertias[k + 1]
            row += [f"{body.mass:.4g}", ", ".join(f"{x:.4g}" for x in body.lever)]
        for part in ("armature", "damping", "friction"):
            row.append(f"{getattr(before, part)[k]:.3g} → {getattr(after, part)[k]:.3g}")
        rows.append(row)
    head = [
        "body on", "mass [kg]", "centre [m]", "mass, new", "centre, new", "rotor [kg m²]",
        "viscous [N m s/rad]", "Coulomb [N m]",
    ]  # fmt: skip
    said = (
        "<p>Single masses and centres are not told by motion, only combinations of them are: these are the "
        "nearest to the URDF's that are physical and fit.</p>"
    )
    return said + tables.table(head, rows, numbers=(1, 3))
