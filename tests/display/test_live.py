"""The live view shows what it is told, to this computer only, and never keeps the loop waiting."""

import asyncio
import os
import signal
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
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import eladapt as ea
from eladapt.errors import ArgumentError, MeshWarning
from eladapt.meshes.mesh import Mesh
from eladapt.viewing.live import FRAMES_PER_SECOND, HEAD
from eladapt.viewing.live_server import Stage
from eladapt.viewing.page import POLICY
from eladapt.viewing.scene import visuals_of


@pytest.fixture(scope="module")
def robot():
    return ea.Robot.load("two_link")


@pytest.fixture(scope="module")
def live(robot):
    with ea.view(robot, live=True) as shown:
        yield shown


@pytest.fixture
def fresh(robot):
    """One that a test may break."""
    with ea.view(robot, live=True) as shown:
        yield shown


def listen(url, seconds, origin=None):
    """The commands that a browser gets within some seconds."""
    commands = []

    async def follow():
        headers = {"Origin": origin or url.rstrip("/")}
        stream = await websocket_connect(HTTPRequest(url.replace("http", "ws") + "stream", headers=headers))
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                message = await asyncio.wait_for(stream.read_message(), left)
            except TimeoutError:
                break
            commands.append(umsgpack.unpackb(message))
        stream.close()

    asyncio.run(follow())
    return commands


def feed(live, seconds, posture, goal=None, mass=0.0):
    """A loop at 1 kHz, more or less, in a thread of its own."""

    def loop():
        began = time.monotonic()
        while (t := time.monotonic() - began) < seconds:
            live.show(t, posture(t), goal, mass=mass)
            time.sleep(1e-3)

    thread = threading.Thread(target=loop)
    thread.start()
    return thread


def test_the_newest_posture_is_drawn(live, robot):
    """Joint placements are those of forward kinematics, and the ghost's those of the set-point."""
    q, goal = robot.configuration([0.4, -1.1]), robot.configuration([2.0, 0.3])
    thread = feed(live, 4.0, lambda _t: q, goal, mass=2.0)  # long enough for a server that starts slowly
    commands = listen(live.url, 3.0)
    thread.join()
    placed = {
        c["path"]: np.array(c["matrix"]).reshape(4, 4).T for c in commands if c["type"] == "set_transform"
    }
    for name, posture in (("robot", q), ("set-point", goal)):
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, posture)
        for joint in (1, 2):
            # MessagePack carries single precision.
            np.testing.assert_allclose(
                placed[f"/meshcat/{name}/{joint}"], data.oMi[joint].homogeneous, atol=1e-6
            )
    radius = placed["/meshcat/load"][0, 0]
    assert radius == pytest.approx((3 * 2.0 / (4 * np.pi * 2000)) ** (1 / 3), rel=1e-6)


def test_a_browser_gets_thirty_to_sixty_frames_a_second(live, robot):
    """From a loop of 1 kHz: the rest is dropped before it is sent."""
    thread = feed(live, 3.0, lambda t: robot.configuration([t, -t]))
    time.sleep(0.3)
    commands = listen(live.url, 2.0)
    thread.join()
    frames = sum(c["type"] == "set_transform" and c["path"] == "/meshcat/robot/1" for c in commands) / 2.0
    assert 25 < frames <= FRAMES_PER_SECOND + 1, "a little below 30, for a build server that is busy"


def test_a_server_that_stands_still_does_not_keep_the_loop(fresh, robot):
    """5000 postures into a stopped server: none takes long, and what does not fit is dropped."""
    q = robot.configuration([0.1, 0.2])
    os.kill(fresh._server.pid, signal.SIGSTOP)
    try:
        times = []
        for step in range(5000):
            fresh._next = 0.0  # as if the last frame were long ago
            began = time.perf_counter()
            fresh.show(1e-3 * step, q)
            times.append(time.perf_counter() - began)
    finally:
        os.kill(fresh._server.pid, signal.SIGCONT)
    assert fresh.dropped > 0
    assert fresh.sent + fresh.dropped == 5000
    # A blocked write would take for ever; the median is about 10 us.
    assert np.median(times) < 2e-4


def test_a_server_that_died_does_not_end_the_loop(fresh, robot):
    fresh._server.kill()
    fresh._server.wait()
    for step in range(10):
        fresh._next = 0.0
        fresh.show(float(step), robot.configuration([0.0, 0.0]))


def test_a_posture_that_is_not_finite_is_not_drawn(live, robot):
    q = robot.configuration([0.3, 0.3])
    thread = feed(live, 1.2, lambda _t: np.full(2, np.nan))
    placed = [c["matrix"] for c in listen(live.url, 0.8) if c["type"] == "set_transform"]
    assert np.isfinite(placed).all()
    assert len(placed) <= 5, "what stood there before, once: two arms of two links, and the load"
    thread.join()
    thread = feed(live, 1.0, lambda _t: q)
    assert listen(live.url, 0.6) != []
    thread.join()


def test_a_posture_of_another_shape_is_refused(live):
    live._next = 0.0
    with pytest.raises(ArgumentError, match=r"expected shape \(2,\)"):
        live.show(0.0, np.zeros(3))


