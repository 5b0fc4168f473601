"""The report answers to a click, in a real browser, and asks nobody for anything."""

import numpy as np
import pytest
from browsing import Tab, browser
from display_records import loaded

import eladapt as ea

pytestmark = pytest.mark.slow
ARMS = ("panda", "ur5", "two_link")
TABS = ("Overview", "Learning", "3D", "Gains", "Certificates", "Set-up")
VISIBLE = """name => Bokeh.documents.flatMap(d => [...d._all_models.values()])
    .filter(m => m.type === "GlyphRenderer" && m.name === name).map(m => m.visible)"""
RANGES = """() => Bokeh.documents.flatMap(d => [...d._all_models.values()])
    .filter(m => m.type === "Figure").slice(0, 4).map(m => [m.x_range.start, m.x_range.end])"""


@pytest.fixture(scope="module")
def chrome():
    with browser() as started:
        yield started


def shown(tab, text):
    """The first visible thing that says just that."""
    return tab.page.get_by_text(text, exact=True).locator("visible=true").first


@pytest.mark.parametrize("name", ARMS)
def test_every_tab_opens_and_shows_its_own(chrome, record_of, tmp_path, name):
    tab = Tab(chrome, ea.report(record_of(name, 2.0), tmp_path / "run.html").resolve().as_uri())
    pictures = []
    said = ("Metrics", "base parameter, scaled to the torque it makes", None,
            "These gains were given, not derived.", None, "robot")  # fmt: skip
    for title, holds in zip(TABS, said, strict=True):
        shown(tab, title).click()
        if holds:
            shown(tab, holds).wait_for()
        pictures.append(tab.settled() if title != "3D" else tab.pixels())
    for one in range(len(TABS)):
        for other in range(one):
            assert not np.array_equal(pictures[one], pictures[other]), (TABS[one], TABS[other])
    assert tab.foreign() == []
    assert tab.errors == []
    tab.page.close()


@pytest.mark.parametrize("name", ARMS)
def test_a_click_on_a_name_hides_its_line_and_a_drag_zooms_all_charts(chrome, record_of, tmp_path, name):
    record = record_of(name, 1.0)
    tab = Tab(chrome, ea.report(record, tmp_path / "run.html", animation=False).resolve().as_uri())
    shown(tab, "Metrics").wait_for()
    before = tab.settled()
    joint = record.joint_names[0]
    box = tab.page.locator(".bk-Figure").locator("visible=true").first.bounding_box()
    assert all(tab.page.evaluate(VISIBLE, joint))
    # The legend is drawn, not written: its first entry stands at the top right of the chart.
    tab.page.mouse.click(box["x"] + box["width"] - 90, box["y"] + 44)
    tab.until(lambda: not all(tab.page.evaluate(VISIBLE, joint)), "the line is hidden")
    assert not np.array_equal(tab.settled(), before)
    start = tab.page.evaluate(RANGES)
    left, top = box["x"] + 0.25 * box["width"], box["y"] + 0.4 * box["height"]
    tab.page.mouse.move(left, top)
    tab.page.mouse.down()
    tab.page.mouse.move(left + 60, top + 40, steps=5)
    tab.page.mouse.up()
    tab.until(lambda: tab.page.evaluate(RANGES) != start, "the charts zoom")
    ranges = tab.page.evaluate(RANGES)
    assert all(pair == ranges[0] for pair in ranges), "the charts of a run zoom together in time"
    tab.page.close()


def test_the_motion_is_seen_in_its_tab(chrome, record_of, tmp_path):
    """The frame is hidden when the page opens, so that the viewer starts without a size."""
    tab = Tab(chrome, ea.report(record_of("two_link", 2.0), tmp_path / "run.html").resolve().as_uri())
    shown(tab, "3D").click()
    frame = next(f for f in tab.page.frames if f.url == "about:srcdoc")
    frame.wait_for_function("typeof viewer !== 'undefined' && innerWidth > 600")
    placed = "viewer.camera.position.distanceTo(viewer.controls.target) - camera.distance"
    frame.wait_for_function(f"Math.abs({placed}) < 1e-6")  # rounding
    frame.evaluate("viewer.animator.pause(); viewer.animator.seek(0);")
    with_arm = tab.settled()
    frame.evaluate("viewer.scene_tree.find(['meshcat', 'robot']).object.visible = false; viewer.set_dirty();")
    tab.until(lambda: np.sum(np.abs(tab.pixels() - with_arm).max(axis=2) > 12) > 1000, "an arm was there")
    assert tab.foreign() == []
    assert tab.errors == []
    tab.page.close()


def test_several_records_have_a_tab_each(chrome, record_of, tmp_path):
    page = ea.report([record_of("two_link"), loaded()], tmp_path / "both.html", labels=["bare", "loaded"])
    tab = Tab(chrome, page.resolve().as_uri())
    shown(tab, "loaded").click()
    shown(tab, "Learning").click()
    tab.settled()
    shown(tab, "bare").click()
    shown(tab, "Gains").click()
    shown(tab, "These gains were given, not derived.").wait_for()
    assert tab.foreign() == []
    assert tab.errors == []
    tab.page.close()
