"""An arm of two joints as a URDF, and its file with something changed."""

import pinocchio as pin
import pytest

from eladapt.errors import UrdfError
from eladapt.urdf.checks import check_urdf

ARM = """<robot name="arm">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 1" rpy="0 0 0"/>
    <parent link="base"/> <child link="upper"/>
    <axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="40" velocity="2"/>
    <dynamics damping="0.5" friction="0.1"/>
  </joint>
  <link name="upper">
    <inertial>
      <origin xyz="0 0 0.2"/> <mass value="2"/>
      <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.02"/>
    </inertial>
    <visual><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.03" length="0.4"/></geometry></visual>
  </link>
  <joint name="elbow" type="continuous">
    <parent link="upper"/> <child link="fore"/> <axis xyz="0 1 0"/>
  </joint>
  <link name="fore">
    <inertial>
      <mass value="1"/>
      <inertia ixx="0.003" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.002"/>
    </inertial>
  </link>
  <joint name="mount" type="fixed">
    <parent link="fore"/> <child link="tool"/> <axis xyz="0 0 0"/>
  </joint>
  <link name="tool"/>
</robot>
"""
ELBOW = '<parent link="upper"/> <child link="fore"/>'
TOOL = '<link name="tool"/>'
FORE_INERTIA = '<inertia ixx="0.003" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.002"/>'
ZERO = 'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"'
FORE_INERTIAL = ARM[ARM.index('<link name="fore">') : ARM.index('<joint name="mount"')]


def written(folder, *changes):
    """The arm as a file, with each (old, new) replaced; an old that is not there once is a mistake here."""
    text = ARM
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


def model_of(path):
    check_urdf(path)
    return pin.buildModelFromUrdf(str(path))


def refused(check, *arguments):
    with pytest.raises(UrdfError) as caught:
        check(*arguments)
    return caught.value
