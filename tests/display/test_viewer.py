"""The page shows the motion that the record holds, by itself, and to this computer only."""

import base64
import collections
import contextlib
import dataclasses
import html.parser
import json
import math
import os
import re
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request

import numpy as np
import pinocchio as pin
import psutil
import pytest
import umsgpack
from display_records import loaded

import eladapt as ea
from eladapt.errors import MeshWarning
from eladapt.robot.reading import frame_index
from eladapt.viewing import page as serving
from eladapt.viewing.loads import UNSEEN, loads_of, radius_of
from eladapt.viewing.meshes import ROBOT_TRIANGLES
from eladapt.viewing.page import VIEWER_CODE
from eladapt.viewing.scene import motion_of

TRIANGLE = """solid one
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 0.1 0 0
vertex 0 0.1 0
endloop
endfacet
endsolid one
"""
ARM = """<robot name="arm">
<link name="base"/>
<link name="link"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{visual}</link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="link"/><origin xyz="0 0 0.3"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="3"/></joint>
</robot>"""
MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'


class Page:
    """A written page, read back: its commands by type, with their paths."""

    def __init__(self, text):
        self.text = text
        packed = json.loads(re.search(r"for \(const command of (\[.*?\])\)", text).group(1))
        self.commands = [umsgpack.unpackb(base64.b64decode(command)) for command in packed]
        self.camera = json.loads(re.search(r"const camera = (\{.*?\});", text).group(1))

    def of(self, kind, within=""):
        found = [command for command in self.commands if command["type"] == kind]
        return {
            command["path"]: command for command in found if command["path"].startswith(f"/meshcat/{within}")
        }

    def geometries(self, within):
        return [command["object"]["geometries"][0] for command in self.of("set_object", within).values()]

    def placement(self, path):
        return np.array(self.of("set_transform")[f"/meshcat/{path}"]["matrix"]).reshape(4, 4).T

    def animation(self):
        return next(command for command in self.commands if command["type"] == "set_animation")

    def track(self, path, name):
        clip = next(a["clip"] for a in self.animation()["animations"] if a["path"] == f"/meshcat/{path}")
        keys = next(track["keys"] for track in clip["tracks"] if track["name"] == f".{name}")
        return np.array([key["time"] for key in keys]) / clip["fps"], np.array([key["value"] for key in keys])


def array(data):
    kind = {"Float32Array": np.float32, "Uint32Array": np.uint32}[data["type"]]
    return np.frombuffer(data["array"].data, kind).reshape(-1, data["itemSize"])


@pytest.fixture
def page_of(record_of, tmp_path):
    def make(robot, *args, **options):
        changes = {key: options.pop(key) for key in list(options) if key not in ("speed", "loop")}
        record = record_of(robot, *args, **changes)
        return record, Page(ea.view(record, html=tmp_path / "run.html", **options).path.read_text("utf-8"))

    return make


def arm(folder, visual="", **options):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.urdf").write_text(ARM.format(visual=visual))
    return ea.Robot.from_urdf(folder / "arm.urdf", **options)


def oMi(robot, q):
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return data.oMi


def test_the_page_makes_no_request(page_of):
    _, page = page_of("two_link")
    loads = []

    class Reader(html.parser.HTMLParser):
        def handle_starttag(self, tag, attributes):
            loads.extend((tag, name) for name, _ in attributes if name in ("src", "href", "data", "action"))
            policies.extend(
                value for name, value in attributes if name == "content" and "default-src" in value
            )

    policies = []
    Reader().feed(page.text)
    assert loads == []
    assert len(policies) == 1
    assert "default-src 'none'" in policies[0]
    assert not re.search(r"https?:|ws:|//[a-z]", policies[0])
    own = page.text.replace(VIEWER_CODE.read_text("utf-8"), "")
    assert len(own) < len(page.text), "the viewer itself is not in the page"
    assert not re.findall(r"(?:https?|wss?|file|ftp)://", own)


