"""What a person sees: arm, ghost, path and load, in a real browser that may ask nobody for anything."""

import contextlib
import time

import numpy as np
import pytest
from browsing import Scene, Tab, browser
from display_records import loaded

import eladapt as ea
from eladapt.errors import ArgumentError

pytestmark = pytest.mark.slow
ARMS = ("panda", "ur5", "two_link")


@pytest.fixture(scope="module")
def chrome():
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def opened(chrome, record_of, tmp_path_factory):
    """The recording of a robot's move, opened once."""
    scenes = {}

    def open_(name):
        if name not in scenes:
            path = tmp_path_factory.mktemp(name) / "run.html"
            scenes[name] = Scene(chrome, ea.view(record_of(name, 2.0), html=path).url)
        return scenes[name]

    return open_


def colours(robot: ea.Robot) -> np.ndarray:
    """(n, 3) directions of the URDF's colours; shade changes the length of a colour, not its direction."""
    given = np.array([shape.meshColor[:3] for shape in robot.visual_model()[0].geometryObjects])
    return np.unique(given / np.linalg.norm(given, axis=1, keepdims=True), axis=0)


@pytest.mark.parametrize("name", ARMS)
def test_arm_ghost_and_path_are_seen_in_their_colours(opened, name):
    """At the start: the arm in the URDF's colours, the set-point orange, the path blue."""
    scene = opened(name)
    scene.seek(0.0)
    arm = scene.drawn_by("robot")
    assert len(arm) > 2000
    hues = arm / np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), 1)
    likeness = (hues @ colours(ea.Robot.load(name)).T).max(axis=1)
    # Lamps are white, but edges blend with what is behind them; a foreign hue has a cosine of 0.6 to 0.95.
    assert np.mean(likeness > 0.98) > 0.9
    ghost = scene.drawn_by("set-point")
    assert len(ghost) > 500
    assert np.mean(ghost[:, 0] > ghost[:, 2] + 20) > 0.9, (
        "orange, however much of the background shines through"
    )
    scene.show("set-point", False)  # which would tint the path
    path = scene.drawn_by("tool path")
    scene.show("set-point", True)
    assert len(path) > 20
    assert np.mean(path[:, 2] > path[:, 0] + 20) > 0.8, "blue, but for the ends of the line's edges"


@pytest.mark.parametrize("name", ARMS)
def test_the_arm_moves_and_asks_nobody_for_anything(opened, name):
    scene = opened(name)
    first, last = scene.seek(0.0), scene.seek(1.9)
    moved = np.abs(first - last).max(axis=2) > 12
    assert moved.sum() > 500
    again = scene.seek(0.0)
    assert np.array_equal(first, again), "the same time is the same picture"
    assert scene.foreign() == []
    assert scene.errors == []


@pytest.mark.parametrize("name", ARMS)
def test_every_visual_of_the_urdf_is_a_mesh_that_can_be_seen(opened, name):
    """UR5: seven visuals of several materials each, none of them lost."""
    scene = opened(name)
    scene.seek(0.0)
    visuals = ea.Robot.load(name).visual_model()[0].geometryObjects
    meshes = scene.meshes("robot")
    assert len(meshes) == len(visuals)
    for hidden in ("robot", "set-point"):
        scene.show(hidden, False)
    background = scene.settled()
    scene.show("robot", True)
    whole = meshes
    for shown in whole:
        for mesh in whole:
            scene.show(f"robot/{mesh}", mesh == shown)
        seen = np.abs(scene.settled() - background).max(axis=2) > 12
        assert seen.sum() > 20, shown
    for mesh in whole:
        scene.show(f"robot/{mesh}", True)
    scene.show("set-point", True)


