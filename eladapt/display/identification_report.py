"""One page about what a log told: torques measured and predicted, errors, parameters before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from eladapt.display import identified_tables as told
from eladapt.errors import needing
from eladapt.identification.prediction import Errors, percent

with needing("a report needs Bokeh", "report"):
    from bokeh.layouts import column
    from bokeh.models import Range1d

    from eladapt.display import charts
    from eladapt.display.pages import WIDE, Page, made, pairs, words

if TYPE_CHECKING:
    from eladapt.identification.found import Identified

BREAK = 2.0  # times the usual step between two instants: there is a gap between them


def identification_report(found: Identified) -> Page:
    """The page; `Page.save` writes it."""
    head = f"<h2>Torque error{told.judged(found)}</h2>"
    overview = [words(f"{head}{told.errors(found)}{told.not_told(found)}")]
    pages = [("Overview", column(*overview, **WIDE))]
    if found.torques is not None and len(found.torques.t):
        pages += [("Torques", pairs(_torques(found))), ("Residuals", pairs(_residuals(found)))]
    pages.append(("Parameters", words(told.parameters(found))))
    if found.parameters is not None:
        pages.append(("Bodies", words(told.bodies(found))))
    return made(f"{found.original.name}, from its {'log' if found.errors else 'run'}", pages)


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
