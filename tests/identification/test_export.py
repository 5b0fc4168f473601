"""What was identified is a robot, and a file: read back it makes the same torques, and MuJoCo takes it."""

import io
import json
import re
import sys

import numpy as np
import pytest
from known_logs import heavier, known_log
from shared import load

import eladapt as ea
from eladapt.cli import main
from eladapt.errors import EladaptError


@pytest.fixture(scope="module", params=["ur5", "panda", "talos_left_arm"])
def identified(request):
    robot = load(request.param)
    return robot, ea.identify(heavier(robot), known_log(robot, 16.0), held_out=0, progress=False)


def test_the_file_makes_the_identified_torques(identified, tmp_path):
    robot, found = identified
    path = found.save_urdf(tmp_path / "new.urdf")
    again = ea.Robot.from_urdf(path, package_dirs=robot.package_dirs, locked=robot.locked)
    theta = found.physical.copy()
    theta[found.regressors.block("offset")] = 0
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, v, a = robot.random_configuration(rng), *rng.normal(size=(2, robot.nv))
        torque = again.inverse_dynamics(q, v, a) + again.damping * v + again.friction * np.sign(v)
        told = found.regressors.torque(q, v, a) @ theta
        assert torque == pytest.approx(told, abs=1e-9 * np.abs(told).max())
        assert found.robot.inverse_dynamics(q, v, a) == pytest.approx(
            again.inverse_dynamics(q, v, a), rel=1e-12
        )
    assert ea.MujocoPlant(again, again.configuration(robot.home)).robot is again


def test_the_file_keeps_what_is_not_identified(identified, tmp_path):
    """All but <inertial> and <dynamics>."""
    robot, found = identified
    new = found.save_urdf(tmp_path / "new.urdf").read_text()
    kinds = r"\s*<(inertial)\b.*?</\1>|\s*<dynamics\b[^>]*/>"
    blank = [
        re.sub(r"\s+", "", re.sub(kinds, "", text, flags=re.DOTALL)) for text in (robot.path.read_text(), new)
    ]
    assert blank[0] == blank[1]


def test_the_gravity_of_the_file_holds_the_arm(identified):
    """Held by gravity torques alone for 50 ms: it drifts a tenth as far as with the old file, or less."""
    robot, found = identified
    q = robot.configuration(robot.home)
    drift = {}
    for name, model in (("old", found.original), ("new", found.robot)):
        plant = ea.PinocchioPlant(robot, q)
        plant.reset()
        for _ in range(50):
            plant.step(model.gravity(plant.q), 1e-3)
        drift[name] = np.linalg.norm(robot.difference(q, plant.q))
    assert drift["new"] < 0.1 * drift["old"]


def test_links_that_move_together_are_said_so():
    robot = load("panda")
    found = ea.identify(robot, known_log(robot), held_out=0, progress=False)
    (said,) = found.merged
    assert said.startswith("panda_link7 holds the inertia of panda_link8, panda_hand, panda_leftfinger")
    assert "while panda_finger_joint1, panda_finger_joint2 hold still: lock them in the new file too" in said
    loose = ea.identify(robot, known_log(robot), held_out=0, physical=False, progress=False)
    with pytest.raises(EladaptError, match="no physical parameters"):
        loose.save_urdf("never.urdf")


def test_the_report_says_what_was_found(identified, tmp_path):
    _, found = identified
    page = found.report(tmp_path / "page.html").read_text()
    for said in ("Torque error", "What the log does not tell", "standard deviation", "rotor [kg m"):
        assert said in page
    assert "http-equiv" in page


def test_the_curves_of_a_page_have_gaps_and_one_look_each(monkeypatch):
    """Of a log by a clock that counts from 1970, of which single precision knows 128 s."""
    robot, log = load("two_link"), known_log(load("two_link"), 8.0, dt=4e-3)
    kept = (log.t < 3) | (log.t > 4)
    parts = {name: getattr(log, name)[kept] for name in ("q", "v", "tau")}
    found = ea.identify(robot, ea.Log(1.7e9 + log.t[kept], **parts), held_out=0, progress=False)
    pages = {}
    monkeypatch.setattr(
        "eladapt.display.identification_report.made", lambda title, shown: pages.update(shown)
    )
    found.report()
    looks = {}
    for name in ("Torques", "Residuals"):
        figures = pages[name].children
        assert len(figures) == robot.nv
        for line in (line for figure in figures for line in figure.renderers):
            t, y = line.data_source.data["t"], line.data_source.data["y"]
            assert np.isnan(y).sum() == 1
            assert 2.6 < t[np.isnan(y)][0] < 4.4  # margins of 0.2 s on both sides of the gap
            assert len(set(t)) > 0.95 * len(t)
            looks.setdefault(line.name, set()).add((line.glyph.line_color, str(line.glyph.line_dash)))
    assert all(len(seen) == 1 for seen in looks.values())
    assert set(looks) == {"measured", "URDF", "identified", "physical"}


