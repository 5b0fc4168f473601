"""A log is what a recording tells, by documented rules, and says what it lacked."""

import dataclasses
import re

import numpy as np
import pytest
from known_logs import short_run
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError, UnknownNameError
from eladapt.identification.rows import rows_of


def table(n=200, joints=2, dt=0.01):
    t = dt * np.arange(n)
    x = np.sin(np.outer(t, np.arange(1, joints + 1)))
    return t, x, np.cos(np.outer(t, np.arange(1, joints + 1))) * np.arange(1, joints + 1), 2 * x


def test_samples_that_are_none_or_repeated_are_left_out_and_said_so():
    t, q, v, tau = table()
    q[7, 1], tau[9, 0], t[20] = np.nan, np.inf, t[19]
    log = ea.Log(t, q, v, tau)
    assert len(log) == 197
    assert set(np.arange(200)) - set(np.round(log.t / 0.01).astype(int)) == {7, 9, 20}
    assert log.notes == (
        "2 of 200 samples have a number that is none (q of joint 2, tau of joint 1), and were left out",
        "1 samples repeat the stamp of the one before, and were left out",
    )


def test_a_column_without_a_number_is_named_and_velocities_without_one_are_missing():
    t, q, v, tau = table()
    log = ea.Log(t, q, np.full_like(v, np.nan), tau)
    assert np.array_equal(log.v, ea.Log(t, q, None, tau).v)
    tau[:, 1] = np.nan
    with pytest.raises(ArgumentError, match=r"200 of 200 samples have a number that is none \(tau of b\)"):
        ea.Log(t, q, v, tau, ("a", "b"))


def test_a_clock_that_goes_back_is_refused_with_the_sample():
    t, q, v, tau = table()
    t[50:] -= 0.3
    with pytest.raises(ArgumentError, match=r"sample 50 is at 0\.2 s and the one before it at 0\.49 s"):
        ea.Log(t, q, v, tau)


def test_a_gap_ends_a_piece():
    t, q, v, tau = table()
    t[100:] += 0.2
    assert ea.Log(t, q, v, tau).segments == [slice(0, 100), slice(100, 200)]


def test_missing_velocities_are_the_derivative_and_said_so():
    """Of a sine of 1 rad/s: the polynomial through 60 ms leaves w^3 (0.03 s)^2 / 10 of it, the ends more."""
    t, q, v, tau = table(joints=1)
    t[100:] += 0.5  # each piece for itself
    q[100:, 0], v[100:, 0] = np.sin(t[100:]), np.cos(t[100:])
    log = ea.Log(t, q, None, tau)
    assert np.abs(log.v - v).max() < 1e-3
    assert any("derivative" in note for note in log.notes)


def test_a_position_within_one_turn_goes_on(tmp_path):
    """Of a joint at 6 rad/s, within (-pi, pi], in two pieces: a straight line in each, and its derivative."""
    t, q, _, tau = table(joints=2)
    t[100:] += 0.5
    q[:, 0] = np.angle(np.exp(6j * t))
    log = ea.Log(t, q, None, tau)
    for piece in log.segments:
        assert np.diff(log.q[piece, 0]) == pytest.approx(6 * np.diff(t[piece]), abs=1e-12)
    assert log.v[:, 0] == pytest.approx(np.full(200, 6.0), abs=1e-6)  # interpolated on an even grid
    assert np.array_equal(log.q[:, 1], q[:, 1])
    assert log.notes[0] == "positions of joint 1 jump by a turn from one sample to the next, and go on"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"q": np.zeros((200, 3))}, "tau: expected 200 samples of 3 joints"),
        ({"t": np.zeros((200, 1))}, r"t: expected an array \(N,\)"),
        ({"tau": [["a"]]}, "tau: expected numbers"),
        ({"joint_names": ("a",)}, "joint_names: expected 2 different names"),
        ({"joint_names": ("a", "a")}, "joint_names: expected 2 different names"),
        (
            {name: array[:5] for name, array in zip(("t", "q", "v", "tau"), table(), strict=True)},
            "at least 10",
        ),
    ],
)
def test_what_is_no_log_is_refused(change, said):
    given = dict(zip(("t", "q", "v", "tau"), table(), strict=True)) | change
    with pytest.raises(ArgumentError, match=said):
        ea.Log(**given)


def test_joints_are_found_by_name_in_any_order():
    robot = load("ur5")
    t, q, v, tau = table(joints=8)
    names = ("gripper", *robot.joint_names[::-1], "another")
    log = ea.Log(t, q, v, tau, names).of(robot)
    assert log.joint_names == robot.joint_names
    assert np.array_equal(log.q, q[:, 6:0:-1])
    assert np.array_equal(log.velocity, v[:, 6:0:-1])
    assert np.array_equal(log.tau, tau[:, 6:0:-1])


def test_a_joint_that_the_log_lacks_is_named():
    robot = load("ur5")
    t, q, v, tau = table(joints=6)
    with pytest.raises(UnknownNameError, match=f"unknown joint of the log '{robot.joint_names[2]}'") as said:
        ea.Log(t, q, v, tau, [*robot.joint_names[:2], "elbow?", *robot.joint_names[3:]]).of(robot)
    assert str(said.value).endswith("in their order: joint_names= (--joint)"), "what to do"
    with pytest.raises(ArgumentError, match=r"expected 6 joints.*got 2"):
        ea.Log(*table()).of(robot)


