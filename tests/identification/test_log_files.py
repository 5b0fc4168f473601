"""Logs are read from the files that people have; what a file lacks is said with its line."""

import numpy as np
import pytest
from known_logs import short_run

import eladapt as ea
from eladapt.errors import LogError

N = 40


def numbers(joints=2):
    rng = np.random.default_rng(0)
    return np.column_stack([0.01 * np.arange(N), rng.normal(size=(N, 3 * joints))])


def written(path, rows, header="", delimiter=",", end=""):
    lines = [header] if header else []
    lines += [delimiter.join(repr(float(x)) for x in row) for row in rows]
    path.write_text("\n".join(lines) + "\n" + end)
    return path


HEADERS = {
    "plain": "t,q0,q1,dq0,dq1,tau0,tau1",
    "words": "time,position_elbow,position_wrist,velocity_elbow,velocity_wrist,effort_elbow,effort_wrist",
    "plotjuggler": "__time," + ",".join(
        f"/joint_states/{joint}/{kind}" for kind in ("position", "velocity", "effort") for joint in ("a", "b")
    ),
    "brackets": "t,q[0],q[1],qd[0],qd[1],tau[0],tau[1]",
    "namespace": "/r/joint_states/header/stamp," + ",".join(
        f"/r/joint_states/joint_{joint}/{kind}" for kind in ("pos", "vel", "effort") for joint in ("a", "b")
    ),
    "rostopic": "%time," + ",".join(
        f"field.{kind}{joint}" for kind in ("position", "velocity", "effort") for joint in range(2)
    ),
    "rtde": "timestamp actual_q_0 actual_q_1 actual_qd_0 actual_qd_1 actual_torque_0 actual_torque_1",
}  # fmt: skip


@pytest.mark.parametrize("name", HEADERS)
@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_headers_and_delimiters_are_found(tmp_path, name, delimiter):
    rows = numbers()
    header = HEADERS[name].replace(",", " ").replace(" ", delimiter)
    log = ea.Log.read(written(tmp_path / "log.csv", rows, header, delimiter))
    assert np.array_equal(log.t, rows[:, 0])
    assert np.array_equal(log.q, rows[:, 1:3])
    assert np.array_equal(log.velocity, rows[:, 3:5])
    assert np.array_equal(log.tau, rows[:, 5:7])
    named = {"words": ("elbow", "wrist"), "plotjuggler": ("a", "b"), "namespace": ("joint_a", "joint_b")}
    assert log.joint_names == named.get(name, ())


def test_without_a_header_all_positions_come_first(tmp_path):
    rows = numbers()
    log = ea.Log.read(written(tmp_path / "log.txt", rows, delimiter=" "), joint_names=("a", "b"))
    assert np.array_equal(log.tau, rows[:, 5:7])
    assert log.joint_names == ("a", "b")


PLAIN = HEADERS["plain"]


def behind(text, name, cell):
    """A table with further columns."""
    header, *lines = text.splitlines()
    return "\n".join([header + name, *(line + cell for line in lines)])


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace(PLAIN, PLAIN.replace(",", ", ")),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace(",", ";").replace(".", ","),
        lambda text: text.replace(",", "\t").replace(".", ","),
        lambda text: text.replace(PLAIN, '"' + PLAIN.replace(",", '","') + '"'),
        lambda text: "# an arm\n# and its log\n" + text.replace("\n", "\n% a pause\n", 3),
        lambda text: "# " + text,
        lambda text: behind(text, ",mode", ',"a, b"'),
        lambda text: behind(text, ",target_q0,q1_cmd", ",1,2"),
    ],
    ids=["blanks", "crlf", "semicolons", "tabs", "quotes", "comments", "hash", "words", "asked"],
)
def test_a_table_in_other_clothes_is_the_same_log(tmp_path, change):
    """No digit changes, and nothing is left out."""
    path = written(tmp_path / "log.csv", numbers(), PLAIN)
    right = ea.Log.read(path)
    path.write_bytes(change(path.read_text()).encode())
    log = ea.Log.read(path)
    assert log.notes == ()
    for part in ("t", "q", "v", "tau"):
        assert np.array_equal(getattr(log, part), getattr(right, part))


def test_units_below_a_header_are_left_out_and_said(tmp_path):
    path = written(tmp_path / "log.csv", numbers(), PLAIN + "\n[s],[deg],[deg],[deg/s],[deg/s],[Nm],[Nm]")
    log = ea.Log.read(path)
    assert len(log) == N
    assert log.notes == (
        "line 2 below the header is no sample, and was left out: [s],[deg],[deg],[deg/s],[deg/s],[Nm],[Nm",
    )


