"""Nothing in a file or a name of somebody else steers the terminal."""

import re
from pathlib import Path

import pytest
from command import named

import eladapt as ea
from eladapt.cli import main

# An 8-bit and a 7-bit command for the terminal, a bell, and letters that run from right to left.
STEERING = "J\u009b31m\x1b]0;owned\x07\u202etxt\u2066"


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
