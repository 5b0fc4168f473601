"""Motions and logs as curves: where an arm goes, how fast, how hard."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from eladapt.display.curves import COLOURS
from eladapt.display.plots import STYLE, require_suffix
from eladapt.files import atomic_write
from eladapt.motion.motions import Motion

if TYPE_CHECKING:
    from eladapt.identification.log import Log

SAMPLES = 1000
Panel = tuple[str, str, np.ndarray]  # title, unit, values (N, n)


def plot_motion(motion: Motion, path: str | Path | None = None) -> Figure:
    """Positions, velocities and accelerations of all joints over time; saved if ``path`` is given.

    path: ends in .png, .pdf or .svg; another suffix raises ArgumentError.
    """
    robot = motion.robot
    t, course = motion.sampled(motion.duration / SAMPLES)
    x = np.array([robot.difference(motion.q0, q) for q in course.q])
    panels = [
        ("way from the start", "rad", x),
        ("velocity", "rad/s", course.v),
        ("acceleration", "rad/s²", course.a),
    ]
    return _stacked(
        f"{motion.name} of {robot.name}, {motion.duration:.3g} s", t, panels, robot.joint_names, path
    )


def plot_log(log: Log, path: str | Path | None = None) -> Figure:
    """Positions, velocities and torques of all joints over time, with gaps; as `plot_motion`."""
    t, gaps = log.t - log.t[0], [piece.start for piece in log.segments[1:]]
    names = log.joint_names or tuple(f"joint {k}" for k in range(1, log.q.shape[1] + 1))
    panels = [
        (title, unit, np.insert(values, gaps, np.nan, axis=0))
        for title, unit, values in (
            ("position", "rad", log.q), ("velocity", "rad/s", log.velocity), ("torque", "N m", log.tau)
        )
    ]  # fmt: skip
    return _stacked(f"log, {t[-1]:.3g} s", np.insert(t, gaps, t[gaps]), panels, names, path)


def _stacked(
    title: str, t: np.ndarray, panels: Sequence[Panel], names: Sequence[str], path: str | Path | None
) -> Figure:
    """A panel below the other, a line a joint."""
    if path is not None:
        require_suffix(path)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7, 7), layout="constrained")
        rows = figure.subplots(len(panels), 1, sharex=True)
        for axes, (heading, unit, values) in zip(rows, panels, strict=True):
            for k, name in enumerate(names):
                axes.plot(t, values[:, k], color=COLOURS[k % len(COLOURS)], label=name)
            axes.set_title(f"{heading} [{unit}]")
        axes.set_xlabel("time [s]")
        figure.suptitle(title)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
        if path is not None:
            with atomic_write(path) as temporary:
                figure.savefig(temporary, dpi=150)
    return figure
