"""Bodies that none can be are refused, or mended where asked; those on the edge pass."""

from __future__ import annotations

import numpy as np
import pytest
from small_arm import FORE_INERTIA, FORE_INERTIAL, TOOL, ZERO, model_of, refused, written

from eladapt.errors import MendedWarning, UrdfError
from eladapt.robot.model import Robot
from eladapt.urdf.checks import check_model

BODIES = {
    "massless": (FORE_INERTIAL, '<link name="fore"/>', '"fore", "tool" on joint "elbow"', "mass 0 kg"),
    "triangle": ('izz="0.02"', 'izz="0.08"', 'link "upper" on joint "shoulder"', "0.03, 0.04, 0.08"),
    "negative moment": ('ixx="0.03"', 'ixx="-0.03"', 'link "upper" on joint "shoulder"', "-0.03, 0.02, 0.04"),
    "product too large": ('iyz="0" izz="0.02"', 'iyz="0.05" izz="0.02"', 'link "upper"', "-0.0209902"),
    "mass on the axis": (
        FORE_INERTIA, FORE_INERTIA.replace("0.004", "0").replace("0.003", "0").replace("0.002", "0"),
        'joint "elbow"', "0 kg m^2 about its axis",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "element", "value"), BODIES.values(), ids=BODIES.keys())
def test_an_impossible_body_is_refused(tmp_path, old, new, element, value):
    """What Pinocchio loads but no body can be is refused with its links and its number."""
    path = written(tmp_path, (old, new))
    error = refused(check_model, model_of(path), path)
    (finding,) = error.findings
    assert element in finding.element
    assert value in finding.value
    assert str(path) in str(error)


def test_joints_that_move_no_inertia_together_are_refused(tmp_path):
    """Two joints on one axis with a point mass between leave M singular, though each turns inertia."""
    path = written(
        tmp_path,
        ('<origin xyz="0 0 0.2"/> <mass', "<mass"),
        ('ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"', ZERO),
        ('axis xyz="0 1 0"', 'axis xyz="1 0 0"'),
    )
    (finding,) = refused(check_model, model_of(path), path).findings
    assert finding.element == 'joints "shoulder", "elbow"'


@pytest.mark.parametrize("armature", [-0.1, np.nan, np.inf])
def test_an_impossible_armature_is_refused(tmp_path, armature):
    """A rotor inertia is finite and not negative."""
    path = written(tmp_path)
    model = model_of(path)
    model.armature[1] = armature
    (finding,) = refused(check_model, model, path).findings
    assert 'joint "elbow"' in finding.element
    assert f"armature {armature:g}" in finding.value


ROD = 'ixx="0" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.012"'
IMPOSSIBLE = 'ixx="0.0001" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.0123"'
HEAVY_TOOL = '<link name="tool"><inertial><mass value="{}"/><inertia {}/></inertial></link>'
SOUND = {
    "rod without width": ('ixx="0.003" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.002"', ROD),
    "point mass off the axis": ('ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"', ZERO),
    "massless tool": (TOOL, HEAVY_TOOL.format(0, ZERO)),
    "tool that the arm makes up for": (TOOL, HEAVY_TOOL.format(0.1, IMPOSSIBLE)),
    "range of nothing": ('lower="-3" upper="3" effort="40" velocity="2"', 'effort="0" velocity="0"'),
}


@pytest.mark.parametrize(("old", "new"), SOUND.values(), ids=SOUND.keys())
def test_the_edge_of_the_physical_passes(tmp_path, old, new):
    """Bodies on the boundary pass, and a link counts only as part of the body that moves with it."""
    path = written(tmp_path, (old, new))
    check_model(model_of(path), path)


def test_armature_makes_up_for_inertia(tmp_path):
    """A joint that turns no inertia is refused; with a rotor it passes."""
    path = written(tmp_path, (FORE_INERTIA, f"<inertia {ZERO}/>"))
    model = model_of(path)
    refused(check_model, model, path)
    model.armature[1] = 0.01
    check_model(model, path)


def test_a_body_that_is_none_is_mended_where_asked(tmp_path):
    """Principal moments 0.03, 0.04 and 0.08: the nearest physical ones, told; mass and centre stay, and what
    is physical is left alone."""
    plain = Robot.from_urdf(written(tmp_path)).model
    path = written(tmp_path, ('ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"',
                              'ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.08"'))  # fmt: skip
    with pytest.raises(UrdfError, match="mend=True"):
        Robot.from_urdf(path)
    with pytest.warns(MendedWarning, match=r"'shoulder': principal moments 0\.03 -> .*0\.08 -> "):
        robot = Robot.from_urdf(path, mend=True)
    body = robot.model.inertias[1]
    moments = np.linalg.eigvalsh(body.inertia)
    assert moments[2] <= moments[0] + moments[1]
    # S was (0.045, 0.035, -0.005); raising the last by d raises two moments by d, and by no more than needed.
    np.testing.assert_allclose(moments, [0.035045, 0.045045, 0.08], rtol=1e-3)
    assert body.mass == plain.inertias[1].mass
    np.testing.assert_array_equal(body.lever, plain.inertias[1].lever)
    assert robot.model.inertias[2] == plain.inertias[2]
    with pytest.warns(MendedWarning):
        assert Robot.from_source(robot.source).model == robot.model
