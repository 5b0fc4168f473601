"""Motions and logs as curves: where an arm goes, how fast, how hard."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from eladapt.display.curves import look
from eladapt.display.figures import (
    Picture,
    StyleName,
    add_legend,
    plain,
    require_suffix,
    style_of,
)
from eladapt.display.panels import add_markers
from eladapt.motion.motions import Motion

if TYPE_CHECKING:
    from eladapt.identification.log import Log

SAMPLES = 1000
Panel = tuple[str, str, np.ndarray]  # title, unit, values (N, n)


def plot_motion(motion: Motion, path: str | Path | None = None, *, style: StyleName = "screen") -> Picture:
    """Positions, velocities and accelerations of all joints over time; saved if ``path`` is given.

    path: ends in .png, .pdf or .svg; another suffix raises ArgumentError. style: as for `plot`.
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
        f"{motion.name} of {robot.name}, {motion.duration:.3g} s", t, panels, robot.joint_names, path, style
    )


def plot_log(log: Log, path: str | Path | None = None, *, style: StyleName = "screen") -> Picture:
    """Positions, velocities and torques of all joints over time, with gaps; as `plot_motion`."""
    t, gaps = log.t - log.t[0], [piece.start for piece in log.segments[1:]]
    names = log.joint_names or tuple(f"joint {k}" for k in range(1, log.q.shape[1] + 1))
    angle = "degrees" if log.degrees else "rad"
    panels = [
        (title, unit, np.insert(values, gaps, np.nan, axis=0))
        for title, unit, values in (
            ("position", angle, log.q), ("velocity", f"{angle}/s", log.velocity), ("torque", "N m", log.tau)
        )
    ]  # fmt: skip
    return _stacked(f"log, {t[-1]:.3g} s", np.insert(t, gaps, t[gaps]), panels, names, path, style)


def _stacked(
    title: str,
    t: np.ndarray,
    panels: Sequence[Panel],
    names: Sequence[str],
    path: str | Path | None,
    style: StyleName,
) -> Picture:
    """A panel below the other, a line a joint."""
    if path is not None:
        require_suffix(path)
    looks = style_of(style)
    with mpl.rc_context(looks.settings):
        figure = Picture(looks, looks.column if looks.marked else 1.27 * looks.column, 3.2 * looks.panel)
        rows = figure.subplots(len(panels), 1, sharex=True)
        for axes, (heading, unit, values) in zip(rows, panels, strict=True):
            for k, name in enumerate(names):
                axes.plot(t, values[:, k], label=name, **look(k))
            axes.set_title(f"{heading} [{unit}]")
            if looks.marked:
                add_markers(axes)
        axes.set_xlabel("time [s]")
        if not looks.marked:  # a paper has a caption
            figure.suptitle(plain(title))
        add_legend(figure, axes.get_lines(), names, "outside lower center", looks.note)
    if path is not None:
        figure.save(path)
    return figure
