"""The report is one file that says all there is to a run, and asks nobody for anything."""

import dataclasses
import html.parser
import re

import numpy as np
import pytest
from display_records import loaded

import eladapt as ea
from eladapt.display import charts, tables
from eladapt.errors import ArgumentError
from eladapt.viewing.page import POLICY


@pytest.fixture(scope="module")
def record():
    robot = ea.Robot.load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home), noise=ea.Noise(1e-9, 1e-9), seed=7)
    return ea.simulate(controller, plant, robot.configuration(robot.target), 0.3, progress=False)


def test_the_page_loads_nothing_and_may_not(record, tmp_path):
    text = ea.report(record, tmp_path / "run.html").read_text("utf-8")
    loads, policies = [], []

    class Reader(html.parser.HTMLParser):
        def handle_starttag(self, tag, attributes):
            loads.extend((tag, name) for name, value in attributes if name in ("src", "href") and value)
            policies.extend(value for name, value in attributes if name == "content" and "src" in value)

    Reader().feed(text)
    assert loads == []
    assert policies[0] == POLICY
    assert text.index("Content-Security-Policy") < text.index("<script"), "before any code"


def test_setup_says_robot_plant_seed_and_versions(record):
    text = tables.setup(record)
    for said in ("two_link: 2 joints, shoulder, elbow", "PinocchioPlant", "7 (noise of PinocchioPlant)",
                 "numpy", "301 at steps of 0.001 s", "CompositeController: ForceBalance"):  # fmt: skip
        assert said in text


def test_gains_come_with_the_rule_that_set_each(record):
    text = tables.gains(record)
    for gain in ("P", "D", "D_L", "pole", "Gamma", "Upsilon"):
        assert f"<td>{gain}</td>" in text
    assert "1.5 P^(3/4)" in text


def test_gains_and_bounds_are_found_inside_whatever_stands_around_the_controller(record):
    """A gate and a shaped goal change neither."""
    inner = {**record.configuration["controller"], "law": {"bounds": [2.0] * record.theta.shape[1]}}
    around = {"class": "Shaped", "controller": {"class": "GatedController", "controller": inner, "gate": {}}}
    bare, wrapped = (
        dataclasses.replace(record, configuration={"controller": part}) for part in (inner, around)
    )
    assert "given, not derived" not in tables.gains(wrapped)
    assert tables.gains(wrapped) == tables.gains(bare)
    np.testing.assert_array_equal(charts.bounds_of(wrapped), charts.bounds_of(bare))


def test_a_controller_without_rules_still_shows_its_gains(record):
    made = ea.paper.run("C1", case=1, duration=0.01)
    assert "control.P" in tables.gains(made) or "P</td>" in tables.gains(made)


def test_metrics_are_those_of_the_record(record):
    text, found = tables.metrics([record], ["a <run>"]), record.metrics()
    for value in found[: len(tables.METRICS)]:
        assert f">{'never' if value == np.inf else tables.figure(value)}<" in text
    limits = tables.limits([record], ["a <run>"])
    for said in (found.speed_said, found.range_said, found.faults_said):
        assert f"<td>{tables.html.escape(said)}</td>" in limits
    assert "a &lt;run&gt;" in text, "a title cannot become markup"


def test_what_went_beyond_a_limit_is_said(record_of):
    """Speed, range and fault, with the joint and the time; old records say that they do not know."""
    robot = ea.Robot.load("ur5")
    fault = ea.Fault("velocity", 0.5, "'elbow_joint' at 4 rad/s")
    made = record_of("ur5", velocity_limit=np.full(6, 0.1), lower=robot.home + 0.1, upper=robot.upper,
                     q_index=np.arange(6), faults=(fault,))  # fmt: skip
    text = tables.limits([made], ["fast"])
    for said in ("% of the limit, ", "above it for ", "left by ", "velocity at t = 0.5000 s"):
        assert said in text
    assert tables.limits([record_of("ur5")], ["old"]).count("not recorded") == 2