def test_it_is_an_observer_of_a_simulation(fresh, robot):
    """And estimates the load seldom, from the controller's state."""
    controller = ea.CompositeController.for_robot(robot)
    asked = []

    def carried(state):
        asked.append(state)
        return ea.carried(controller, state)

    fresh._load = carried
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    ea.simulate(controller, plant, robot.configuration(robot.target), 0.5, progress=False, observer=fresh)
    assert fresh.sent > 2
    assert 1 <= len(asked) <= fresh.sent


def test_it_listens_on_the_loopback_interface_only(live):
    connections = psutil.Process(live._server.pid).net_connections("inet")
    addresses = [c.laddr.ip for c in connections if c.status == psutil.CONN_LISTEN]
    assert addresses == ["127.0.0.1"]


@pytest.mark.parametrize(
    ("path", "host"), [("", "somebody.example"), ("../../etc/passwd", None), ("x", None)]
)
def test_the_server_gives_one_page_under_its_own_name(live, path, host):
    request = urllib.request.Request(live.url + path, headers={"Host": host} if host else {})
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(request, timeout=10)


def test_the_page_may_ask_for_nothing_but_its_stream(live):
    with urllib.request.urlopen(live.url, timeout=30) as answer:
        page = answer.read().decode()
    stream = live.url.replace("http", "ws") + "stream"
    assert f'content="{POLICY}; connect-src {stream}"' in page


def test_a_page_of_another_origin_gets_no_stream(live):
    with pytest.raises(HTTPClientError, match="403"):
        listen(live.url, 0.5, origin="http://somebody.example")


def test_a_port_that_is_taken_is_an_error(live, robot):
    port = int(live.url.rsplit(":", 1)[1].strip("/"))
    with pytest.raises(ArgumentError, match=f"port {port}"):
        ea.view(robot, live=True, port=port)


def test_a_record_cannot_be_live(record_of, robot, tmp_path):
    with pytest.raises(ArgumentError, match="live"):
        ea.view(record_of("two_link"), live=True)
    with pytest.raises(ArgumentError, match="live"):
        ea.view(robot, live=True, html=tmp_path / "x.html")
    with pytest.raises(ArgumentError, match="Record"):
        ea.view(robot)


@pytest.mark.parametrize("forked", ["", "if not os.fork(): time.sleep(15); os._exit(0)"])
def test_the_server_ends_with_the_process_that_started_it(forked):
    """Also if that is killed, and cannot say goodbye, and if a process forked from it lives on."""
    program = f"""import eladapt as ea, os, signal, time
live = ea.view(ea.Robot.load("two_link"), live=True)
print(live._server.pid, flush=True)
{forked}
os.kill(os.getpid(), signal.SIGKILL)"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as started:
        _, server = started.stdout.readline(), int(started.stdout.readline())  # where it is seen comes first
    for _ in range(100):
        if not psutil.pid_exists(server) or psutil.Process(server).status() == psutil.STATUS_ZOMBIE:
            return
        time.sleep(0.1)
    raise AssertionError("the server is still there")


def test_who_was_too_slow_for_a_frame_gets_the_last_one(robot):
    """The set-point moves once, while a browser is still busy: it is told afterwards."""
    stage = Stage(robot)
    home, goal = robot.configuration(robot.home), robot.configuration([1.0, -1.0])
    moved = stage.step(np.array([0.0] * HEAD + [*home, *goal]))
    again = stage.step(np.array([0.1] + [0.0] * (HEAD - 1) + [*home, *goal]))
    ghost = {"/meshcat/set-point/1", "/meshcat/set-point/2"}
    paths = [{umsgpack.unpackb(c)["path"] for c in commands} for commands in (moved, again, stage.whole())]
    assert ghost <= paths[0]
    assert not ghost & paths[1], "it stays"
    assert ghost <= paths[2]


def test_a_mesh_from_elsewhere_is_left_out_by_name(tmp_path):
    """As in a recording: the view goes on without it."""
    (tmp_path / "robot").mkdir()
    secret, mesh = tmp_path / "secret.stl", tmp_path / "robot" / "link.stl"
    secret.write_text("solid one\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
                      "endloop\nendfacet\nendsolid one\n")  # fmt: skip
    (tmp_path / "robot" / "arm.urdf").write_text(
        f"""<robot name="arm"><link name="base"/><link name="link"><inertial><mass value="1"/>
        <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
        <visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>
        <joint name="hinge" type="revolute"><parent link="base"/><child link="link"/>
        <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="3"/></joint></robot>"""
    )
    robot = ea.Robot.from_urdf(tmp_path / "robot" / "arm.urdf")
    mesh.write_bytes(secret.read_bytes())
    assert [type(visual.form) for visual in visuals_of(robot)] == [Mesh]
    mesh.unlink()
    mesh.symlink_to(secret)  # exchanged since the robot was made
    with pytest.warns(MeshWarning, match=r'link_0: ".*link\.stl": lies outside the folders'):
        assert Mesh not in [type(visual.form) for visual in visuals_of(robot)]
    with ea.view(robot, live=True) as live:
        live.show(0.0, robot.configuration(robot.home))
