"""The command line, run as a new user would: it does what it says, or says in one line what is wrong."""

import json
import re
import shutil
import subprocess

import pytest
from command import JOINT, LINK, run

import eladapt as ea
from eladapt.cli import main

BROKEN = """<robot name="r"><link name="a"/><link name="b"/>
<joint name="j" type="{}"><parent link="{}"/><child link="b"/></joint></robot>"""


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
