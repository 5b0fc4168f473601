"""The command line, run as a new user would: it does what it says, or says in one line what is wrong."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import eladapt as ea
from eladapt.cli import main

BROKEN = """<robot name="r"><link name="a"/><link name="b"/>
<joint name="j" type="{}"><parent link="{}"/><child link="b"/></joint></robot>"""

LINK = """<link name="{0}"><inertial><mass value="2"/><origin xyz="0 0 0.2"/>
<inertia ixx="0.03" iyy="0.04" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{1}" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="50" velocity="3"/></joint>"""


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
    weak = JOINT.replace("{1}", "j1").replace("50", "3")
    (folder / "weak.urdf").write_text(f'<robot name="r"><link name="base"/>{LINK.format("l1")}{weak}</robot>')
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
    (("check", "pandaa"), 1, "unknown robot 'pandaa' (did you mean 'panda'?); legal names: asr_twodof"),
    (("rn",), 2, "invalid choice: 'rn' (did you mean 'run'?) (choose from robots, check, run"),
    (("run", "two_link", "--plant", "mujoko"), 2, "(did you mean 'mujoco'?)"),
    (("run", "two_link", "--payloda", "2"), 2, "--payloda 2 (did you mean '--payload'?) (see: eladapt run "),
    (("run", "two_link", "--view", "--json"), 1, "--live, --view: expected without --quiet and --json"),
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
    (("run", "two_link", "--goal", "99", "1"), 1, "--goal: shoulder at 99 is beyond its limits, "),
    (("run", "two_link", "--goal", "45", "-30"), 1, "shoulder at 45 (-10 to 10), elbow at -30 ("),
    (("run", "two_link", "--goal", "45", "-30"), 1, "; are these degrees?"),
    (("run", "two_link", "--start", "1", "99"), 1, "--start: elbow at 99 is beyond its limits, "),
    (("run", "two_link", "--payload", "-2"), 1, "--payload: expected a finite number in (0, inf), got -2"),
    (("run", "two_link", "--payload", "1", "--attach", "-1"), 1, "--attach"),
    (("run", "two_link", "--attach", "1"), 1, "--attach: expected with --payload"),
    (
        ("check", "not.urdf", "--density", "2.7"),
        1,
        "--density: expected a finite number in [10, 23000], got 2.7",
    ),
    (("check", "not.urdf", "--density", "1e-300"), 1, "in kg/m^3, aluminium has 2700"),
    (("run", "two_link", "--noise", "-1"), 1, "--noise: expected a finite number in [0, inf), got -1"),
    (("run", "two_link", "--seed", "-1"), 1, "--seed"),
    (("run", "two_link", "--dt", "0"), 1, "--dt"),
    (("run", "two_link", "--duration", "inf"), 1, "--duration"),
    (("run", "two_link", "--duration", "1e-9"), 1, "--duration: expected at least a step"),
    (("run", "two_link", "--duration", "1e308"), 1, "--duration: expected a finite number in (0, 1e+12)"),
    (("run", "weak.urdf", "--goal", "1.5"), 1, "--goal: j1 cannot be held there: gravity takes 3.9"),
    (("run", "two_link", "--duration", "1e9"), 1, "a record of 1e+12 samples takes "),
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


@pytest.mark.parametrize("command", ["", "robots", "check", "run", "report", "doctor", "completion"])
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


def test_a_run_that_a_fault_ended_exits_with_3_and_is_kept(tmp_path, monkeypatch, capsys):
    """A load that no motor holds: the fault and the brakes are said, and --help says the code."""
    monkeypatch.chdir(tmp_path)
    line = "run two_link --payload 20 --attach 0.5 --duration 1.5 --no-certificates"
    assert main(line.split()) == 3
    said = capsys.readouterr().out
    assert re.search(r"fault: [a-z ]+ at t = \d\.\d+ s: .*; brakes asked for at t = \d\.\d+ s", said)
    assert ea.Record.load("out/two_link.npz").faults
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    assert "3 when a fault of the torque gate ended the run" in capsys.readouterr().out


def test_run_and_report_leave_what_they_say(tmp_path, monkeypatch, capsys):
    """A load that nobody told of, on MuJoCo: record, plot and report, and the estimate in words."""
    monkeypatch.chdir(tmp_path)
    line = "run two_link --goal=2,1.5 --payload 0.5 --plant mujoco --duration 3 --seed 3"
    assert main(line.split()) == 0
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert re.search(r"every joint below 1e-3 rad after \d\.\d+ s", said.out)
    assert "load, as estimated: 0.5 kg" in said.out
    for line in ("largest speed: no joint has a limit", "joint range: kept by every joint", "fault: none"):
        assert f"\n{line}\n" in said.out
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


