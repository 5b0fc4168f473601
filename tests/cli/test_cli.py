"""The command line, run as a new user would: it does what it says, or says in one line what is wrong."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest

import eladapt as ea
from eladapt.cli import main

BROKEN = """<robot name="r"><link name="a"/><link name="b"/>
<joint name="j" type="{}"><parent link="{}"/><child link="b"/></joint></robot>"""


def run(*arguments, folder=None):
    """The command in a process of its own, as from a shell."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "100"}
    command = [sys.executable, "-m", "eladapt", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=folder, env=environment)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a record, with what is none, and with URDFs that are broken."""
    folder = tmp_path_factory.mktemp("user")
    robot = ea.Robot.load("two_link")
    controller = ea.CompositeController.for_robot(robot)
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    goal = robot.configuration(robot.target)
    ea.simulate(controller, plant, goal, 0.1, progress=False).save(folder / "run.npz")
    (folder / "text.npz").write_text("not a record")
    (folder / "cut.npz").write_bytes((folder / "run.npz").read_bytes()[:3000])
    (folder / "loose.urdf").write_text(BROKEN.format("hinge", "nowhere"))
    (folder / "not.urdf").write_text("<robot")
    return folder


WRONG = [
    # what is wrong with the command: 2
    ((), 2, "COMMAND"),
    (("fly",), 2, "robots"),
    (("robots", "x"), 2, "unrecognized arguments: x"),
    (("doctor", "x"), 2, "unrecognized arguments: x"),
    (("check",), 2, "ROBOT"),
    (("check", "panda", "--dt", "soon"), 2, "invalid float value: 'soon'"),
    (("run",), 2, "ROBOT"),
    (("run", "two_link", "--plant", "gazebo"), 2, "pinocchio"),
    (("run", "two_link", "--goal", "up", "down"), 2, "expected a number, got 'up'"),
    (("run", "two_link", "--payload"), 2, "--payload"),
    (("run", "two_link", "--speed", "3"), 2, "unrecognized arguments: --speed 3"),
    (("report",), 2, "RECORD"),
    # what is wrong with a robot, a file or a number: 1
    (("check", "nowhere.urdf"), 1, "nowhere.urdf: does not exist"),
    (("check", "pandaa"), 1, "unknown robot 'pandaa'; legal names: asr_twodof"),
    (("check", "."), 1, "is a folder"),
    (("check", "not.urdf"), 1, "expected XML"),
    (("check", "loose.urdf"), 1, "faults, listed above"),
    (("check", "two_link", "--dt", "-1"), 1, "--dt: expected a finite number"),
    (("check", "two_link", "--dt", "3"), 1, "no gains at 0.333333 Hz"),
    (("check", "two_link", "--lock", "elbow"), 1, "--lock"),
    (("run", "nowhere.urdf"), 1, "does not exist"),
    (("run", "three_link"), 1, "unknown robot"),
    (("run", "two_link", "--goal", "1"), 1, "--goal: expected 2 numbers, for shoulder, elbow; got 1"),
    (("run", "two_link", "--goal", "nan", "1"), 1, "finite"),
    (("run", "two_link", "--goal", "99", "1"), 1, "99 is outside the limits of shoulder"),
    (("run", "two_link", "--start", "1", "99"), 1, "--start: 99 is outside the limits of elbow"),
    (("run", "two_link", "--payload", "-2"), 1, "--payload: expected a finite number in (0, inf), got -2"),
    (("run", "two_link", "--payload", "1", "--attach", "-1"), 1, "--attach"),
    (("run", "two_link", "--noise", "-1"), 1, "--noise"),
    (("run", "two_link", "--seed", "-1"), 1, "--seed"),
    (("run", "two_link", "--dt", "0"), 1, "--dt"),
    (("run", "two_link", "--duration", "inf"), 1, "--duration"),
    (("run", "two_link", "--duration", "1e-9"), 1, "--duration: expected at least a step"),
    (("run", "two_link", "--out", "run.npz/here"), 1, "run.npz"),
    (("report", "nowhere.npz"), 1, "no such record"),
    (("report", "text.npz"), 1, "not a record"),
    (("report", "cut.npz"), 1, "damaged"),
    (("report", "run.npz", "--out", "run.pdf"), 1, ".html"),
    (("report", "run.npz", "--out", "."), 1, "folder"),
    (("report", "run.npz", "--label", "a", "b"), 1, "expected 1, one a record, got 2"),
]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    WRONG,
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_what_is_wrong_is_said_in_one_line(files, monkeypatch, capsys, arguments, code, said):
    monkeypatch.chdir(files)
    try:
        returned = main(list(arguments))
    except SystemExit as left:
        returned = left.code
    error = capsys.readouterr().err
    assert returned == code
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert said in error


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "nowhere.urdf"),
        ("run", "pandaa"),
        ("report", "text.npz"),
        ("fly",),
        ("robots", "x"),
        ("doctor", "x"),
    ],
)
def test_so_it_is_from_a_shell(files, arguments):
    """In a process of its own: the exit code, and no traceback."""
    done = run(*arguments, folder=files)
    assert done.returncode in (1, 2)
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr + done.stdout


def test_the_faults_of_a_urdf_are_listed(files, monkeypatch, capsys):
    monkeypatch.chdir(files)
    assert main(["check", "loose.urdf"]) == 1
    listed = capsys.readouterr().out
    assert 'type="hinge"' in listed
    assert 'link="nowhere"' in listed


@pytest.mark.parametrize("command", ["", "robots", "check", "run", "report", "doctor"])
def test_help_has_an_example_that_runs(command, capsys):
    """Every example's command line is one that the parser takes."""
    with pytest.raises(SystemExit) as left:
        main([*command.split(), "--help"])
    assert left.value.code == 0
    text = capsys.readouterr().out
    examples = re.findall(r"^  eladapt (\w+)(.*)$", text, re.M)
    assert examples
    import shlex

    from eladapt.cli import _parser

    for name, rest in examples:
        _parser().parse_args([name, *shlex.split(rest)])


