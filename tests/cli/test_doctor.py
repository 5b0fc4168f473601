"""`eladapt doctor` says what a computer is good for, and what to do about what it is not."""

import os

import pytest

import eladapt as ea
from eladapt.cli import main


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