def test_a_run_says_what_became_of_the_limits(tmp_path, monkeypatch, capsys):
    """Behind the gate a fault, its kind and when; with --jump no gate, and a speed beyond the limit."""
    monkeypatch.chdir(tmp_path)
    line = "run asr_twodof --duration 0.2 --no-certificates "
    assert main((line + "--noise 0.1").split()) == 3
    said = capsys.readouterr().out
    assert re.search(r"\nfault: sensor at t = 0\.0\d+ s: .* off where its velocity leads", said)
    assert ea.Record.load("out/asr_twodof.npz").faults[0].name == "sensor"
    assert main((line + "--jump").split()) == 0
    said, warned = capsys.readouterr()
    fast = r"3\d\d% of the limit, J2 at 0\.00\d s, above it for 0\.\d+ s\n"
    assert re.search(r"\nlargest speed: " + fast, said)
    assert re.search(r"warning: a speed limit was exceeded: " + fast, warned)
    assert "\nfault: not recorded\n" in said


def test_a_load_that_is_too_heavy_is_said_so(tmp_path, monkeypatch, capsys):
    """Before the run, and among what the gate takes for the cause; an estimate that is none is said in
    words."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", "panda", "--payload", "1000", "--duration", "0.1", "--no-certificates"]) == 3
    out, err = capsys.readouterr()
    assert re.search(
        r"warning: --payload: 1000 kg are too heavy for this arm at its goal: panda_joint\d cannot be held",
        err,
    )
    assert "what it carries is too heavy" in out
    assert "load, as estimated: not known" in out
    assert "panda_joint7  not known" in out
    assert "nan" not in out


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


def test_ctrl_c_keeps_the_run(tmp_path, monkeypatch, capsys):
    """One line, the code of a shell, and the record up to there."""
    monkeypatch.chdir(tmp_path)
    from eladapt.simulation.plants import PinocchioPlant

    step = PinocchioPlant.step

    def interrupted(self, tau, dt):
        if self.t > 0.05:
            raise KeyboardInterrupt
        return step(self, tau, dt)

    monkeypatch.setattr(PinocchioPlant, "step", interrupted)
    assert main(["run", "two_link", "--duration", "1"]) == 130
    said, warned = capsys.readouterr()
    assert said == ""
    assert warned.count("\n") == 1
    assert re.search(r"interrupted at 0\.05\d? s; what happened until then is in out/two_link\.npz", warned)
    assert 40 < len(ea.Record.load("out/two_link.npz")) < 60


def test_what_is_asked_for_as_json_is_nothing_else(tmp_path, monkeypatch, capsys):
    """Of a run: the metrics, null where there is no limit; with --quiet not even that."""
    monkeypatch.chdir(tmp_path)
    line = ["run", "two_link", "--duration", "0.05", "--no-certificates"]
    assert main([*line, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found["written"]) == {"record", "plot", "report"}
    assert found["metrics"]["speed"]["value"] is None
    assert found["metrics"]["steady_error"] == pytest.approx(ea.Record.load("out/two_link.npz").metrics()[1])
    assert found["friction"]["joints"] == ["shoulder", "elbow"]
    assert main([*line, "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_a_program_reads_what_there_is_and_what_a_urdf_is_good_for(capsys):
    assert main(["robots", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)) == ea.robots()
    assert main(["check", "two_link", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    robot = ea.Robot.load("two_link")
    assert [joint["effort"] for joint in found["joints"]] == [None, None], "none is set"
    assert found["gains"]["P"] == pytest.approx(ea.CompositeController.for_robot(robot).gains.P.tolist())
    assert len(found["base_parameters"]) == len(ea.Regressors(robot))


def test_the_version_is_the_packages(capsys):
    with pytest.raises(SystemExit) as left:
        main(["--version"])
    assert left.value.code == 0
    assert capsys.readouterr().out == f"eladapt {ea.__version__}\n"


def test_a_shell_completes_commands_options_and_robots(tmp_path, capsys):
    """By the script that `eladapt completion bash` prints, in a bash."""
    pytest.importorskip("shtab")
    if (bash := shutil.which("bash")) is None:
        pytest.skip("no bash")
    assert main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    for typed, expected in (("id", "identify"), ("run pan", "panda"), ("run panda --payl", "--payload")):
        words = ["eladapt", *typed.split()]
        ask = (
            f"source ./script; COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; _shtab_eladapt; "
        )
        done = subprocess.run([bash, "-c", ask + 'echo "${COMPREPLY[@]}"'], capture_output=True, text=True,
                              cwd=tmp_path)  # fmt: skip
        assert done.stdout.split() == [expected]


def test_no_bar_is_in_a_log_and_no_mesh_is_needed(tmp_path):
    """Of a run whose meshes are nowhere, with stderr in a file: the metrics, and warnings line by line."""
    path, visual = named(tmp_path, "arm"), "<visual><geometry><mesh filename='no.stl'/></geometry></visual>"
    path.write_text(path.read_text().replace("</link>", visual + "</link>"))
    done = run("run", path, "--duration", "0.2", "--no-certificates", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "largest speed: " in done.stdout
    assert "warning: " in done.stderr
    assert "no.stl" in done.stderr
    assert "\r" not in done.stderr + done.stdout
    assert "%|" not in done.stderr


def test_live_shows_the_run_while_it_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "two_link", "--live", "--duration", "0.2", "--no-certificates"]) == 0
    assert "The arm can be seen at http://127.0.0.1:" in capsys.readouterr().out


# An 8-bit and a 7-bit command for the terminal, a bell, and letters that run from right to left.
STEERING = "J\u009b31m\x1b]0;owned\x07\u202etxt\u2066"


def named(folder, name, joint="j1"):
    """The path of an arm with these names."""
    path = folder / "arm.urdf"
    text = f'<robot name="{name}"><link name="base"/>{LINK.format("l1")}{JOINT}</robot>'
    path.write_text(text.replace("{1}", joint), encoding="utf-8")
    return path


def steers(text):
    return any(not letter.isprintable() for letter in text.replace("\n", ""))


def test_no_name_or_path_steers_the_terminal(tmp_path, monkeypatch, capsys):
    """What a URDF, a record and the command itself name is shown with its commands spelt out."""
    monkeypatch.chdir(tmp_path)
    legal = "".join(letter for letter in STEERING if letter > "\x1f") + "&#10;"  # XML has no others
    main(["check", str(named(tmp_path, "arm" + legal, legal))])
    main(["run", "arm.urdf", "--duration", "0.05", "--no-certificates"])
    main(["run", "arm.urdf", "--goal", "9"])
    main(["check", str(named(tmp_path, "arm", '" type="fixed'))])
    main(["check", f"{STEERING}.urdf"])
    record = ea.Record.load(next((tmp_path / "out").glob("*.npz")))
    record.robot_source["urdf"] = f"/{STEERING}.urdf"
    record.save(f"{STEERING}.npz")
    main(["report", f"{STEERING}.npz"])
    main(["report", f"{STEERING}.csv"])
    with pytest.raises(SystemExit):
        main(["report", f"--{STEERING}"])
    said = capsys.readouterr()
    assert "J\\x9b31m]0;owned\\u202etxt\\u2066\\n" in said.out
    assert "\\x1b]0;owned" in said.err
    assert not steers(said.out)
    assert not steers(said.err)


def test_all_that_is_printed_is_shown():
    """The commands print by `say` alone."""
    folder = Path(ea.__file__).parent / "cli"
    printing = [
        path.name for path in folder.glob("*.py") if re.search(r"(?<![\w.])print\(", path.read_text())
    ]
    assert printing == ["saying.py"]


@pytest.mark.parametrize(("name", "stem"), [(".", "robot"), ("../../up", "up")])
def test_files_stay_in_the_folder_asked_for(tmp_path, name, stem):
    out = tmp_path / "x" / "out"
    urdf = named(tmp_path, name)
    assert main(["run", str(urdf), "--duration", "0.01", "--no-certificates", "--out", str(out)]) == 0
    assert os.listdir(tmp_path / "x") == ["out"]
    assert sorted(os.listdir(out)) == [f"{stem}.{suffix}" for suffix in ("html", "npz", "png")]
    assert sorted(os.listdir(tmp_path)) == ["arm.urdf", "x"]


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
        "priority=",
        "cpus=",
    ):
        assert said in text


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no real-time scheduling here")
def test_doctor_advises_what_a_loop_may_ask_for(monkeypatch):
    """Processors that are kept free, the highest priority that is permitted, and the kernel."""
    import resource

    from eladapt.cli import doctor

    files = {"/sys/devices/system/cpu/isolated": "2-3", "/sys/kernel/realtime": "1"}
    monkeypatch.setattr(doctor, "_read", lambda path: files.get(path, ""))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    for limit, said in ((80, "ok 1 to 80"), (0, "note is refused: add '@realtime - rtprio 80'")):
        monkeypatch.setattr(resource, "getrlimit", lambda _kind, limit=limit: (limit, limit))
        processors, priority = doctor._realtime()
        assert (processors.grade, "2-3 are kept free" in processors.text) == ("ok", True)
        grade, text = said.split(" ", 1)
        assert priority.grade == grade
        assert text in priority.text
    files.clear()
    assert {finding.grade for finding in doctor._realtime()} == {"note"}


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