def test_certificates_are_kept_and_shown(record, tmp_path):
    robot = ea.Robot.load("two_link")
    certificate = ea.certify(ea.CompositeController.for_robot(robot), samples=5)
    text = tables.certificates([tables.plain_certificate(certificate)])
    assert text.count("<tr>") == len(certificate) + 1
    for row in certificate:
        assert tables.html.escape(row.name) in text
    assert "No certificates" in tables.certificates([])
    page = ea.report(record, tmp_path / "run.html", certificates=[certificate], animation=False)
    assert certificate.title in page.read_text("utf-8")


def lines_of(chart):
    return {r.name: (r.data_source.data["t"], r.data_source.data["y"]) for r in chart.renderers}


def test_charts_hold_the_records_values(record):
    """Single precision on the page, so relative 1e-6; the axes of logarithmic ones end at 1e-12."""
    error, arrival, velocity, torque = charts.motion(record)[:4]
    for chart, values in ((error, record.error), (velocity, record.v), (torque, record.tau)):
        for name, column in zip(record.joint_names, values.T, strict=True):
            np.testing.assert_allclose(lines_of(chart)[name][1], column, rtol=1e-6, atol=1e-9)
    assert arrival.y_scale.__class__.__name__ == "LogScale"
    least = min(np.min(y) for _, y in lines_of(arrival).values())
    assert least > 0
    assert least >= 1e-12 or arrival.y_range.start == 1e-12


