"""Plots show what the record holds, completely and legibly."""

import dataclasses
import itertools

import matplotlib.colors
import matplotlib.image
import matplotlib.pyplot
import numpy as np
import pytest

import eladapt as ea
from eladapt.display.curves import COLOURS, MOST_POINTS
from eladapt.errors import ArgumentError

LONG = "2.83 (my(panda_joint2) - mz(panda_joint3) + 0.823 my(panda_joint4) + 0.823 mz(panda_joint5) + ...)"


def panels(figure):
    return {axes.get_title(loc="left"): axes for axes in figure.axes}


@pytest.mark.parametrize(("suffix", "head"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_the_suffix_decides_the_format(record_of, tmp_path, suffix, head):
    path = tmp_path / f"run.{suffix}"
    ea.plot(record_of("two_link"), path)
    assert path.read_bytes().startswith(head)
    assert list(tmp_path.iterdir()) == [path], "no temporary file is left"


@pytest.mark.parametrize("count", [1, 3])
def test_twelve_parameters_and_seven_joints_are_drawn_with_nothing_cut_off(record_of, tmp_path, count):
    record = record_of("panda", n_parameters=12, parameter_labels=(LONG,) * 12)
    figure = ea.plot([record] * count, tmp_path / "run.png")
    picture = matplotlib.image.imread(tmp_path / "run.png")[..., :3]
    edge = np.concatenate([picture[[0, 1, -2, -1]].ravel(), picture[:, [0, 1, -2, -1]].ravel()])
    assert (edge == 1).all(), "something reaches over the edge of the figure"
    for colour in COLOURS:
        near = np.abs(picture - matplotlib.colors.to_rgb(colour)).max(axis=-1) < 0.02
        assert near.sum() > 50, f"nothing is drawn in {colour}"
    for legend in figure.legends:
        box = legend.get_window_extent().transformed(figure.dpi_scale_trans.inverted())
        assert box.x1 < figure.get_figwidth(), "a legend is wider than the figure"


def test_curves_are_the_records_values_and_dashed_lines_the_true_parameters(record_of):
    record = record_of("two_link", 0.5)
    drawn = panels(ea.plot(record))
    for title, values in (("position error", record.error), ("velocity", record.v), ("torque", record.tau)):
        for line, column in zip(drawn[title].lines, values.T, strict=False):
            np.testing.assert_array_equal(line.get_ydata(), column)
    estimates = drawn["estimates, true values dashed"].lines
    np.testing.assert_array_equal(estimates[0].get_ydata(), record.theta[:, 0])
    levels = [line.get_ydata()[0] for line in estimates if line.get_linestyle() == "--"]
    np.testing.assert_array_equal(levels, record.theta_true)


def test_records_side_by_side_have_common_axes_that_hold_every_curve(record_of):
    small = record_of("two_link")
    large = dataclasses.replace(small, tau=9 * small.tau, parameters=9 * small.parameters, v=9 * small.v)
    for pair in ([small, large], [large, small]):
        axes = ea.plot(pair).axes
        for left, right in zip(axes[::2], axes[1::2], strict=True):
            assert left.get_ylim() == right.get_ylim()
            for line in [*left.lines, *right.lines]:
                if len(line.get_ydata()) > 2:
                    least = line.get_ydata().min()  # below 1e-12 a curve leaves a logarithmic axis
                    assert left.get_ylim()[0] <= (max(least, 1e-12) if left.get_yscale() == "log" else least)
                    assert left.get_ylim()[1] >= line.get_ydata().max()


def test_the_settling_time_is_marked(record_of):
    record = record_of("two_link")
    lines = panels(ea.plot(record))["size of the position error"].lines
    assert any(set(line.get_xdata()) == {record.settling_time()} for line in lines)


def test_torque_from_outside_has_a_panel_where_it_was_felt(record_of):
    """Its curves are the record's; what is small beside the arm's own torque is noise and has none."""
    record = record_of("two_link")
    pushed = dataclasses.replace(record, external=0.5 * record.tau[::-1])
    noisy = dataclasses.replace(record, external=0.01 * record.tau[::-1])
    drawn = panels(ea.plot(pushed))["torque from outside"].lines
    for line, column in zip(drawn, pushed.external.T, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), column)
    for quiet in (record, noisy):
        assert "torque from outside" not in panels(ea.plot(quiet))
    beside = [axes for axes in ea.plot([pushed, record]).axes if axes.texts]
    assert "not recorded" in {text.get_text() for axes in beside for text in axes.texts}


def test_a_fault_is_a_line_through_all_panels_with_its_name_at_the_first(record_of):
    """In the record that has it; the axes stay those of the runs."""
    record = record_of("two_link")
    faulty = dataclasses.replace(record, faults=(ea.Fault("velocity", 0.25, "too fast"),))
    for axes in ea.plot(faulty).axes:
        assert any(set(line.get_xdata()) == {0.25} for line in axes.lines)
    first = panels(ea.plot(faulty))["position error"]
    assert [text.get_text() for text in first.texts] == ["velocity, 0.25 s"]
    whole = ea.plot([faulty, record]).axes
    for with_it, without in zip(whole[::2], whole[1::2], strict=True):
        assert len(with_it.lines) == len(without.lines) + 1


def test_records_of_different_lengths_are_drawn_whole(record_of):
    """In either order."""
    short, long = record_of("two_link", 0.5), record_of("two_link", 1.0)
    for pair in ([short, long], [long, short]):
        assert {axes.get_xlim() for axes in ea.plot(pair).axes} == {(0.0, 1.0)}


def test_limits_are_drawn_when_the_torque_comes_near(record_of):
    near = record_of("two_link", effort_limit=np.array([1.0, np.inf]))
    far = record_of("two_link", effort_limit=np.array([1e4, np.inf]))
    assert len(panels(ea.plot(near))["torque"].lines) == 2 + 1
    assert len(panels(ea.plot(far))["torque"].lines) == 2


def test_only_the_limits_of_joints_that_come_near_their_own_are_drawn(record_of):
    """A fast joint draws its own limit and no slower joint's, and the axis holds it."""
    record = record_of("two_link")
    record.v[:] = [1.0, 0.1]
    record = dataclasses.replace(record, velocity_limit=np.array([1.9, 0.9]))
    axes = panels(ea.plot(record))["velocity"]
    levels = [line.get_ydata()[0] for line in axes.lines[2:]]
    assert levels == [1.9]
    assert axes.get_ylim()[1] > 1.9


def test_limits_close_to_each_other_share_a_label(record_of):
    """Two lines, and one text that names both joints; limits that are far apart have a text each."""
    record = record_of("two_link")
    record.v[:] = 1.0
    for limits, said in (
        ([1.9, 1.92], ["limit of shoulder, elbow"]),
        ([1.0, 1.9], ["limit of shoulder", "limit of elbow"]),
    ):
        axes = panels(ea.plot(dataclasses.replace(record, velocity_limit=np.array(limits))))["velocity"]
        assert [line.get_ydata()[0] for line in axes.lines[2:]] == limits
        assert [text.get_text() for text in axes.texts] == said


def test_a_law_without_gates_shows_what_is_known_of_gravity(record_of):
    """The eigenvalues over time stand where Delta and the gates would."""
    record = record_of("two_link", delta=None, zeta=None, zeta_integral=None)
    known = np.column_stack([np.linspace(0, 1, 31), np.linspace(0, 0.9, 31), np.linspace(0, 0.2, 31)])
    drawn = panels(ea.plot(dataclasses.replace(record, excitation=known)))
    assert not any("zeta" in title or "Delta" in title for title in drawn)
    title = "known of gravity, a line for each of 2 directions"
    lines = drawn[title].lines
    assert len({line.get_color() for line in lines}) == 1, "a direction has no name that a colour could mean"
    for line, column in zip(lines, known[:, 1:].T, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), column)
    assert title not in panels(ea.plot(record))


