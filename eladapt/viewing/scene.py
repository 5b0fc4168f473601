"""What a scene holds: the arm and its ghost as MeshCat draws them, where they are, and the camera."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import coal
import meshcat
import numpy as np
import pinocchio as pin
import umsgpack
from meshcat import geometry as draw
from meshcat.animation import Animation

from eladapt.meshes.mesh import Mesh
from eladapt.robot.model import Robot
from eladapt.robot.reading import frame_index
from eladapt.viewing.meshes import Visual, drawn, meshes_of, shapes_of

GHOST_COLOUR, TRAIL_COLOUR, LOAD_COLOUR, TRUE_LOAD_COLOUR = 0xE8862A, 0x1F5FBF, 0x2F8F4E, 0x20262E
STICK_COLOUR = np.array([0.55, 0.6, 0.66, 1.0])
FIELD_OF_VIEW = 40.0  # [deg] vertical


class Motion(NamedTuple):
    """Where everything is, frame by frame."""

    joints: np.ndarray  # (frames, njoints, 4, 4), the world first
    tool: np.ndarray  # (frames, 3) [m]


def visuals_of(robot: Robot) -> list[Visual]:
    """The robot's visuals, or a stick figure when it has none.

    Warns, by MeshWarning, of meshes that are not drawn: foreign, too large, broken or nowhere.
    """
    model, uses = robot.visual_model()
    return shapes_of(model, meshes_of(robot, uses)) or _stick_figure(robot)


def _stick_figure(robot: Robot) -> list[Visual]:
    """Capsules from joint to joint, and from the last joints to what they carry."""
    model, figure = robot.model, []
    ends = [(model.parents[j], model.jointPlacements[j].translation) for j in range(1, model.njoints)]
    ends += [(j, tip_of(robot, j)) for j in range(1, model.njoints) if j not in list(model.parents)]
    thickness = 0.02 * sum(np.linalg.norm(end) for _, end in ends) or 0.02
    for joint, end in ends:
        length, upright = float(np.linalg.norm(end)), np.array([0.0, 0.0, 1.0])
        rotation = pin.Quaternion.FromTwoVectors(upright, end if length else upright).toRotationMatrix()
        placement = pin.SE3(rotation, end / 2).homogeneous
        figure.append(Visual(joint, placement, STICK_COLOUR, coal.Capsule(thickness, length)))
    return figure


def tip_of(robot: Robot, joint: int) -> np.ndarray:
    """(3,) the end of a last link in its joint's frame [m]: the tool, or where a uniform rod would end."""
    tool = robot.model.frames[frame_index(robot.model, robot.tool)]
    at_joint = tool.parentJoint != joint or np.linalg.norm(tool.placement.translation) < 1e-9
    return 2 * robot.model.inertias[joint].lever if at_joint else tool.placement.translation


def motion_of(robot: Robot, t: np.ndarray, q: np.ndarray, times: np.ndarray) -> Motion:
    """The placements at ``times`` of the motion q (N, nq) sampled at t (N,), both [s]."""
    model, data = robot.model, robot.model.createData()
    tool = robot.model.frames[frame_index(robot.model, robot.tool)].parentJoint
    tip = tip_of(robot, tool) if tool else np.zeros(3)
    before = np.clip(np.searchsorted(t, times, side="right") - 1, 0, max(len(t) - 2, 0))
    joints = np.empty((len(times), model.njoints, 4, 4))
    for frame, (k, time) in enumerate(zip(before, times, strict=True)):
        after = min(k + 1, len(t) - 1)
        share = (time - t[k]) / (t[after] - t[k]) if after > k else 0.0
        pin.forwardKinematics(model, data, pin.interpolate(model, q[k], q[after], share))
        joints[frame] = [placement.homogeneous for placement in data.oMi]
    return Motion(joints, joints[:, tool, :3, :3] @ tip + joints[:, tool, :3, 3])