def test_true_values_step_where_a_load_comes(record):
    """They are drawn as they were: before the load without it, from then on with it."""
    course = np.tile(record.parameters_true, (len(record), 1))
    course[len(record) // 2 :] *= 2
    loaded = dataclasses.replace(record, parameters_true_course=course)
    estimates = charts.learning(loaded)[0]
    assert estimates.title.text == "gravity parameters θ; thin: true values"
    for index, true in enumerate(loaded.theta_true_course.T):
        _, drawn = lines_of(estimates)[f"true θ{index + 1}"]
        assert set(np.unique(drawn)) == set(np.unique(true))


def test_bounds_and_true_values_of_the_estimates_are_drawn(record):
    j = record.theta.shape[1]
    law = {**record.configuration["controller"], "law": {"bounds": [2.0] * j}}
    bounded = ea.Record(**{**vars(record), "configuration": {"controller": law}})
    np.testing.assert_array_equal(charts.bounds_of(bounded), np.tile([-2.0, 2.0], (j, 1)))
    whole = {"law": {"bounds": [[0.0, 9.0]] * 3 + [[-2.0, 2.0]] * j}}
    of_all = ea.Record(**{**vars(record), "configuration": {"controller": {**law, **whole}}})
    np.testing.assert_array_equal(charts.bounds_of(of_all), charts.bounds_of(bounded))
    levels = [span.location for span in charts.learning(bounded)[0].center if hasattr(span, "location")]
    expected = sorted([*record.theta_true, *[2.0] * j, *[-2.0] * j])
    assert sorted(x for x in levels if isinstance(x, float)) == pytest.approx(expected)


def test_torques_are_drawn_against_their_limits(record_of):
    drawn = charts.motion(record_of("panda"))
    shares = [chart for chart in drawn if "share" in chart.title.text]
    assert [chart.title.text.split()[0] for chart in shares] == ["velocity", "torque"]
    for share in shares:
        assert {span.location for span in share.center if hasattr(span, "location")} >= {-1.0, 1.0}
        assert share.y_range.end > 1


def test_torque_from_outside_and_faults_are_on_the_page(record_of):
    """The former as curves where it was felt, the latter as lines in all charts, named in the first title."""
    plain = record_of("two_link")
    made = ea.Record(**{**vars(plain), "external": 0.5 * plain.tau[::-1],
                        "faults": (ea.Fault("velocity", 0.25, "too fast"),)})  # fmt: skip
    motion, learning = charts.motion(made), charts.learning(made)
    outside = next(chart for chart in motion if "outside" in chart.title.text)
    for name, column in zip(made.joint_names, made.external.T, strict=True):
        np.testing.assert_allclose(lines_of(outside)[name][1], column, rtol=1e-6, atol=1e-9)
    for chart in (*motion, *learning):
        assert 0.25 in [span.location for span in chart.center if hasattr(span, "location")]
    assert motion[0].title.text == "position error; red: fault velocity at 0.25 s"
    assert not any("outside" in chart.title.text for chart in charts.motion(plain))


def test_a_load_has_a_chart():
    titles = [chart.title.text for chart in charts.learning(loaded())]
    assert "load, as estimated" in titles


def test_several_records_are_compared(record, record_of, tmp_path):
    other = record_of("panda")
    page = ea.report([record, other], tmp_path / "both.html", labels=["one", "other"], animation=False)
    text = page.read_text("utf-8")
    assert "2 runs" in text
    compared = charts.comparison([record, other], ["one", "other"])
    assert set(lines_of(compared[0])) == {"one", "other"}
    np.testing.assert_allclose(
        lines_of(compared[0])["one"][1], np.maximum(np.abs(record.error).max(axis=1), 1e-30), rtol=1e-6
    )


def test_a_comparison_shows_the_time_of_every_record(record_of):
    """Of records one after the other, in whatever order: from the first one's start to the last one's end."""
    early = record_of("two_link")
    late = record_of("two_link", t=early.t + 10)
    for records in ([early, late], [late, early]):
        x = charts.comparison(records, ["one", "other"])[0].x_range
        assert (x.start, x.end) == (early.t[0], late.t[-1])


@pytest.mark.parametrize("order", [1, -1])
def test_a_comparison_holds_every_line(record_of, order):
    """On a logarithmic axis that ends at rounding: what one record leaves at once another may never reach."""
    far = record_of("two_link")
    far = dataclasses.replace(far, error=100 * np.ones_like(far.error))
    drawn = charts.comparison([record_of("two_link"), far][::order], ["one", "other"])[0]
    assert (drawn.y_range.start, drawn.y_range.end) == (1e-12, 200)


def test_records_of_the_same_title_are_told_apart(record, tmp_path):
    page = ea.report([record, record], tmp_path / "both.html", animation=False)
    assert re.search(rf"{record.title} \(2\)", page.read_text("utf-8"))


def test_a_record_whose_robot_is_gone_is_reported(record_of, tmp_path):
    """An older one, which does not hold its URDF: alone, and beside another, whose page it does not spoil."""
    gone = record_of("two_link", robot_source={"urdf": str(tmp_path / "gone.urdf"), "name": "lost"})
    for shown in (gone, [gone, record_of("two_link")]):
        text = ea.report(shown, tmp_path / "page.html").read_text("utf-8")
        assert "lost: 2 joints, shoulder, elbow" in text
        assert "Not drawn: " in text
        assert "gone.urdf" in text


def test_certificates_that_fail_are_explained():
    """What the conditions are, which of them matter, and what sampling says; nothing where all hold."""
    controller = ea.CompositeController.for_robot(ea.Robot.load("panda"))
    certificate = ea.certify(controller, dt=1e-3, samples=20)
    text = tables.certificates([tables.plain_certificate(certificate)])
    failed = sum(not row.holds for row in certificate)
    assert failed
    for said in (
        f"{failed} of {len(certificate)} conditions do not hold.",
        "sufficient and not necessary",
        "Stability: it is enough that one of the first 3 holds",
        "V_1 &gt; 0 holds all the same",
    ):
        assert said in text
    assert "sampling, not about proofs" not in text, "those hold"
    assert str(certificate).endswith("measured, not proven.")
    rows = [{"name": "a", "value": 0.0, "limit": 1.0, "holds": True, "note": ""}]
    assert "do not hold" not in tables.certificates([{"title": "t", "rows": rows}])


def test_a_run_that_diverged_has_a_report(record_of, tmp_path):
    q = record_of("two_link").q.copy()
    q[501:] = np.nan
    broken = record_of("two_link", q=q, error=np.where(np.isnan(q), np.nan, 0.1))
    ea.report(broken, tmp_path / "run.html")


def test_wrong_arguments_are_named(record, tmp_path):
    with pytest.raises(ArgumentError, match=r"\.html"):
        ea.report(record, tmp_path / "run.pdf")
    with pytest.raises(ArgumentError, match="labels: expected 1"):
        ea.report(record, tmp_path / "run.html", labels=["a", "b"])
    with pytest.raises(ArgumentError, match="records"):
        ea.report([], tmp_path / "run.html")
    assert not list(tmp_path.iterdir())
