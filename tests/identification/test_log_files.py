"""Logs are read from the files that people have; what a file lacks is said with its line."""

import numpy as np
import pytest
from shared import load

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
    named = {"words": ("elbow", "wrist"), "plotjuggler": ("a", "b")}
    assert log.joint_names == named.get(name, ())


def test_without_a_header_all_positions_come_first(tmp_path):
    rows = numbers()
    log = ea.Log.read(written(tmp_path / "log.txt", rows, delimiter=" "), joint_names=("a", "b"))
    assert np.array_equal(log.tau, rows[:, 5:7])
    assert log.joint_names == ("a", "b")


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
    log = ea.Log.read(written(tmp_path / "log.csv", rows), degrees=True)
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
        f"1 of {N} samples have a number that is none, and were left out",
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


def test_a_file_that_is_not_there_is_said_so(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such log"):
        ea.Log.read(tmp_path / "none.csv")


def test_arrays_are_read_by_their_usual_names(tmp_path):
    rows = numbers()
    np.savez(tmp_path / "a.npz", time=rows[:, 0], position=rows[:, 1:3], effort=rows[:, 5:7])
    log = ea.Log.read(tmp_path / "a.npz")
    assert np.array_equal(log.tau, rows[:, 5:7])
    np.savez(tmp_path / "b.npz", t=rows[:, 0], tau=rows[:, 5:7])
    with pytest.raises(LogError, match=r"lacks q \(q or pos or position\); it has t, tau"):
        ea.Log.read(tmp_path / "b.npz")
    (tmp_path / "c.npz").write_bytes(b"PK" + 100 * b"\0")
    with pytest.raises(LogError, match=r"not an \.npz"):
        ea.Log.read(tmp_path / "c.npz")


def test_a_record_is_a_log(tmp_path):
    robot = load("two_link")
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(
        ea.CompositeController.for_robot(robot),
        plant,
        robot.configuration(robot.target),
        0.05,
        progress=False,
    )
    record.save(tmp_path / "run.npz")
    log = ea.Log.read(tmp_path / "run.npz")
    assert np.array_equal(log.tau, record.tau[:-1])
    assert log.joint_names == robot.joint_names


def bag(path, messages, topics=("/joint_states",)):
    """A ROS 2 bag of (time, names, position, velocity, effort)."""
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
            message = state(
                header(stamp(nanoseconds // 10**9, nanoseconds % 10**9), ""), list(names),
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
    (tmp_path / "junk.mcap").write_bytes(b"junk")
    with pytest.raises(LogError, match="not a ROS bag"):
        ea.Log.read(tmp_path / "junk.mcap")
