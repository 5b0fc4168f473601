"""Links without inertia are weighed by their shapes, where a density is given."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from small_arm import FORE_INERTIAL, TOOL, written

import eladapt as ea
from eladapt.errors import ArgumentError, UrdfError
from eladapt.robot.model import Robot
from eladapt.simulation.mujoco_plant import MujocoPlant

DENSITY = 2700.0
SHAPE = '<{0}><origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/><geometry>{1}</geometry></{0}>'
PLACE = pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.5, 0.6), np.array([0.1, 0.2, 0.3]))
BOX = '<box size="0.1 0.2 0.3"/>'


def of_shapes(folder: Path, *shapes: str) -> Path:
    """The arm with these shapes, and no inertia, on its last moving link."""
    return written(folder, (FORE_INERTIAL, f'<link name="fore">{"".join(shapes)}</link>'))


def facet(*corners: tuple[float, ...]) -> str:
    """A triangle of an STL file."""
    listed = "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
    return f"facet normal 0 0 1\nouter loop\n{listed}endloop\nendfacet\n"


def weighed(path: Path) -> pin.Inertia:
    return Robot.from_urdf(path, density=DENSITY).weighed["fore"]


def assert_same(found: pin.Inertia, expected: pin.Inertia) -> None:
    np.testing.assert_allclose(
        found.toDynamicParameters(), expected.toDynamicParameters(), rtol=1e-12, atol=1e-12
    )


SOLIDS = {
    BOX: pin.Inertia.FromBox(DENSITY * 0.006, 0.1, 0.2, 0.3),
    '<cylinder radius="0.1" length="0.4"/>': pin.Inertia.FromCylinder(DENSITY * np.pi * 0.004, 0.1, 0.4),
    '<sphere radius="0.1"/>': pin.Inertia.FromSphere(DENSITY * 4 / 3 * np.pi * 0.001, 0.1),
}


@pytest.mark.parametrize("kind", ["collision", "visual"])
@pytest.mark.parametrize(("form", "solid"), SOLIDS.items())
def test_a_link_is_weighed_by_its_shape(tmp_path, kind, form, solid):
    """A solid of that density where the shape is, in the robot's model as in `weighed`."""
    path = of_shapes(tmp_path, SHAPE.format(kind, form))
    assert_same(weighed(path), PLACE.act(solid))
    assert_same(Robot.from_urdf(path, density=DENSITY).model.inertias[2], PLACE.act(solid))


def test_collision_shapes_come_before_visual_ones_and_add_up(tmp_path):
    path = of_shapes(tmp_path, SHAPE.format("visual", BOX), *[SHAPE.format("collision", s) for s in SOLIDS])
    assert_same(weighed(path), sum((PLACE.act(solid) for solid in SOLIDS.values()), pin.Inertia.Zero()))


def test_a_mesh_is_weighed_as_its_convex_hull(tmp_path):
    """A block of 0.1 x 0.2 x 0.3 m written in mm, its corners alone, is that block."""
    corners = [(x, y, z) for x in (-50, 50) for y in (-100, 100) for z in (-150, 150)]
    facets = "".join(facet(*corners[k : k + 3]) for k in range(6))
    (tmp_path / "block.stl").write_text(f"solid block\n{facets}endsolid block\n")
    path = of_shapes(
        tmp_path, SHAPE.format("collision", '<mesh filename="block.stl" scale="1e-3 1e-3 1e-3"/>')
    )
    assert_same(weighed(path), PLACE.act(SOLIDS[BOX]))


def test_only_what_has_no_inertia_of_its_own_is_weighed(tmp_path):
    """Not the links that have one, though they have shapes, nor the base."""
    shaped = SHAPE.format("collision", BOX)
    path = written(tmp_path, ('<link name="base"/>', f'<link name="base">{shaped}</link>'),
                   (TOOL, f'<link name="tool">{shaped}</link>'))  # fmt: skip
    robot = Robot.from_urdf(path, density=DENSITY)
    assert set(robot.weighed) == {"tool"}
    assert robot.model.inertias[1] == Robot.from_urdf(path).model.inertias[1]


def test_without_a_density_it_is_named_as_the_way(tmp_path):
    with pytest.raises(
        UrdfError, match=r'links "fore", "tool".*mass 0 kg.*density= \[kg/m\^3\] \(--density\)'
    ):
        Robot.from_urdf(of_shapes(tmp_path, SHAPE.format("collision", BOX)))


NO_WEIGHT = {
    # the shape, and what must be said of it
    "no shape": ("", r'links "fore", "tool".*mass 0 kg'),
    "a box without height": ('<box size="0.1 0 0.1"/>', "<box>.*expected a size above 0"),
    "no form": (" ", 'link "fore" <collision>.*no geometry'),
    "a mesh that is nowhere": ('<mesh filename="no.stl"/>', '<mesh>: filename="no.stl".*there is none in'),
    "a mesh without volume": ('<mesh filename="flat.stl"/>', '"fore" <collision> <mesh>.*no volume'),
    "a mesh from elsewhere": ('<mesh filename="/etc/no.stl"/>', "lies outside the folders"),
}


@pytest.mark.parametrize(("shape", "said"), NO_WEIGHT.values(), ids=NO_WEIGHT)
def test_what_cannot_be_weighed_is_named(tmp_path, shape, said):
    flat = facet((0, 0, 0), (1, 0, 0), (0, 1, 0))
    (tmp_path / "flat.stl").write_text(f"solid flat\n{flat}endsolid flat\n")
    with pytest.raises(UrdfError, match=said):
        Robot.from_urdf(of_shapes(tmp_path, shape and SHAPE.format("collision", shape)), density=DENSITY)


@pytest.mark.parametrize("density", [0, -1.0, 1e-300, 2.7, 30_000, np.inf, "steel"])
def test_a_density_is_one_of_something_solid(tmp_path, density):
    with pytest.raises(ArgumentError, match="density: expected a"):
        Robot.from_urdf(of_shapes(tmp_path, SHAPE.format("collision", BOX)), density=density)


def test_a_weighed_robot_is_built_again_from_what_is_kept_of_it(tmp_path):
    """From its source, from a pickle, and in a record; MuJoCo simulates it too; it says so."""
    robot = Robot.from_urdf(of_shapes(tmp_path, SHAPE.format("collision", BOX)), density=DENSITY)
    assert "weighed at 2700 kg/m^3: 1" in repr(robot)
    assert Robot.from_source(robot.source).model == robot.model
    assert pickle.loads(pickle.dumps(robot)).weighed == robot.weighed
    q = robot.configuration([0.3, 0.8])
    plant = ea.PinocchioPlant(robot, q)
    record = ea.simulate(ea.CompositeController.for_robot(robot), plant, q, 0.05, progress=False)
    record.save(tmp_path / "run.npz")
    assert Robot.from_source(ea.Record.load(tmp_path / "run.npz").robot_source).model == robot.model
    other = MujocoPlant(robot, q, joint_friction=False)
    for one in (plant, other):
        one.reset()
        one.step(np.array([1.0, 2.0]), 1e-3)
    # Both by Runge-Kutta, in steps of their own: the fourth order of a millisecond apart.
    np.testing.assert_allclose(other.v, plant.v, rtol=1e-6)
