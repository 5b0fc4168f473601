"""The load on the arm as balls: one as heavy as the estimate says, a wireframe for the true one."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from meshcat import geometry as draw
from meshcat.animation import Animation

from eladapt.records.record import Record
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index
from eladapt.viewing.scene import LOAD_COLOUR, TRUE_LOAD_COLOUR, Motion, Scene

DENSITY = 2000.0  # [kg/m^3] of the balls, that of stone: 2 kg make a ball of 0.12 m
WIRES = 1.04  # the true ball's radius by its mass: wires just outside an estimate that is right
UNSEEN = 1e-4  # [m] the radius of no load: three.js inverts scales, so none may be 0
UNEXPLAINED = 0.5  # an estimate of which a load explains less than half is not one of a load
FARTHEST = 0.5  # [m] from the frame; a small mass far away is a rotation that was not excited


class Loads(NamedTuple):
    """Balls frame by frame: centres (frames, 3) and radii (frames,), both [m]; true ones where known."""

    centre: np.ndarray
    radius: np.ndarray
    true_centre: np.ndarray | None
    true_radius: np.ndarray | None


def radius_of(mass: float) -> float:
    """[m] of the ball that weighs ``mass`` [kg]."""
    return max(UNSEEN, (3 * max(mass, 0.0) / (4 * math.pi * DENSITY)) ** (1 / 3))


def credible(mass: float, centre: np.ndarray, misfit: float) -> tuple[float, np.ndarray]:
    """Mass and centre as they are drawn: none where the estimate is not yet one of a load."""
    if not np.isfinite(mass) or misfit > UNEXPLAINED:
        return 0.0, np.zeros(3)
    known = np.where(np.isfinite(centre), centre, 0.0)
    return max(mass, 0.0), known if np.linalg.norm(known) < FARTHEST else np.zeros(3)


def loads_of(record: Record, robot: Robot, motion: Motion, times: np.ndarray) -> Loads | None:
    """The balls at ``times`` [s] of the record's run; None for a record in which no load was felt."""
    if record.carried is None or not len(record.carried):
        return None
    plant = record.configuration.get("plant") or {}
    while "plant" in plant:
        plant = plant["plant"]
    true = plant.get("payload")
    name = (true or {}).get("frame") or robot.tool
    frame = robot.model.frames[frame_index(robot.model, name)]
    places = motion.joints[:, frame.parentJoint] @ frame.placement.homogeneous
    nothing = np.array([[0.0, 0, 0, 0, 0, 1.0]])  # before the first estimate
    rows = np.searchsorted(record.carried[:, 0], times + record.t[0], side="right")
    found = [credible(row[1], row[2:5], row[5]) for row in np.vstack([nothing, record.carried])[rows]]
    centre = _moved(places, np.array([centre for _, centre in found]))
    radius = np.array([radius_of(mass) for mass, _ in found])
    if true is None:
        return Loads(centre, radius, None, None)
    held = (times + record.t[0] >= true["attach"]) & (times + record.t[0] < true["release"])
    size = np.where(held, WIRES * radius_of(true["mass"]), UNSEEN)
    return Loads(centre, radius, _moved(places, np.tile(true["com"], (len(times), 1))), size)


def draw_balls(scene: Scene) -> None:
    """Balls of radius 1 for the estimated and the true load; `place` and `animate` give them a size."""
    solid = draw.MeshPhongMaterial(LOAD_COLOUR, opacity=0.75)
    wires = draw.MeshBasicMaterial(TRUE_LOAD_COLOUR, wireframe=True)
    scene.draw("load", draw.Sphere(1.0), solid)
    scene.draw("true load", draw.Sphere(1.0), wires)
    for name in ("load", "true load"):
        place(scene, name, np.zeros(3), UNSEEN)


def place(scene: Scene, name: str, centre: np.ndarray, radius: float) -> None:
    """Put a ball somewhere."""
    matrix = np.diag([radius, radius, radius, 1.0])
    matrix[:3, 3] = centre
    scene.root[name].set_transform(matrix)


def animate(scene: Scene, loads: Loads, animation: Animation) -> None:
    """Balls that move and grow with the run."""
    draw_balls(scene)
    balls = [("load", loads.centre, loads.radius)]
    if loads.true_centre is not None and loads.true_radius is not None:
        balls.append(("true load", loads.true_centre, loads.true_radius))
    for name, centres, radii in balls:
        place(scene, name, centres[0], radii[0])
        for frame, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
            at = animation.at_frame(scene.root[name], frame)
            at.set_property("position", "vector3", [float(x) for x in centre])
            at.set_property("scale", "vector3", [float(radius)] * 3)


def _moved(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.einsum("kij,kj->ki", places[:, :3, :3], points) + places[:, :3, 3]