def test_a_table_of_negative_numbers_has_no_names_in_it(tmp_path):
    """19 columns are t and 18 of six joints; as an echoed message they would have four joints."""
    rows = -np.abs(numbers(6))
    rows[:, 0] *= -1
    assert ea.Log.read(written(tmp_path / "log.csv", rows)).q.shape == (N, 6)


def test_numbered_joints_are_in_the_order_of_their_numbers(tmp_path):
    """As a table sorted by name has them, q10 before q2."""
    rows = numbers(3)
    names = [f"{kind}{k}" for kind in ("q", "dq", "tau") for k in (1, 10, 2)]
    log = ea.Log.read(written(tmp_path / "log.csv", rows, ",".join(["t", *names])))
    assert np.array_equal(log.q, rows[:, [1, 3, 2]])
    assert np.array_equal(log.tau, rows[:, [7, 9, 8]])


def test_seconds_and_nanoseconds_are_one_stamp(tmp_path):
    """To the last nanosecond, at an hour in 2023, in which a float of seconds knows 2e-7."""
    rows, nanoseconds = numbers(), 3_000_000 * np.arange(N) + 1
    parts = [[1_700_000_000 + x // 10**9, x % 10**9] for x in nanoseconds]
    stamps = "header.stamp.sec,header.stamp.nanosec"
    table = np.column_stack([parts, rows[:, 1:]])
    log = ea.Log.read(written(tmp_path / "a.csv", table, PLAIN.replace("t,", f"{stamps},", 1)))
    assert np.diff(log.t) == pytest.approx(np.full(N - 1, 3e-3), abs=1e-15)
    echoed = [
        f"{s},{n},base,elbow,wrist," + ",".join(map(repr, map(float, r[1:])))
        for (s, n), r in zip(parts, rows, strict=True)
    ]
    (tmp_path / "b.csv").write_text("\n".join(echoed))  # ros2 topic echo --csv
    log = ea.Log.read(tmp_path / "b.csv")
    assert log.joint_names == ("elbow", "wrist")
    assert np.diff(log.t) == pytest.approx(np.full(N - 1, 3e-3), abs=1e-15)
    assert np.array_equal(log.tau, rows[:, 5:7])


def test_stamps_too_large_for_seconds_are_of_another_unit(tmp_path):
    rows = numbers()
    for unit, name in ((1.0, ""), (1e3, "milli"), (1e6, "micro"), (1e9, "nano")):
        rows[:, 0] = unit * (1.7e9 + 0.01 * np.arange(N))
        log = ea.Log.read(written(tmp_path / "log.csv", rows, PLAIN))
        assert log.t == pytest.approx(0.01 * np.arange(N), abs=1e-6)  # 256 ns: a float of nanoseconds
        assert log.notes == (f"stamps are {name}seconds since 1970, and were counted from the first on",)


def test_a_star_stands_for_the_joint(tmp_path):
    """Columns sorted by name are of one joint where the stars are the same, whatever their order is."""
    rows = numbers()
    header = "clock,position_elbow,position_wrist,rate_wrist,rate_elbow,load_wrist,load_elbow"
    path = written(tmp_path / "log.csv", rows, header)
    columns = {"t": "clock", "q": "position_*", "v": "rate_*", "tau": "load_*"}
    log = ea.Log.read(path, columns=columns)
    assert log.joint_names == ("elbow", "wrist")
    assert np.array_equal(log.velocity, rows[:, [4, 3]])
    assert np.array_equal(log.tau, rows[:, [6, 5]])
    with pytest.raises(LogError, match=r"not of the same joints \(elbow, te_elbow, te_wrist, wrist\)"):
        ea.Log.read(path, columns={**columns, "v": "ra*"})


def test_columns_are_as_the_user_says(tmp_path):
    rows = numbers()
    header = "x,target_q_0,target_q_1,actual_q_0,actual_q_1,i_0,i_1"
    path = written(tmp_path / "log.csv", rows, header)
    columns = {"t": "x", "q": "actual_q_*", "v": ["target_q_0", 2], "current": "i_*"}
    log = ea.Log.read(path, columns=columns, gains=[2.0, 3.0])
    assert np.array_equal(log.q, rows[:, 3:5])
    assert np.array_equal(log.velocity, rows[:, 1:3])
    assert np.array_equal(log.tau, rows[:, 5:7] * [2, 3])
    assert "torques are currents times the gains given" in log.notes


def test_degrees_become_radians(tmp_path):
    rows = numbers()
    log = ea.Log.read(written(tmp_path / "log.csv", rows), degrees=True, joint_names=("shoulder", "elbow"))
    log = log.of(ea.Robot.load("two_link"))
    assert np.allclose(log.q, np.deg2rad(rows[:, 1:3]), rtol=1e-15)
    assert np.allclose(log.velocity, np.deg2rad(rows[:, 3:5]), rtol=1e-15)
    assert np.array_equal(log.tau, rows[:, 5:7])


def test_a_last_line_that_is_cut_and_empty_cells_are_left_out(tmp_path):
    path = written(tmp_path / "log.csv", numbers(), HEADERS["plain"], end="0.4,1.2,")
    path.write_text(path.read_text().replace(repr(float(numbers()[3, 2])), ""))
    log = ea.Log.read(path)
    assert len(log) == N - 1
    assert log.notes == (
        f"line {N + 2}, the last one, is cut short, and was left out",
        f"1 of {N} samples have a number that is none (q of joint 2), and were left out",
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "it is empty"),
        ("t,q0,dq0,tau0\n", "has a header, and no samples"),
        ("t,q0,dq0,tau0\n" + "0,1,2,3\n" * 3 + "0,1,abc,3\n0,1,2,3\n", "line 5: expected numbers, got 'abc'"),
        ("t,q0,dq0,tau0\n" + "0,1,2,3\n" * 3 + "0,1,2\n0,1,2,3\n", "line 5: expected 4 columns"),
        ("0,1,2\n" * 20, r"expected a header, or columns t, q, v, tau \(1 \+ 3 n of them\), got 3"),
        ("t,x,y\n" + "0,1,2\n" * 20, "no column looks like q"),
        ("t,actual_q_0,q0,tau0\n" + "0,1,2,3\n" * 20, "both look like q"),
        ("t,q0,q1,tau0\n" + "0,1,2,3\n" * 20, "columns of q and tau are not of the same joints"),
        ("t,q0,current0\n" + "0,1,2\n" * 20, "there are currents only"),
        ("t,q0\n" + "0,1\n" * 20, "expected torques or currents, found neither"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_table_is_said_with_its_file(tmp_path, text, said):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(LogError, match=said) as caught:
        ea.Log.read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"gains": [1.0, 2.0, 3.0]}, r"gains: expected shape \(2,\), got \(3,\)"),
        ({"columns": "t"}, "columns: expected which they are by quantity"),
        ({"columns": {"t": "t", "q": 1.5}}, "unknown column of q '1.5'"),
        ({"columns": {"t": "t", "x": "q0"}}, "unknown quantity of columns 'x'"),
        ({"topic": "/joint_states"}, r"topic: log\.csv is a table, not a bag"),
    ],
)
def test_options_that_do_not_fit_are_refused(tmp_path, options, said):
    path = written(tmp_path / "log.csv", numbers(), PLAIN)
    with pytest.raises(LogError, match=said):
        ea.Log.read(path, **options)