def test_a_goal_that_moves_is_drawn_dashed(record_of):
    record = record_of("two_link")
    moving = dataclasses.replace(record, goal_velocity=0.1 + 0 * record.v)
    drawn = panels(ea.plot(moving))
    dashed = [line.get_ydata() for line in drawn["position, goal dashed"].lines[2:]]
    np.testing.assert_array_equal(dashed, moving.goal.T)
    dashed = [line.get_ydata() for line in drawn["velocity, goal dashed"].lines[2:]]
    np.testing.assert_array_equal(dashed, moving.goal_velocity.T)
    continuous = record_of("kinova")
    continuous = dataclasses.replace(continuous, goal_velocity=0.1 + 0 * continuous.v)
    assert "position, goal dashed" not in panels(ea.plot(continuous)), "cosines are no angles"


def test_a_long_record_is_thinned_and_keeps_its_spikes(record_of):
    record = record_of("two_link", 20.0)
    record.tau[12345, 0] = 777.0
    line = panels(ea.plot(record))["torque"].lines[0]
    assert len(line.get_ydata()) <= MOST_POINTS + 2
    assert line.get_ydata().max() == 777.0


def test_a_controller_without_estimates_gets_the_panels_of_the_motion(record_of):
    record = record_of("two_link", n_parameters=0, parameters_true=None)
    assert len(panels(ea.plot(record))) == 4