@pytest.mark.parametrize("speed", [1.0, 0.25, 4.0])
def test_the_animation_lasts_as_long_as_the_motion_at_that_speed(page_of, speed):
    record, page = page_of("two_link", 2.0, speed=speed)
    times, _ = page.track("robot/1", "position")
    assert times[0] == 0
    assert times[-1] == pytest.approx(record.t[-1] / speed, abs=1 / 30)
    np.testing.assert_allclose(np.diff(times), 1 / 30, rtol=1e-6)


@pytest.mark.parametrize("name", ["two_link", "kinova"])
def test_every_joint_moves_as_forward_kinematics_says(page_of, name):
    """Kinova's continuous joints have configurations (cos, sin), which are interpolated on the circle."""
    record, page = page_of(name)
    robot = ea.Robot.load(name)
    for joint in range(1, robot.model.njoints):
        times, positions = page.track(f"robot/{joint}", "position")
        _, quaternions = page.track(f"robot/{joint}", "quaternion")
        for frame in (0, len(times) // 3, len(times) - 1):
            at = oMi(robot, record.q[round(times[frame] / record.dt)])[joint]
            np.testing.assert_allclose(positions[frame], at.translation, atol=2e-3)
            shown = pin.Quaternion(np.array(quaternions[frame])).toRotationMatrix()
            np.testing.assert_allclose(shown, at.rotation, atol=5e-3)


def test_the_ghost_stands_at_the_set_point(page_of):
    record, page = page_of("two_link")
    robot = ea.Robot.load("two_link")
    for joint, at in enumerate(oMi(robot, record.goal[0])):
        if joint:
            np.testing.assert_allclose(page.placement(f"set-point/{joint}"), at.homogeneous, atol=1e-6)
    assert page.of("set_object", "set-point").keys() == {
        path.replace("robot", "set-point") for path in page.of("set_object", "robot")
    }
    assert not any("set-point" in animation["path"] for animation in page.animation()["animations"])


def test_a_moving_set_point_moves_its_ghost(page_of, record_of):
    q = record_of("two_link").q
    _, page = page_of("two_link", goal=q)
    ghost, robot = page.track("set-point/2", "quaternion"), page.track("robot/2", "quaternion")
    assert np.ptp(robot[1], axis=0).max() > 0.05
    np.testing.assert_array_equal(ghost[1], robot[1])


def test_the_line_is_the_path_of_the_tool(page_of):
    record, page = page_of("panda")
    robot = ea.Robot.load("panda")
    (line,) = page.geometries("tool path")
    points = array(line["data"]["attributes"]["position"])
    data, frame = robot.model.createData(), frame_index(robot.model, robot.tool)
    for point, q in ((points[0], record.q[0]), (points[-1], record.q[-1])):
        pin.framesForwardKinematics(robot.model, data, q)
        np.testing.assert_allclose(point, data.oMf[frame].translation, atol=1e-5)


def test_primitives_are_drawn_as_such(page_of):
    _, page = page_of("two_link")
    shapes = ea.Robot.load("two_link").visual_model()[0].geometryObjects
    wanted = collections.Counter(type(shape.geometry).__name__ for shape in shapes)
    drawn = collections.Counter(form["type"].removesuffix("Geometry") for form in page.geometries("robot"))
    assert drawn == wanted
    assert drawn["Cylinder"] > 0


def test_a_robot_without_visuals_is_drawn_as_sticks(page_of, tmp_path):
    _, page = page_of(arm(tmp_path / "bare"))
    limbs = [form["height"] for form in page.geometries("robot") if form["type"] == "CylinderGeometry"]
    assert sorted(limbs) == pytest.approx([0.3, 0.4]), "to the joint, and to the end of a uniform rod"


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_every_part_of_a_mesh_is_drawn(page_of, name):
    """As many triangles as Pinocchio's own reader finds, and no vertex without one."""
    _, page = page_of(name, 0.2)
    robot = ea.Robot.load(name)
    folders = list(robot.package_dirs)
    read = pin.buildGeomFromUrdf(robot.model, str(robot.path), pin.VISUAL, package_dirs=folders)
    expected = sum(shape.geometry.num_tris for shape in read.geometryObjects)
    drawn = 0
    for form in page.geometries("robot"):
        triangles = array(form["data"]["index"])
        vertices = array(form["data"]["attributes"]["position"])
        assert set(np.unique(triangles)) == set(range(len(vertices)))
        drawn += len(triangles)
    assert drawn == expected
    assert expected <= ROBOT_TRIANGLES
    assert 0 < sum(len(array(form["data"]["index"])) for form in page.geometries("set-point")) < expected / 3


def test_ten_seconds_of_panda_take_less_than_ten_megabytes(page_of, tmp_path):
    page_of("panda", 10.0)
    assert (tmp_path / "run.html").stat().st_size < 10e6


@pytest.mark.parametrize("name", ["two_link", "panda"])
def test_the_camera_has_the_whole_motion_in_view(page_of, name):
    record, page = page_of(name)
    robot, camera = ea.Robot.load(name), page.camera
    three = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # the world in three.js's axes
    towards = np.array(camera["towards"])
    eye = np.array(camera["target"]) + camera["distance"] * towards
    for q in (record.q[0], record.q[-1], record.goal[0]):
        for joint in oMi(robot, q)[1:]:
            ray = three @ joint.translation - eye
            off = math.degrees(math.acos(ray @ -towards / np.linalg.norm(ray)))
            assert off < camera["angle"] / 2
    assert camera["distance"] < 8, "both arms are about a metre high"


def test_the_same_record_gives_the_same_page(page_of):
    """So that nothing of the computer or the moment is in it."""
    assert page_of("two_link")[1].text == page_of("two_link")[1].text


def test_a_title_cannot_become_markup(page_of):
    _, page = page_of("two_link", title="</script><script>alert(1)</script>")
    assert "<script>alert" not in page.text


def test_a_run_that_diverged_is_shown_as_far_as_it_went(page_of, record_of):
    q = record_of("two_link").q.copy()
    q[501:] = np.nan
    _, page = page_of("two_link", q=q)
    assert page.track("robot/1", "position")[0][-1] == pytest.approx(0.5, abs=1 / 30)
    with pytest.raises(ea.EladaptError, match="finite"):
        page_of("two_link", q=np.full_like(q, np.nan))


def test_a_mesh_from_elsewhere_is_left_out_and_named(page_of, tmp_path):
    """The arm is made, runs, and is drawn as sticks where nothing else is left of it."""
    secret = tmp_path / "elsewhere" / "secret.stl"
    secret.parent.mkdir()
    secret.write_text(TRIANGLE)
    robot = arm(tmp_path / "robot", MESH.format(secret))
    with pytest.warns(MeshWarning, match=f"lies outside the folders.*{re.escape(str(secret))}"):
        _, page = page_of(robot)
    assert {form["type"] for form in page.geometries("robot")} == {"CylinderGeometry", "SphereGeometry"}


def test_a_mesh_that_was_exchanged_for_a_link_is_not_drawn(page_of, tmp_path):
    """Where a mesh lies is looked at again when it is drawn: it may have changed since the robot was made."""
    secret = tmp_path / "elsewhere" / "secret.stl"
    secret.parent.mkdir()
    secret.write_text(TRIANGLE)
    mesh = tmp_path / "robot" / "link.stl"
    robot = arm(tmp_path / "robot", MESH.format(mesh))
    mesh.symlink_to(secret)
    with pytest.warns(MeshWarning, match=re.escape(str(secret))):
        _, page = page_of(robot)
    assert "BufferGeometry" not in {form["type"] for form in page.geometries("robot")}


def test_a_mesh_beside_the_urdf_or_in_a_package_is_drawn(page_of, tmp_path):
    packages = {"package_dirs": [tmp_path / "package"]}
    for name, options in (
        (tmp_path / "robot" / "one.stl", {}), ("one.stl", {}), ("package://robot/../one.stl", {}),
        (tmp_path / "package" / "arm" / "one.stl", packages), ("package://arm/one.stl", packages),
    ):  # fmt: skip
        for folder in ("robot", "package/arm"):
            (tmp_path / folder).mkdir(parents=True, exist_ok=True)
            (tmp_path / folder / "one.stl").write_text(TRIANGLE)
        _, page = page_of(arm(tmp_path / "robot", MESH.format(name), **options))
        assert [len(array(form["data"]["index"])) for form in page.geometries("robot")] == [1], name


@pytest.mark.parametrize("name", ["run.txt", "run", "run.html.gz"])
def test_only_html_is_written(record_of, tmp_path, name):
    with pytest.raises(ea.EladaptError, match=r"\.html"):
        ea.view(record_of("two_link"), html=tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("speed", [0, -1, math.nan, "fast"])
def test_speed_is_a_positive_number(record_of, tmp_path, speed):
    with pytest.raises(ea.EladaptError, match="speed"):
        ea.view(record_of("two_link"), html=tmp_path / "run.html", speed=speed)


def listening():
    connections = psutil.Process(os.getpid()).net_connections("inet")
    return {connection.laddr for connection in connections if connection.status == psutil.CONN_LISTEN}


def test_the_server_listens_on_the_loopback_interface_only(record_of, capsys):
    before = listening()
    with contextlib.closing(ea.view(record_of("two_link"))) as shown:
        assert shown.url in capsys.readouterr().out
        opened = listening() - before
        assert [address.ip for address in opened] == ["127.0.0.1"]
        with urllib.request.urlopen(shown.url, timeout=10) as answer:
            Page(answer.read().decode())
        with pytest.raises(ea.EladaptError, match="port"):
            ea.view(record_of("two_link"), port=next(iter(opened)).port)
    assert listening() == before
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(shown.url, timeout=10)


@pytest.mark.parametrize(
    ("path", "host"), [("", "somebody.example"), ("../../etc/passwd", None), ("x", None)]
)
def test_the_server_gives_one_page_under_its_own_name(record_of, path, host):
    with contextlib.closing(ea.view(record_of("two_link"))) as shown:
        request = urllib.request.Request(shown.url + path, headers={"Host": host} if host else {})
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(request, timeout=10)


def test_browsers_that_hang_or_hang_up_cost_little(record_of, monkeypatch, capsys):
    """Half-open connections take at most so many threads, and go; a browser that is gone leaves no trace."""
    monkeypatch.setattr(serving._Handler, "timeout", 0.5)
    monkeypatch.setattr(serving, "MOST_CONNECTIONS", 4)
    with contextlib.closing(ea.view(record_of("two_link"))) as shown, contextlib.ExitStack() as opened:
        before, address = threading.active_count(), shown.server.server_address
        for _ in range(20):
            opened.enter_context(socket.create_connection(address)).sendall(b"GET / HT")
        time.sleep(0.2)
        assert threading.active_count() <= before + 4
        gone = opened.enter_context(socket.create_connection(address))
        gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # a reset, when closed
        gone.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        gone.close()
        time.sleep(1.0)
        with urllib.request.urlopen(shown.url, timeout=10) as answer:
            Page(answer.read().decode())
    assert capsys.readouterr().err == ""


def test_the_server_ends_with_the_process(record_of, tmp_path):
    record_of("two_link").save(tmp_path / "run.npz")
    program = f"import eladapt as ea; ea.view(ea.Record.load({str(tmp_path / 'run.npz')!r}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "http://127.0.0.1:" in done.stdout


def test_before_the_first_estimate_there_is_no_load():
    """A load that was only noticed on the way is drawn from then on."""
    record = loaded()
    late = dataclasses.replace(record, carried=record.carried[30:])  # from 1 s on
    robot = ea.Robot.from_source(record.robot_source)
    times = np.array([0.0, 0.5, 0.99, 1.01, 1.5])
    motion = motion_of(robot, record.t, record.q, times)
    radius = loads_of(late, robot, motion, times).radius
    assert np.all(radius[:3] == UNSEEN)
    assert np.all(radius[3:] == radius_of(2.0))