def test_robots_lists_the_library(capsys):
    assert main(["robots"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert names == ea.robots()


def test_check_says_ranks_limits_and_gains(capsys):
    assert main(["check", "panda"]) == 0
    text = capsys.readouterr().out
    reg = ea.Regressors(ea.Robot.load("panda"))
    assert f"{len(reg)} of 70 standard ones, {reg.n_potential} of gravity" in text
    assert re.search(r"panda_joint6 .* 12\n", text), "its torque limit"
    assert "gains exist at 1000 Hz" in text
    assert "visual shapes: 11" in text


def test_check_takes_the_path_of_a_urdf(capsys):
    path = ea.Robot.load("two_link").path
    assert main(["check", str(path), "--dt", "0.002"]) == 0
    assert "gains exist at 500 Hz" in capsys.readouterr().out


def test_run_and_report_leave_what_they_say(tmp_path, monkeypatch, capsys):
    """A load that nobody told of, on MuJoCo: record, plot and report, and the estimate in words."""
    monkeypatch.chdir(tmp_path)
    line = "run two_link --goal=2,1.5 --payload 0.5 --plant mujoco --duration 3 --seed 3"
    assert main(line.split()) == 0
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert re.search(r"every joint below 1e-3 rad after \d\.\d+ s", said.out)
    assert "load, as estimated: 0.5 kg" in said.out
    record = ea.Record.load("out/two_link.npz")
    np.testing.assert_allclose(record.goal[0], [2, 1.5])
    assert record.configuration["plant"]["class"] == "MujocoPlant"
    assert record.configuration["plant"]["seed"] == 3
    assert record.configuration["certificates"][0]["rows"]
    for name in ("two_link.png", "two_link.html"):
        assert (tmp_path / "out" / name).stat().st_size > 10_000
    assert main(["report", "out/two_link.npz", "--out", "page.html", "--no-animation"]) == 0
    assert "wrote page.html" in capsys.readouterr().out
    assert "lambda_max((D_L + slope) dt M^-1)" in (tmp_path / "page.html").read_text("utf-8"), (
        "a certificate's row"
    )


def test_a_run_that_diverges_keeps_what_happened(tmp_path, monkeypatch, capsys):
    """The load is far too heavy: one line, and the record up to there."""
    monkeypatch.chdir(tmp_path)
    from eladapt.errors import SimulationError
    from eladapt.simulation.plants import PinocchioPlant

    step = PinocchioPlant.step

    def diverging(self, tau, dt):
        if self.t > 0.05:
            raise SimulationError("the simulated two_link diverged before t = 0.05 s")
        return step(self, tau, dt)

    monkeypatch.setattr(PinocchioPlant, "step", diverging)
    assert main(["run", "two_link", "--duration", "1"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "diverged" in error
    assert "two_link.npz" in error
    assert 40 < len(ea.Record.load("out/two_link.npz")) < 60


def test_live_shows_the_run_while_it_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "two_link", "--live", "--duration", "0.2", "--no-certificates"]) == 0
    assert "The arm can be seen at http://127.0.0.1:" in capsys.readouterr().out


@pytest.mark.slow
def test_doctor_finds_this_computer_well(capsys):
    assert main(["doctor"]) == 0
    text = capsys.readouterr().out
    assert "FAIL" not in text
    for said in (
        "Python 3",
        "pinocchio",
        f"{len(ea.robots())} robots",
        "loopback",
        "Panda's controller takes",
    ):
        assert said in text


def test_doctor_says_what_is_missing(monkeypatch, capsys):
    """A package that is not there is a FAIL with its remedy, and the exit code."""
    from eladapt.cli import doctor

    monkeypatch.setattr(doctor, "NEEDED", ("numpy", "no-such-package"))
    monkeypatch.setattr(doctor, "_speed", lambda: iter(()))
    assert main(["doctor"]) == 1
    assert "FAIL  no-such-package: pip install no-such-package" in capsys.readouterr().out


def test_a_density_weighs_what_has_no_inertia(tmp_path):
    """`check` says which links and how heavy; without one it says that there is this way."""
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="r"><link name="a"/><link name="b"><visual><origin xyz="0.1 0 0"/><geometry>'
        '<box size="0.2 0.05 0.05"/></geometry></visual></link><joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="20" velocity="2"/></joint></robot>'
    )
    assert "--density" in run("check", path).stderr
    done = run("check", path, "--density", "2000")
    assert done.returncode == 0, done.stderr
    assert "weighed by their shapes at 2000 kg/m^3: b 1 kg" in done.stdout
