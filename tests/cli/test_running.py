"""`eladapt run`: what it does, says and leaves, whatever ends it."""

import os
import re

import numpy as np
import pytest
from command import named, run

import eladapt as ea
from eladapt.cli import main


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


@pytest.mark.parametrize(("name", "stem"), [(".", "robot"), ("../../up", "up")])
def test_files_stay_in_the_folder_asked_for(tmp_path, name, stem):
    out = tmp_path / "x" / "out"
    urdf = named(tmp_path, name)
    assert main(["run", str(urdf), "--duration", "0.01", "--no-certificates", "--out", str(out)]) == 0
    assert os.listdir(tmp_path / "x") == ["out"]
    assert sorted(os.listdir(out)) == [f"{stem}.{suffix}" for suffix in ("html", "npz", "png")]
    assert sorted(os.listdir(tmp_path)) == ["arm.urdf", "x"]


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
