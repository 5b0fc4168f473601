"""In a notebook results are seen: tables, pages and figures, and short texts where there is no notebook."""

import html.parser

import numpy as np
import pytest
from known_logs import known_log
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError

SHORT = 300  # characters of a repr, some three lines


@pytest.fixture(scope="module")
def run():
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    return controller, ea.simulate(controller, plant, goal, 0.3, progress=False, title="a <b>run</b>")


@pytest.fixture(scope="module")
def found():
    return ea.identify(load("two_link"), known_log(load("two_link"), 6.0, dt=4e-3), progress=False)


def balanced(text):
    """Whether every tag that is opened is closed, in order."""
    open_tags = []

    class Reader(html.parser.HTMLParser):
        def handle_starttag(self, tag, attributes):
            open_tags.append(tag)

        def handle_endtag(self, tag):
            assert open_tags.pop() == tag

    Reader().feed(text)
    return not open_tags


def shown_of(run, found):
    controller, record = run
    certificate = ea.certify(controller, samples=5)
    load_seen = ea.carried(controller, record.final_state)
    friction = ea.friction(controller, record.final_state)
    return {
        "record": (record, f"{record.metrics().steady_error:.3g}"),
        "gains": (controller.gains, "1.5 P^(3/4)"),
        "limits": (ea.MotionLimits.for_robot(controller.robot), "velocity"),
        "identified": (found, "Torque error on the last 30%"),
        "payload": (load_seen, "mass [kg]"),
        "friction": (friction, "Coulomb [N m]"),
        "certificate": (certificate, "conditions do not hold"),
    }


def test_results_are_tables_and_short_texts(run, found):
    for name, (result, said) in shown_of(run, found).items():
        text = result._repr_html_()
        assert said in text, name
        assert "<table>" in text
        assert balanced(text), name
        assert len(repr(result)) < SHORT, name
    assert "a &lt;b&gt;run&lt;/b&gt;" in run[1]._repr_html_(), "a title cannot become markup"


def test_other_reprs_are_short(run):
    controller, record = run
    robot = controller.robot
    state = record.final_state
    gated = ea.GatedController.for_robot(controller)
    shaped = ea.Shaped(gated)
    first = state.measurement
    compared = ea.SlotineLi.for_robot(robot), ea.TerminalSliding.for_robot(robot)
    others = (
        robot, load("panda"), controller, gated, shaped, gated.gate, *compared, state, gated.init(first),
        shaped.init(first), *(one.init(first) for one in compared), state.information, state.change,
        controller.law, controller.regressors, controller.regressors.basis, controller.mixed(state),
    )  # fmt: skip
    for one in others:
        assert len(repr(one)) < SHORT, type(one).__name__


def framed(result):
    """The page in the frame that a notebook shows."""
    pages = []

    class Reader(html.parser.HTMLParser):
        def handle_starttag(self, tag, attributes):
            given = dict(attributes)
            assert (tag, given["sandbox"]) == ("iframe", "allow-scripts"), "without access to the notebook"
            pages.append(given["srcdoc"])

    Reader().feed(result._repr_html_())
    return pages[0]


def test_pages_are_shown_in_frames(run, found, tmp_path):
    """A view, by a server or in a file, and reports without a file: the page that they are, to the letter."""
    _, record = run
    with_file = ea.view(record, html=tmp_path / "view.html")
    assert framed(with_file) == with_file.path.read_text("utf-8")
    served = ea.view(record)
    served.close()
    assert framed(served) == with_file.path.read_text("utf-8")
    page = ea.report(record, animation=False)
    assert framed(page) == page.text
    assert "two_link, from its log" in framed(found.report())
    assert found.report(tmp_path / "found.html") == tmp_path / "found.html"
    assert page.save(tmp_path / "page.html").read_text("utf-8") == page.text
    assert len(repr(page)) < SHORT
    with pytest.raises(ArgumentError, match=r"\.html"):
        page.save(tmp_path / "page.pdf")


def test_what_is_not_told_is_said(run):
    controller, record = run
    unseen = ea.carried(controller, record.final_state)._replace(mass=np.nan, mass_std=np.inf)
    assert "not told" in unseen._repr_html_()