class Scene:
    """MeshCat's commands, kept instead of sent: ``root`` draws into ``commands``."""

    def __init__(self) -> None:
        self.commands: list[bytes] = []  # MessagePack
        self.root = meshcat.Visualizer(window=self)
        self._numbers = itertools.count()

    def send(self, command: Any) -> None:
        self.commands.append(umsgpack.packb(command.lower(), force_float_precision="single"))

    def draw(self, path: str, shape: draw.Geometry, look: draw.Material, kind: type = draw.Mesh) -> None:
        """Draw one object. Its identifiers are counted: MeshCat's own hold the computer's address."""
        thing = kind(shape, look)
        for element in (shape, look, thing):
            element.uuid = str(next(self._numbers))
        self.root[path].set_object(thing)

    def draw_surroundings(self, distance: float) -> None:
        """A bright background, less light (white arms keep their shape), and a floor in scale."""
        self.root["/Background"].set_property("top_color", [0.98, 0.98, 0.99])
        self.root["/Background"].set_property("bottom_color", [0.78, 0.82, 0.87])
        for lamp, intensity in (("AmbientLight", 0.45), ("FillLight", 0.3)):
            self.root[f"/Lights/{lamp}/<object>"].set_property("intensity", intensity)
        for helper in ("/Axes", "/Grid"):
            self.root[helper].set_property("visible", False)
        cell = 10.0 ** math.floor(math.log10(distance / 4))
        count = math.ceil(distance / 3 / cell)
        edge = cell * count
        ends = [
            [(x, -edge, 0), (x, edge, 0), (-edge, x, 0), (edge, x, 0)]
            for x in np.linspace(-edge, edge, 2 * count + 1)
        ]
        lines = draw.PointsGeometry(np.array(ends).reshape(-1, 3).T)
        self.draw("floor", lines, draw.LineBasicMaterial(0x9AA4AE), draw.LineSegments)

    def draw_robots(self, visuals: Sequence[Visual]) -> None:
        """The robot and its ghost: a node a joint, with the shapes that the joint carries below it."""
        total = sum(len(shape.form.triangles) for shape in visuals if isinstance(shape.form, Mesh))
        for index, shape in enumerate(visuals):
            is_mesh = isinstance(shape.form, Mesh)
            *rgb, opacity = shape.colour
            colour = int.from_bytes(bytes(round(255 * min(max(part, 0), 1)) for part in rgb), "big")
            solid = draw.MeshPhongMaterial(colour, opacity=opacity, flatShading=is_mesh)
            ghostly = draw.MeshPhongMaterial(
                GHOST_COLOUR, opacity=0.3, flatShading=is_mesh,
                polygonOffset=True, polygonOffsetFactor=0, polygonOffsetUnits=300,  # the arm hides its ghost
            )  # fmt: skip
            for part, (geometry, thinned, placement) in enumerate(drawn(shape, total)):
                path = f"{shape.joint}/{index}.{part}"
                for name, form, look in (("robot", geometry, solid), ("set-point", thinned, ghostly)):
                    self.draw(f"{name}/{path}", form, look)
                    self.root[f"{name}/{path}"].set_transform(shape.placement @ placement)

    def move(self, name: str, motion: Motion, animation: Animation) -> None:
        for joint in range(1, motion.joints.shape[1]):
            node, placements = self.root[f"{name}/{joint}"], motion.joints[:, joint]
            node.set_transform(placements[0])
            if len(placements) > 1:
                for frame, placement in enumerate(placements):
                    animation.at_frame(node, frame).set_transform(placement)


def camera_for(visuals: Sequence[Visual], motion: Motion, ghost: Motion) -> dict[str, Any]:
    """A camera that has the whole motion in view, facing the plane it mostly moves in."""
    corners = [motion.tool]
    for shape in visuals:
        local = np.array(list(itertools.product(*zip(*shape.box(), strict=True))))
        local = shape.placement[:3, :3] @ local.T + shape.placement[:3, 3:]
        for placements in (motion.joints[::10], ghost.joints[::10]):
            world = placements[:, shape.joint]
            corners.append((world[:, :3, :3] @ local + world[:, :3, 3:]).swapaxes(1, 2).reshape(-1, 3))
    points = np.concatenate(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    centre, towards = (low + high) / 2, np.array([0.45, -0.45, 0.35])
    narrowest = int(np.argmin(high - low))
    towards[narrowest] = np.sign(towards[narrowest])
    towards /= np.linalg.norm(towards)
    right = np.cross([0, 0, 1], towards) / np.linalg.norm(towards[:2])
    axes = np.stack([right, np.cross(towards, right), towards])
    aside_x, aside_y, depth = axes @ (points - centre).T
    aside = np.maximum(np.abs(aside_x), np.abs(aside_y)) / math.tan(math.radians(FIELD_OF_VIEW / 2))
    return {  # in three.js's axes, where y is up
        "angle": FIELD_OF_VIEW, "distance": 1.1 * float(np.max(depth + aside)),
        "target": [centre[0], centre[2], -centre[1]], "towards": [towards[0], towards[2], -towards[1]],
    }  # fmt: skip
