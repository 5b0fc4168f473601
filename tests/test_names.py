"""The public names are there, and importing the library does not import what only some of them need."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import eladapt as ea

HEAVY = ("matplotlib", "meshcat", "bokeh", "mujoco", "tornado")


@pytest.mark.parametrize("name", ea.__all__)
def test_a_public_name_exists(name):
    assert getattr(ea, name) is not None


def test_the_site_says_what_each_fault_means():
    """All names of `FAULTS` in the first column of its table, and no other."""
    page = (Path(__file__).parents[1] / "docs" / "how-to" / "faults.md").read_text("utf-8")
    table = page.split("| `ea.FAULTS` |")[1].split("\n\n")[0]
    named = [name for row in re.findall(r"^\| ([^|-]+) \|", table, re.M) for name in row.split(", ")]
    assert sorted(named) == sorted(ea.FAULTS)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="plott"):
        _ = ea.plott


def test_a_loop_imports_nothing_that_draws():
    """A control loop on a robot's computer."""
    program = (
        "import eladapt as ea, sys; ea.CompositeController, ea.GatedController, ea.run_loop; "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr


def test_the_import_takes_less_than_four_tenths_of_a_second():
    """Of processor time, since a computer does other things; the interpreter's own start is part of it."""
    program = "import eladapt, sys, time; print(time.process_time(), 'numpy' in sys.modules)"
    runs = [
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=60
        ).stdout.split()
        for _ in range(3)
    ]
    assert min(float(seconds) for seconds, _ in runs) < 0.4
    assert {numpy for _, numpy in runs} == {"False"}


def test_type_checkers_and_the_interpreter_see_the_same_names():
    stub = (Path(ea.__file__).parent / "__init__.pyi").read_text("utf-8")
    assert sorted(re.findall(r"import (\w+) as \1$", stub, re.M)) == sorted(ea.__all__)
    assert dir(ea) == ea.__all__
