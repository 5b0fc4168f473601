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


def test_the_readme_says_what_each_fault_means():
    """All names of `FAULTS` in the first column of its table, and no other."""
    readme = (Path(__file__).parents[1] / "README.md").read_text("utf-8")
    table = readme.split("| `ea.FAULTS` |")[1].split("\n\n")[0]
    named = [name for row in re.findall(r"^\| ([^|-]+) \|", table, re.M) for name in row.split(", ")]
    assert sorted(named) == sorted(ea.FAULTS)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'plott'"):
        _ = ea.plott


def test_the_import_is_light():
    """A control loop on a robot's computer draws nothing."""
    program = f"import eladapt, sys; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr
