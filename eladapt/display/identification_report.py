"""One page about what a log told: torques measured and predicted, errors, parameters before and after."""

from __future__ import annotations

import html
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eladapt.display import tables
from eladapt.errors import needing
from eladapt.identification.prediction import Errors, percent

with needing("a report needs Bokeh", "report"):
    from bokeh.layouts import column
    from bokeh.models import Range1d

    from eladapt.display import charts
    from eladapt.display.pages import WIDE, pairs, require_page, words, write_page

if TYPE_CHECKING:
    from eladapt.identification.found import Identified

BREAK = 2.0  # times the usual step between two instants: there is a gap between them
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


def identification_report(found: Identified, path: str | Path) -> Path:
    """Write the page; returns its path. Raises ArgumentError for a name that does not end in .html."""
    path = require_page(path)
    overview = [words(f"<h2>Torque error{_judged(found)}</h2>{_errors(found)}{_told(found)}")]
    pages = [("Overview", column(*overview, **WIDE))]
    if found.torques is not None and len(found.torques.t):
        pages += [("Torques", pairs(_torques(found))), ("Residuals", pairs(_residuals(found)))]
    pages.append(("Parameters", words(_parameters(found))))
    if found.parameters is not None:
        pages.append(("Bodies", words(_bodies(found))))
    return write_page(path, f"{found.original.name}, from its {'log' if found.errors else 'run'}", pages)


def _judged(found: Identified) -> str:
    if not found.errors:
        return ""
    return f" on the last {found.held_out:.0%}, held out" if found.held_out else " on the log itself"


def _errors(found: Identified) -> str:
    if not found.errors:
        return "<p>There is no log to judge by: these are a controller's parameters.</p>"
    head = ["parameters", "in %", *found.original.joint_names, "all"]
    kinds: Mapping[str, Any] = {"raw": "sample by sample", "filtered": "filtered"}
    rows = [
        [name, said, *map(percent, getattr(errors, kind))]
        for kind, said in kinds.items()
        for name, errors in found.errors.items()
    ]
    return tables.table(head, rows, numbers=range(2, len(head))) + ERRORS


def _told(found: Identified) -> str:
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


def _curves(found: Identified) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times from the first on, and torques (n, nv) by name, measured first; nan where the log has a gap."""
    assert found.torques is not None
    t, tau, regressor = found.torques
    start = np.concatenate([found.regressors.theta, np.zeros(len(found.columns))])
    by = {"URDF": start, "identified": found.theta}
    if found.physical is not None:
        by["physical"] = found.physical
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > BREAK * np.median(steps)) + 1
    torques = {"measured": tau, **{name: regressor @ theta for name, theta in by.items()}}
    return np.insert(t - t[0], gaps, t[gaps] - t[0]), {
        name: np.insert(torque, gaps, np.nan, axis=0) for name, torque in torques.items()
    }


def _torques(found: Identified) -> list[Any]:
    t, torques = _curves(found)
    x, drawn = Range1d(t[0], t[-1]), []
    for k, name in enumerate(found.original.joint_names):
        chart = charts.chart(f"{name}{_error(found.errors, k)}", "τ [N m]", x)
        charts.lines(chart, t, np.column_stack([torque[:, k] for torque in torques.values()]), list(torques))
        drawn.append(chart)
    return drawn


def _residuals(found: Identified) -> list[Any]:
    t, torques = _curves(found)
    measured = torques.pop("measured")
    torques.pop("URDF")  # another order of magnitude
    x, drawn = Range1d(t[0], t[-1]), []
    for k, name in enumerate(found.original.joint_names):
        chart = charts.chart(f"{name}: predicted less measured", "τ [N m]", x)
        values = np.column_stack([torque[:, k] - measured[:, k] for torque in torques.values()])
        charts.lines(chart, t, values, list(torques), first=2)  # the looks that they have among the torques
        drawn.append(chart)
    return drawn


def _error(errors: Mapping[str, Errors], joint: int) -> str:
    said = [f"{name} {percent(found.raw[joint])} %" for name, found in errors.items()]
    return f": {', '.join(said)}" if said else ""


def _parameters(found: Identified) -> str:
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


def _bodies(found: Identified) -> str:
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