SLIDER = """<robot name="slider"><link name="base"/><link name="arm">{0}</link><link name="slide">{0}</link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="50" velocity="3"/></joint>
<joint name="push" type="prismatic"><parent link="arm"/><child link="slide"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.5" effort="80" velocity="0.4"/></joint></robot>""".format(
    '<inertial><mass value="2"/><origin xyz="0.1 0 0.2"/>'
    '<inertia ixx="0.03" iyy="0.04" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>'
)  # fmt: skip


@pytest.fixture
def slider(tmp_path):
    """An arm of which one joint turns and one slides."""
    (tmp_path / "slider.urdf").write_text(SLIDER)
    return ea.Robot.from_urdf(tmp_path / "slider.urdf")


def test_degrees_are_of_joints_that_turn(slider, tmp_path):
    """Metres stay metres; a turn is 360 where positions jump by one; a plot says which unit it has."""
    t, q, v, tau = table(joints=2)
    jumping = np.rad2deg(np.unwrap(np.angle(np.exp(1j * (q[:, 0] + 5 * t)))))
    given = np.column_stack([(jumping + 180) % 360 - 180, q[:, 1]])
    log = ea.Log(t, given, np.column_stack([np.rad2deg(v[:, 0] + 5), v[:, 1]]), tau, ("turn", "push"),
                 degrees=True)  # fmt: skip
    assert "position [degrees]" in [axes.get_title(loc="left") for axes in log.plot().axes]
    known = log.of(slider)
    assert not known.degrees
    whole = np.unwrap(np.angle(np.exp(1j * (q[:, 0] + 5 * t))))
    assert known.q[:, 0] == pytest.approx(whole, abs=1e-12)  # radians of some turns, rounded
    assert known.velocity[:, 0] == pytest.approx(v[:, 0] + 5, rel=1e-15)
    assert np.array_equal(known.q[:, 1], q[:, 1])
    assert np.array_equal(known.velocity[:, 1], v[:, 1])
    assert known.of(slider).q[:, 0] == pytest.approx(whole, abs=1e-12), "once is enough"


def test_remarks_have_the_unit_of_the_joint(slider):
    """A slide is fast in m/s and strong in N, and is never asked about degrees."""
    t = np.linspace(0, 4, 401)
    q = np.column_stack([np.sin(t), 20 * np.sin(t)])
    v = np.column_stack([np.cos(t), 20 * np.cos(t)])
    said = ea.Log(t, q, v, np.column_stack([np.cos(t), 900 * np.cos(t)]), ("turn", "push")).check(slider)
    assert "push reaches 20 m/s; its limit is 0.4" in said
    assert any(text.startswith("push: its torque reaches 900 N, beyond") for text in said)
    assert any(
        text.startswith("push goes from -15.14 to 20, beyond") and "degrees" not in text for text in said
    )
    wrong = ea.Log(t, q, np.rad2deg(v), np.ones((401, 2)), ("turn", "push")).check(slider)
    assert any(re.search(r"turn: .* times the derivative .*; degrees\?", text) for text in wrong)
    assert not any(re.search(r"push: .* degrees", text) for text in wrong)


def test_the_last_part_is_held_out():
    first, last = ea.Log(*table()).parts(0.3)
    assert last.t[0] == pytest.approx(0.7 * 1.99, abs=0.01)
    assert len(first) + len(last) == 200
    assert ea.Log(*table()).parts(0)[1] is None
    with pytest.raises(ArgumentError, match="would part its 30 samples into 21 and 9; each needs 10"):
        ea.Log(*table(30)).parts(0.3)


def test_a_records_torques_act_until_the_next_sample():
    """So the log's torques are those that made its motion: the true parameters explain them, and not a
    sample later or earlier."""
    record = short_run()
    log = ea.Log.from_record(record)
    regressors = ea.Regressors(load("two_link"))

    def unexplained(log):
        rows = rows_of(log, regressors, window=0.01, stiction_speed=1e-4)
        return np.abs(rows.y - rows.omega @ regressors.theta).max() / np.abs(rows.y).max()

    assert unexplained(log) < 1e-4  # what the acceleration does within a step of 1 ms
    for shift in (-1, 1):
        assert unexplained(dataclasses.replace(log, tau=np.roll(log.tau, shift, axis=0))) > 1e-2
    assert np.array_equal(log.t, record.t[1:])
    assert np.array_equal(log.q, record.q[1:])


def test_continuous_joints_of_a_record_go_on_beyond_a_turn():
    robot = load("kinova")  # whose fourth joint is at -2.1 rad
    goal = robot.home.copy()
    goal[3] -= 2.5
    motion = ea.move(robot, robot.configuration(robot.home), robot.configuration(goal))
    plant = ea.PinocchioPlant(robot, motion.q0)
    record = ea.simulate(
        ea.CompositeController.for_robot(robot), plant, motion, motion.duration, progress=False
    )
    log = ea.Log.from_record(record)
    assert np.abs(np.diff(log.q, axis=0)).max() < 0.1
    assert log.q[-1, 3] < -np.pi


def test_a_plot_of_a_log_has_its_gaps(tmp_path):
    t, q, v, tau = table()
    t[100:] += 0.5
    figure = ea.Log(t, q, v, tau).plot(tmp_path / "log.png")
    assert (tmp_path / "log.png").stat().st_size > 0
    drawn = figure.axes[0].lines[0].get_ydata()
    assert np.isnan(drawn).sum() == 1
    assert len(figure.axes) == 3