def test_unknown_true_values_and_diverged_samples_are_drawn(record_of, tmp_path):
    record = record_of("two_link", parameters_true=None)
    record.error[-100:] = np.nan
    record.theta[-100:] = np.nan
    drawn = panels(ea.plot(record, tmp_path / "run.png"))
    assert "size of the estimates' errors" not in drawn
    assert "estimates" in drawn, "no true values are promised"


def test_a_legend_is_read_line_by_line(record_of):
    """Seven joints whose names take more than one line of it."""
    names = tuple(f"joint with a name as long as many are {number}" for number in range(1, 8))
    figure = ea.plot(record_of("panda", joint_names=names))
    figure.draw_without_rendering()
    places = {}
    for text in figure.legends[0].get_texts():
        box = text.get_window_extent()
        places[text.get_text()] = (-round(box.y0), round(box.x0))
    assert len({row for row, _ in places.values()}) > 1
    assert sorted(names, key=places.__getitem__) == list(names)


def test_a_title_is_text_and_no_formula(record_of, tmp_path):
    ea.plot(record_of("two_link", title=r"costs $5_{ and \frac$"), tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 10_000


def test_pyplot_holds_no_figure_afterwards(record_of):
    before = matplotlib.pyplot.get_fignums()
    ea.plot(record_of("two_link"))
    assert matplotlib.pyplot.get_fignums() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (lambda r, folder: (r, folder / "run.bmp"), r"\.png, \.pdf, \.svg"),
        (lambda r, folder: (r, folder / "run"), r"\.png, \.pdf, \.svg"),
        (lambda r, folder: ([],), "at least one"),
        (lambda r, folder: ("run.npz",), "expected a Record"),
    ],
)
def test_what_cannot_be_drawn_is_refused(record_of, tmp_path, arguments, message):
    with pytest.raises(ea.EladaptError, match=message):
        ea.plot(*arguments(record_of("two_link"), tmp_path))
    assert not list(tmp_path.iterdir())


def test_a_figure_for_a_paper_is_as_wide_as_a_column_and_made_of_lines(record_of, tmp_path):
    """Letters that can be searched, no picture of pixels, and curves that differ without their colours."""
    record = record_of("panda", n_parameters=12)
    figure = ea.plot(record, tmp_path / "run.pdf", style="paper", panels=["error", "torque"])
    assert figure.get_figwidth() == 3.45  # in: a column of IEEE's journals has 3.5
    assert list(panels(figure)) == ["position error", "torque"], "these, in this order"
    pdf = (tmp_path / "run.pdf").read_bytes()
    assert b"/Subtype /Image" not in pdf
    assert b"/Type3" not in pdf, "such letters are refused by many journals"
    assert b"STIX" in pdf
    for axes in figure.axes:
        assert len({line.get_marker() for line in axes.lines}) == 7, "seven joints that differ in grey"


def test_what_is_written_into_a_panel_is_on_no_curve(record_of):
    """The time of arrival and the limits, whose corners are compared with every curve."""
    record = record_of("panda")
    record.v[:] = np.linspace(-1, 1, 7) * np.sin(6 * record.t)[:, None]
    limits = np.full(7, np.inf)
    limits[[0, 6]] = 1.3, 1.5
    figure = ea.plot(dataclasses.replace(record, velocity_limit=limits))
    figure.draw_without_rendering()
    drawn, written = panels(figure), 0
    for title in ("size of the position error", "velocity"):
        axes = drawn[title]
        for text in axes.texts:
            written += 1
            box = text.get_window_extent()
            for line in axes.lines:
                if len(line.get_xdata()) > 2:
                    points = axes.transData.transform(np.column_stack(line.get_data()))
                    assert not any(box.contains(*point) for point in points), text.get_text()
    assert written == 3