def test_what_is_no_text_is_refused(tmp_path):
    (tmp_path / "log.mat").write_bytes(b"MATLAB 5.0 MAT-file" + 100 * b"\0")
    with pytest.raises(LogError, match="it is no text; expected a table"):
        ea.Log.read(tmp_path / "log.mat")
    written(tmp_path / "log.csv", numbers(), PLAIN)
    right = ea.Log.read(tmp_path / "log.csv")
    (tmp_path / "wide.txt").write_text((tmp_path / "log.csv").read_text(), encoding="utf-16")
    assert np.array_equal(ea.Log.read(tmp_path / "wide.txt").tau, right.tau)


def test_a_file_that_is_not_there_is_said_so(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such log"):
        ea.Log.read(tmp_path / "none.csv")


def test_arrays_are_read_by_their_usual_names(tmp_path):
    rows = numbers()
    np.savez(tmp_path / "a.npz", time=rows[:, 0], position=rows[:, 1:3], effort=rows[:, 5:7])
    log = ea.Log.read(tmp_path / "a.npz")
    assert np.array_equal(log.tau, rows[:, 5:7])
    np.savez(tmp_path / "b.npz", t=rows[:, 0], tau=rows[:, 5:7])
    with pytest.raises(LogError, match=r"columns: a\.npz is an \.npz, whose arrays have names"):
        ea.Log.read(tmp_path / "a.npz", columns={"t": 0})
    with pytest.raises(LogError, match=r"lacks q \(q or pos or position\); it has t, tau"):
        ea.Log.read(tmp_path / "b.npz")
    (tmp_path / "c.npz").write_bytes(b"PK" + 100 * b"\0")
    with pytest.raises(LogError, match=r"not an \.npz"):
        ea.Log.read(tmp_path / "c.npz")


def test_a_record_is_a_log(tmp_path):
    record = short_run()
    record.save(tmp_path / "run.npz")
    log = ea.Log.read(tmp_path / "run.npz")
    with pytest.raises(LogError, match=r"degrees: run\.npz is a record, in SI units"):
        ea.Log.read(tmp_path / "run.npz", degrees=True)
    assert np.array_equal(log.tau, record.tau[:-1])
    assert log.joint_names == record.joint_names


def bag(path, messages, topics=("/joint_states",), stamped=True):
    """A ROS 2 bag of (time, names, position, velocity, effort); the headers' stamps are 0 without stamped."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    state, stamp, header = (
        store.types[name] for name in (kind, "builtin_interfaces/msg/Time", "std_msgs/msg/Header")
    )
    with Writer(path, version=9) as writer:
        connections = [writer.add_connection(topic, kind, typestore=store) for topic in topics]
        for t, names, *parts in messages:
            nanoseconds = round(1e9 * t)
            at = stamp(*divmod(nanoseconds, 10**9)) if stamped else stamp(0, 0)
            message = state(
                header(at, ""), list(names),
                *(np.array(part, dtype=float) for part in parts),
            )  # fmt: skip
            for connection in connections:
                writer.write(connection, nanoseconds, store.serialize_cdr(message, kind))


def test_a_bag_is_read_by_joint_names(tmp_path):
    rows = numbers()
    arm = [(5 + r[0], ("a", "b"), r[1:3], r[3:5], r[5:7]) for r in rows]
    gripper = [(5.001 + r[0], ("finger",), r[1:2], r[3:4], r[5:6]) for r in rows[:5]]
    bag(tmp_path / "bag", sorted([*arm, *gripper], key=lambda m: m[0]))
    log = ea.Log.read(tmp_path / "bag")
    assert log.joint_names == ("a", "b")
    assert np.allclose(log.t, rows[:, 0], atol=1e-9)  # nanoseconds
    assert np.array_equal(log.tau, rows[:, 5:7])
    assert log.notes == ("5 messages lack some of these joints, and were left out",)
    assert np.array_equal(ea.Log.read(tmp_path / "bag", joint_names=("b", "a")).q, rows[:, [2, 1]])


def test_a_bag_whose_stamps_nobody_set_has_the_times_of_its_recording(tmp_path):
    rows = numbers()
    bag(tmp_path / "bag", [(5 + r[0], ("a", "b"), *r[1:].reshape(3, 2)) for r in rows], stamped=False)
    log = ea.Log.read(tmp_path / "bag")
    assert np.allclose(log.t, rows[:, 0], atol=1e-9)  # nanoseconds
    assert np.array_equal(log.tau, rows[:, 5:7])
    assert log.notes == ("no message has a stamp: times are those at which the bag recorded them",)


def test_a_bag_without_velocities_or_with_several_topics(tmp_path):
    rows = numbers()
    bag(tmp_path / "one", [(r[0], ("a", "b"), r[1:3], [], r[5:7]) for r in rows])
    assert any("derivative" in note for note in ea.Log.read(tmp_path / "one").notes)
    bag(tmp_path / "two", [(r[0], ("a",), r[1:2], r[3:4], r[5:6]) for r in rows], ("/left", "/right"))
    with pytest.raises(LogError, match="/left, /right; say which"):
        ea.Log.read(tmp_path / "two")
    assert len(ea.Log.read(tmp_path / "two", topic="/right")) == N
    bag(tmp_path / "none", [(r[0], ("a",), r[1:2], r[3:4], []) for r in rows])
    with pytest.raises(LogError, match="no effort"):
        ea.Log.read(tmp_path / "none")
    bag(tmp_path / "nameless", [(r[0], (), r[1:3], r[3:5], r[5:7]) for r in rows])
    with pytest.raises(LogError, match="name no joints"):
        ea.Log.read(tmp_path / "nameless")
    (tmp_path / "junk.mcap").write_bytes(b"junk")
    with pytest.raises(LogError, match="not a ROS bag"):
        ea.Log.read(tmp_path / "junk.mcap")