def test_the_page_of_a_controllers_state_does_not_speak_of_a_log(tmp_path):
    robot = load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    state = controller.init(ea.Measurement(0.0, robot.configuration(robot.home), np.zeros(2), np.zeros(2)))
    page = ea.identify(robot, state).report(tmp_path / "page.html").read_text()
    assert "two_link, from its run" in page
    assert "What the run does not tell" in page
    assert "Sample by sample" not in page


def test_the_command(tmp_path, capsys):
    robot = load("ur5")
    log = known_log(robot, 10.0, noise=0.1)
    names = [f"{kind}_{joint}" for kind in ("q", "dq", "tau") for joint in robot.joint_names]
    rows = np.column_stack([log.t, log.q, log.velocity, log.tau])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(["t", *names]), comments="")
    new, page = tmp_path / "new.urdf", tmp_path / "page.html"
    arguments = ["identify", "ur5", str(tmp_path / "log.csv"), "--out", str(new), "--report", str(page)]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert f"wrote {new}" in said
    assert re.search(r"^physical .* raw$", said, re.MULTILINE)
    assert re.search(r"^wrist_3_joint +0\.\d+ \+- [\de.-]+ +0\.[56]\d+ \+- ", said, re.MULTILINE)
    assert page.stat().st_size > 10_000
    assert main(["check", str(new)]) == 0
    assert ea.Robot.from_urdf(new).damping == pytest.approx(np.full(6, 0.4), abs=0.1)


def test_the_command_says_a_remark_once_and_writes_before_it_speaks(tmp_path, capsys, monkeypatch):
    """A log of one joint that stands still, into a pipe that was closed: the files are there all the same."""
    log = known_log(load("two_link"), 6.0, dt=4e-3)
    rows = np.column_stack([log.t, log.q[:, 0], 0 * log.t, log.velocity[:, 0], 0 * log.t, log.tau])
    path, page = tmp_path / "log.csv", tmp_path / "page.html"
    np.savetxt(path, rows, delimiter=",", header="t,q1,q2,dq1,dq2,tau1,tau2", comments="")
    line = ["identify", "two_link", str(path), "--joint", "shoulder", "--joint", "elbow"]
    assert main(line) == 0
    said, warned = capsys.readouterr()
    assert said.count("elbow stands still") == 1
    assert "stands still" not in warned
    assert main([*line, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["errors"].keys() >= {"URDF", "identified"}
    assert set(found["parameters"][0]) == {"label", "value", "std", "physical"}

    def closed(*_, **__):
        raise BrokenPipeError

    monkeypatch.setattr("eladapt.cli.identifying.say", closed)
    monkeypatch.setattr(sys, "stderr", io.StringIO())  # which `main` closes then
    assert main([*line, "--report", str(page)]) == 1
    assert page.stat().st_size > 10_000


def test_the_command_takes_columns_by_number_name_and_pattern(tmp_path, capsys):
    log = known_log(load("two_link"), 6.0, dt=4e-3)
    rows = np.column_stack([log.q, log.t, log.velocity, log.tau])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header="a,b,clock,v_1,v_2,x1,x2", comments="")
    columns = ["--column", "q=0", "--column", "q=b", "--column", "t=clock", "--column", "v=v_*"]
    assert main(["identify", "two_link", str(path), *columns, "--column", "tau=x1,x2"]) == 0
    assert re.search(r"^identified .* raw$", capsys.readouterr().out, re.MULTILINE)
    assert main(["identify", "two_link", str(path), *columns, "--column", "tau=x1,7"]) == 1
    assert "unknown column of tau '7'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["identify", "ur5", "none.csv"], "error: none.csv: no such log"),
        (["identify", "ur5", "none.csv", "--out", "x.txt"], "--out: expected a name that ends in .urdf"),
        (["identify", "ur5", "none.csv", "--report", "x.txt"], "expected a file name that ends in .html"),
        (["identify", "ur6", "none.csv"], "unknown robot 'ur6'"),
    ],
)
def test_what_the_command_refuses(arguments, said, capsys):
    assert main(arguments) == 1
    assert said in capsys.readouterr().err
