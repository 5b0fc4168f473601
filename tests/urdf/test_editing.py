"""New numbers in a URDF: they are read back to the last digit, and everything else is kept to the letter."""

import numpy as np
import pinocchio as pin
import pytest
from shared import load

import eladapt as ea
from eladapt.errors import UrdfError
from eladapt.urdf.editing import Edits, edited

BODY = [1.5, 0.015, 0.03, 0.045, 0.02, 0.001, 0.021, 0.002, 0.003, 0.022]
TEXT = """<?xml version="1.0"?>
<!-- <link name="b"> a comment -->
<robot name="a">
  <link name="b"/><!-- kept -->
  <link name="c"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="d">
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="j" type="revolute" note="a > b"><parent link="b"/><child link="c"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/><dynamics damping="1" note='"'/></joint>
  <joint name="k" type="fixed"><parent link="c"/><child link="d"/></joint>
  <gazebo reference="d"><inertial>not a link's</inertial></gazebo>
</robot>
"""


def test_all_but_the_edits_is_kept_to_the_letter():
    found = edited(TEXT.encode(), Edits({"c": BODY, "d": None}, {"j": {"armature": 0.1}})).decode()
    head, tail = found.split("<inertial>", 1)
    new, tail = tail.split("</inertial>", 1)
    assert 'mass value="1.5"' in new
    assert head.rstrip(" ") == TEXT[: TEXT.index("</link>")]
    left = head.rstrip(" ") + tail.lstrip("\n ")
    left = left.replace(
        '<dynamics damping="1" note="&quot;" armature="0.1"/>', '<dynamics damping="1" note=\'"\'/>'
    )
    old = TEXT[TEXT.index("    <inertial><mass") : TEXT.index("</inertial>\n  </link>") + len("</inertial>")]
    assert left == TEXT.replace(old, "    ")


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_links_without_a_body_get_one_in_any_encoding(tmp_path, encoding):
    text = TEXT.replace('version="1.0"', f'version="1.0" encoding="{encoding}"').replace(
        "kept", "gepr\u00fcft"
    )
    path = tmp_path / "arm.urdf"
    path.write_bytes(text.encode(encoding))
    robot = ea.Robot.from_urdf(path, edits=Edits({"b": BODY, "c": BODY}, {"j": {"armature": 0.1}}))
    body = pin.Inertia.FromDynamicParameters(np.array(BODY))
    hung = pin.Inertia(1.0, np.zeros(3), np.eye(3))
    both = (body + hung).toDynamicParameters()
    assert robot.model.inertias[1].toDynamicParameters() == pytest.approx(both, rel=1e-14)
    assert robot.armature == pytest.approx([0.1])
    assert robot.damping == pytest.approx([1.0])


def test_a_file_itself_may_give_rotors(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(TEXT.replace('damping="1"', 'damping="1" armature="0.25"'))
    assert ea.Robot.from_urdf(path).armature == pytest.approx([0.25])
    assert ea.Robot.from_urdf(path, armature={"j": 0.5}).armature == pytest.approx([0.5])
    path.write_text(TEXT.replace('damping="1"', 'damping="1" armature="-1"'))
    with pytest.raises(UrdfError, match='armature="-1"'):
        ea.Robot.from_urdf(path)


@pytest.mark.filterwarnings("ignore::eladapt.errors.MendedWarning", "ignore::eladapt.errors.UnitsWarning")
def test_what_was_weighed_or_mended_stays_so(tmp_path):
    """A link without <inertial>, and moments that no body has: an edit of something else changes neither."""
    path, viscous = tmp_path / "arm.urdf", Edits({}, {"j": {"damping": 0.5}})
    path.write_text(TEXT)
    weighed = ea.Robot.from_urdf(path, density=2700)
    changed = weighed.edited(viscous)
    assert changed.model.inertias[1].isApprox(weighed.model.inertias[1], 1e-12)  # through decimals
    assert changed.model.inertias[1].mass == pytest.approx(2701)
    assert ea.Robot.from_source(changed.source).model == changed.model
    path.write_text(TEXT.replace('iyy="1"', 'iyy="3"'))
    mended = ea.Robot.from_urdf(path, mend=True)
    assert mended.edited(viscous).model.inertias[1].isApprox(mended.model.inertias[1], 1e-12)


@pytest.mark.parametrize(
    ("edits", "said"),
    [
        (Edits({"x": BODY}), "unknown link 'x'; legal names: b, c, d"),
        (Edits({}, {"x": {"damping": 1.0}}), "unknown joint 'x'; legal names: j, k"),
        (
            Edits({}, {"j": {"dampping": 1.0}}),
            r"unknown dynamics of j 'dampping' \(did you mean 'damping'\?\); legal names: damping, friction",
        ),
        (Edits({"c": BODY[:9]}), r"inertials of c: expected shape \(10,\)"),
        (Edits({"c": [np.nan] * 10}), "inertials of c: expected finite"),
    ],
)
def test_edits_of_what_is_not_there_are_refused(tmp_path, edits, said):
    path = tmp_path / "arm.urdf"
    path.write_text(TEXT)
    with pytest.raises(ValueError if "inertials" in said else LookupError, match=said):
        ea.Robot.from_urdf(path, edits=edits)


@pytest.mark.parametrize("name", ["two_link", "ur5", "panda", "talos_left_arm"])
def test_an_edited_robot_is_one_like_any_other(name):
    """Its source makes it again, MuJoCo has its mass matrix, and what was not edited is as before."""
    robot = load(name)
    joint = robot.joint_names[-1]
    link = next(
        j.find("child").get("link") for j in robot.document().findall("joint") if j.get("name") == joint
    )
    smooth = {name: {"friction": 0.0} for name in robot.joint_names}
    changed = robot.edited(
        Edits({link: BODY}, {**smooth, joint: {"armature": 0.1, "damping": 0.2, "friction": 0}})
    )
    assert changed.model.inertias[-1].mass != robot.model.inertias[-1].mass
    assert changed.armature[-1] == 0.1
    assert changed.damping[-1] == 0.2
    assert np.array_equal(changed.armature[:-1], robot.armature[:-1])
    assert changed.home == pytest.approx(robot.home)
    again = ea.Robot.from_source(changed.source)
    assert again.model == changed.model
    assert again.source == changed.source
    twice = changed.edited(Edits({}, {joint: {"friction": 0.3}}))
    assert (twice.damping[-1], twice.friction[-1]) == (0.2, 0.3)
    q, asked = robot.configuration(robot.home), np.full(robot.nv, 5.0)
    plant = ea.MujocoPlant(changed, q)
    plant.reset()
    # from rest, over 1 us, in which viscous friction makes nothing yet
    plant.step(changed.gravity(q) + changed.mass_matrix(q) @ asked, 1e-6)
    assert plant.v == pytest.approx(1e-6 * asked, rel=1e-3)
