"""Masses that lie where no arm has them are told, with the unit that they may be in."""

from __future__ import annotations

import warnings

import pytest
from small_arm import ARM, FORE_INERTIA, ZERO, written

from eladapt.errors import UnitsWarning
from eladapt.robot import library
from eladapt.robot.model import Robot
from eladapt.urdf.checks import check_urdf
from eladapt.urdf.sizes import misplaced_masses

MASS = '<link name="{0}"/>', '<link name="{0}"><inertial><mass value="{1}"/>{2}</inertial></link>'
COM = 'xyz="0 0 0.2"/> <mass'
BOX = '<inertia ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{0}"/>'
UPPER = '<origin xyz="0 0 0.2"/> <mass value="2"/>'
TOLD = {
    # what is changed, and what must be said of it
    "centre of mass in mm": ((COM, COM.replace("0.2", "200")), r'link "upper".* 200 m .*span 1 m.*in mm\?'),
    "inertia in g mm^2": ((FORE_INERTIA, BOX.format(3302.5)), r'"fore".*3302\.5.*1 kg.*70\.4 m.* g mm\^2'),
    "inertia in kg mm^2": ((FORE_INERTIA, BOX.format(3)), r'link "fore".* 3, 3 and 3 .*2\.12 m.*kg mm\^2'),
    "a placeholder": ((FORE_INERTIA, BOX.format(1.0)), r'link "fore".* 1, 1 and 1 .*1\.22 m.*placeholder\?'),
}  # fmt: skip


@pytest.mark.parametrize(("change", "told"), TOLD.values(), ids=TOLD)
def test_a_mass_out_of_reach_is_told(tmp_path, change, told):
    """Once, with the link, the value and the likely cause; the file is read all the same."""
    with pytest.warns(UnitsWarning, match=told) as caught:
        robot = Robot.from_urdf(written(tmp_path, change))
    assert robot.nv == 2
    assert sum("joints span 1 m" in str(warning.message) for warning in caught) == 1


QUIET = {
    "as it is": ("<robot name", "<robot name"),
    "a rod as long as the arm": (FORE_INERTIA, BOX.format(0.6)),  # sqrt(3 0.6 / 2) = 0.95 m
    "no inertia": (FORE_INERTIA, f"<inertia {ZERO}/>"),
    "no mass": (MASS[0].format("tool"), MASS[1].format("tool", 0, BOX.format(9))),
    "a base of any size": (MASS[0].format("base"), MASS[1].format("base", 1, BOX.format(9))),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new"), QUIET.values(), ids=QUIET)
def test_masses_within_reach_are_not_told(tmp_path, old, new):
    checked = check_urdf(written(tmp_path, (old, new)))
    assert list(misplaced_masses(checked.root, checked.locked)) == []


def test_an_arm_may_be_longer_than_a_metre(tmp_path):
    """What is far for one is near for another."""
    path = tmp_path / "crane.urdf"
    path.write_text(ARM.replace('xyz="0 0 1"', 'xyz="0 0 30"').replace(UPPER, UPPER.replace("0.2", "15")))
    checked = check_urdf(path)
    assert list(misplaced_masses(checked.root, checked.locked)) == []


def test_a_link_that_is_held_is_not_told(tmp_path):
    """Its mass is the base's, of which nothing depends."""
    path = written(tmp_path, (COM, COM.replace("0.2", "200")))
    checked = check_urdf(path, locked=["shoulder"])
    assert list(misplaced_masses(checked.root, checked.locked)) == []


@pytest.mark.parametrize("name", library.robots())
def test_published_robots_are_not_told(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnitsWarning)
        Robot.load(name)
