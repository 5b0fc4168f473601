"""The paper's four figures from records of its eight simulations, with its panels and line styles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eladapt.records.record import Record
from eladapt.regressors.regressors import Regressors

# "C1 is in solid line, C2 is in dashed-dotted line, C3 is in dotted line, and C4 is in dashed line."
STYLES = {
    "C1": {"linestyle": "-", "color": "#14213d", "linewidth": 1.4},
    "C2": {"linestyle": "-.", "color": "#e07a1f", "linewidth": 1.4},
    "C3": {"linestyle": ":", "color": "#1d6f8a", "linewidth": 1.2, "zorder": 1.5},  # below: it chatters
    "C4": {"linestyle": "--", "color": "#c94f7c", "linewidth": 1.4},
}
PARAMETER_STYLES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
PERCENTILES = (0.5, 99.5)  # of what a torque panel shows; a controller's first spike may leave it


def motion_figure(records: Mapping[str, Record]) -> Figure:
    """Errors, velocities and torques of both joints, the controllers on top of each other."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    rows = (("error", "$e_{1%d}$ [rad]"), ("v", r"$\dot q_%d$ [rad/s]"), ("tau", r"$\tau_%d$ [N m]"))
    letters = iter("abcdef")
    for (field, label), row in zip(rows, grid, strict=True):
        for joint, axes in enumerate(row):
            for name, record in records.items():
                axes.plot(record.t, getattr(record, field)[:, joint], label=name, **STYLES[name])
            _finish(axes, label % (joint + 1), next(letters))
            axes.set_xlim(0, max(record.t[-1] for record in records.values()))
            if field == "tau":
                shown = np.concatenate([r.tau[:, joint] for r in records.values()])
                low, high = np.percentile(shown, PERCENTILES)
                axes.set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low))
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False, handlelength=4)
    return figure


def estimation_figure(records: Mapping[str, Record], regressors: Regressors) -> Figure:
    """A column a controller: parameter errors, Psi theta-error, and how much was excited."""
    figure = Figure(figsize=(13, 8), layout="constrained")
    grid = figure.subplots(3, len(records), sharex=True, squeeze=False)
    letters = iter("abcdefghijkl")
    for column, (name, record) in zip(grid.T, records.items(), strict=True):
        column[0].set_title(name)
        for k, error in enumerate(record.parameter_error.T):
            column[0].plot(record.t, error, ls=PARAMETER_STYLES[k], lw=1.2, label=record.parameter_labels[k])
        column[0].legend(fontsize=7, frameon=False)
        _finish(column[0], r"$\tilde\theta$ (SI units)", next(letters))
        for joint, error in enumerate(gravity_error(record, regressors).T):
            column[1].plot(record.t, error, ls=("-", "--")[joint], lw=1.2, label=f"joint {joint + 1}")
        column[1].legend(fontsize=7, frameon=False)
        _finish(column[1], r"$\Psi\tilde\theta_U$ [N m]", next(letters))
        _excitation(column[2], name, record)
        _finish(column[2], column[2].get_ylabel(), next(letters))
        column[2].set_xlabel("time [s]")
    return figure


def gravity_error(record: Record, regressors: Regressors) -> np.ndarray:
    """Psi(q) theta_U-error (N, nv) [N m]."""
    return np.array([regressors.gravity(q) @ e for q, e in zip(record.q, record.theta_error, strict=True)])


def _excitation(axes: Axes, name: str, record: Record) -> None:
    if record.zeta_integral is not None:
        axes.plot(record.t, record.zeta_integral[:, 0], "k-", lw=1.4)
        axes.set_ylabel(r"$\int_0^t \zeta_1(\Delta)\,\mathrm{d}s$ [s]")
        return
    assert record.level is not None  # of C3 and C4
    axes.plot(record.t, record.level, "k-", lw=1.4)
    what = r"\Phi_2" if name == "C3" else r"\int_0^t\Omega^\top\Omega\,\mathrm{d}s"
    axes.set_ylabel(rf"$\lambda_{{\min}}\{{{what}\}}$")


def _finish(axes: Axes, label: str, letter: str) -> None:
    axes.set_ylabel(label)
    axes.grid(color="0.9")
    axes.set_axisbelow(True)
    axes.text(0.015, 0.97, f"({letter})", transform=axes.transAxes, va="top", fontsize=9)