def test_no_name_of_a_limit_is_on_another(record_of):
    """In the narrow panels of a paper, two limits that are near each other, of several joints each."""
    record = record_of("panda")
    record.v[:] = np.linspace(2.0, 2.4, 7) * (np.cos(9 * record.t) * np.exp(-6 * record.t))[:, None]
    limits = np.array([2.2, 2.2, 2.2, 2.2, 2.6, 2.6, 2.6])
    record = dataclasses.replace(record, velocity_limit=limits)
    figure = ea.plot([record, record], style="paper", panels=["velocity", "torque"])
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts if "limit" in text.get_text()]
    assert len(boxes) == 2
    for one, other in itertools.combinations(boxes, 2):
        assert not one.overlaps(other)


def test_what_is_below_rounding_leaves_the_axis(record_of):
    """No curve lies at 1e-12 that is not there: the axis ends, and curves go on below it."""
    record = record_of("two_link")
    axes = panels(ea.plot(record))["size of the position error"]
    assert record.error[-1, 0] == 0
    assert axes.get_ylim()[0] == 1e-12
    assert axes.lines[0].get_ydata()[-1] < 1e-20


def test_estimates_are_named_by_the_link_of_their_largest_term(record_of):
    """All terms on request; a label of one's own stays as it is."""
    labels = ("2.83 (my(elbow) - mz(elbow) + ...)", "3 (mx(shoulder))", "my own")
    record = record_of("two_link", parameter_labels=labels, link_names=("upper", "fore"))
    for full, said in (
        (False, ["1: my(fore), ...", "2: mx(upper)", "3: my own"]),
        (True, [f"{k}: {label}" for k, label in enumerate(labels, 1)]),
    ):
        legend = ea.plot(record, full_names=full).legends[1]
        assert sorted(text.get_text() for text in legend.get_texts()) == said


def test_nothing_is_drawn_where_a_record_has_nothing(record_of):
    """An axis without curves would look like a run at rest; time is below the last panel that is one."""
    bare = record_of("two_link", n_parameters=0, parameters_true=None, delta=None, zeta=None)
    grid = np.array(ea.plot([record_of("two_link"), bare]).axes).reshape(-1, 2)
    shown = [axes.axison for axes in grid[:, 1]]
    assert shown == [True] * 4 + [False] * 4
    assert [axes.get_xlabel() for axes in grid[:, 1] if axes.axison] == [""] * 3 + ["time [s]"]
    assert {text.get_text() for axes in grid[4:, 1] for text in axes.texts} == {
        "nothing is estimated", "not recorded"
    }  # fmt: skip


def test_a_notebook_shows_a_figure(record_of):
    assert ea.plot(record_of("two_link"))._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"style": "papr"}, "unknown style 'papr' .did you mean 'paper'"),
        ({"panels": ["speed"]}, "error, arrival"),
        ({"panels": []}, "panels: expected at least one of error, arrival"),
    ],
)
def test_styles_and_panels_have_names(record_of, options, said):
    with pytest.raises(ea.EladaptError, match=said):
        ea.plot(record_of("two_link"), **options)


def test_labels_are_one_a_record(record_of):
    record = record_of("two_link")
    figure = ea.plot([record, record], labels=["first", "second"])
    texts = {text.get_text() for axes in figure.axes for text in axes.texts}
    assert {"first", "second"} <= texts
    with pytest.raises(ea.EladaptError, match="expected 2"):
        ea.plot([record, record], labels=["first"])


def test_a_motion_is_drawn(tmp_path):
    """Three panels, a curve a joint in each; a name that no figure has is refused."""
    robot = ea.Robot.load("two_link")
    motion = ea.move(robot, robot.configuration(robot.home), robot.configuration(robot.target))
    figure = ea.plot_motion(motion, tmp_path / "motion.png")
    assert [len(axes.lines) for axes in figure.axes] == [2, 2, 2]
    assert (tmp_path / "motion.png").stat().st_size > 10_000
    with pytest.raises(ArgumentError, match=r"\.png"):
        ea.plot_motion(motion, tmp_path / "motion.txt")
