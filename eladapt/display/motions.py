"""A motion as curves: where it goes, how fast, how hard."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from eladapt.display.curves import COLOURS
from eladapt.display.plots import STYLE, require_suffix
from eladapt.files import atomic_write
from eladapt.motion.motions import Motion

SAMPLES = 1000


def plot_motion(motion: Motion, path: str | Path | None = None) -> Figure:
    """Positions, velocities and accelerations of all joints over time; saved if ``path`` is given.

    path: ends in .png, .pdf or .svg; another suffix raises ArgumentError.
    """
    if path is not None:
        require_suffix(path)
    robot = motion.robot
    t, course = motion.sampled(motion.duration / SAMPLES)
    x = np.array([robot.difference(motion.q0, q) for q in course.q])
    panels = (
        ("way from the start", "rad", x),
        ("velocity", "rad/s", course.v),
        ("acceleration", "rad/s²", course.a),
    )
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7, 7), layout="constrained")
        for axes, (title, unit, values) in zip(figure.subplots(3, 1, sharex=True), panels, strict=True):
            for k, name in enumerate(robot.joint_names):
                axes.plot(t, values[:, k], color=COLOURS[k % len(COLOURS)], label=name)
            axes.set_title(f"{title} [{unit}]")
        axes.set_xlabel("time [s]")
        figure.suptitle(f"{motion.name} of {robot.name}, {motion.duration:.3g} s")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
        if path is not None:
            with atomic_write(path) as temporary:
                figure.savefig(temporary, dpi=150)
    return figure