def test_the_recording_stops_starts_and_changes_speed_by_its_controls(chrome, record_of, tmp_path):
    record = record_of("two_link", 4.0)
    scene = Scene(chrome, ea.view(record, html=tmp_path / "run.html").url)
    page = scene.page
    page.get_by_text("Open Controls").click()
    assert scene.frame.evaluate("viewer.animator.playing")
    page.get_by_text("pause", exact=True).first.click()
    assert not scene.frame.evaluate("viewer.animator.playing")
    still = scene.settled()
    time.sleep(0.5)
    assert np.array_equal(scene.pixels(), still)
    speed = page.locator("li.cr", has_text="timeScale").locator("input").first
    speed.fill("0.25")
    speed.press("Enter")
    assert scene.frame.evaluate("viewer.animator.mixer.timeScale") == 0.25
    page.get_by_text("play", exact=True).first.click()
    scene.until(lambda: not np.array_equal(scene.pixels(), still), "it moves again")


def test_the_load_is_a_ball_as_heavy_as_estimated_inside_the_true_one(chrome, tmp_path):
    """Half of the mass has 0.79 of the radius, 0.63 of the pixels; wires and colour tell them apart."""
    scene = Scene(chrome, ea.view(loaded(), html=tmp_path / "run.html").url)
    scene.seek(0.2)
    half = scene.drawn_by("load")
    scene.seek(1.9)
    whole, wires = scene.drawn_by("load"), scene.drawn_by("true load")
    assert np.mean(whole[:, 1] > whole[:, 0] + 20) > 0.5, "green, apart from the wires in front"
    assert wires.mean() < 120, "dark"
    assert 0.5 < len(half) / len(whole) < 0.76, "edges of pixels and the hand in front leave a tolerance"


@pytest.mark.parametrize("name", ARMS)
def test_the_live_view_follows_the_arm(chrome, name):
    """What is shown is drawn; the page asks only the loopback interface, and complains of nothing."""
    robot = ea.Robot.load(name)
    home, target = robot.configuration(robot.home), robot.configuration(robot.target)
    with ea.view(robot, live=True) as live:
        scene = Scene(chrome, live.url)
        live.show(0.0, home, target)
        scene.until(lambda: len(scene.requests) == 2, "the page and its stream")
        time.sleep(1.0)
        first = scene.settled()
        assert len(scene.drawn_by("robot")) > 2000
        ghost = scene.drawn_by("set-point")
        assert np.mean(ghost[:, 0] > ghost[:, 2] + 20) > 0.9
        for step in range(60):
            share = min(1.0, step / 40)
            live.show(0.01 * step, robot.integrate(home, share * robot.difference(home, target)), target)
            time.sleep(0.03)
        scene.until(lambda: np.sum(np.abs(scene.pixels() - first).max(axis=2) > 12) > 500, "the arm moves")
        scene.show("set-point", False)
        path = scene.drawn_by("tool path")
        assert len(path) > 20
        assert np.mean(path[:, 2] > path[:, 0] + 20) > 0.8
        assert scene.foreign() == []
        assert all("127.0.0.1" in url for url in scene.requests)
        assert scene.errors == []
        scene.page.close()


def test_a_page_of_somebody_else_cannot_read_the_live_view(chrome):
    """The stream is for the view's own page: another origin is refused by the server."""
    robot = ea.Robot.load("two_link")
    with ea.view(robot, live=True) as live, contextlib.closing(ea.view(loaded())) as other:
        tab = Tab(chrome, other.url)  # same computer, another origin; its policy would refuse as well
        refused = chrome.new_page()
        refused.goto("data:text/html,<p>elsewhere</p>")
        script = """url => new Promise(done => { const s = new WebSocket(url);
            s.onopen = () => done("open"); s.onerror = () => done("refused"); })"""
        assert refused.evaluate(script, live.url.replace("http", "ws") + "stream") == "refused"
        tab.page.close()
        refused.close()


def test_the_first_picture_after_the_server_is_told_nothing_is_the_home_posture(chrome):
    robot = ea.Robot.load("two_link")
    with ea.view(robot, live=True) as live:
        scene = Scene(chrome, live.url)
        assert len(scene.drawn_by("robot")) > 2000
        with pytest.raises(ArgumentError, match=r"expected shape \(2,\)"):
            live.show(0.0, np.zeros(3))
        scene.page.close()
