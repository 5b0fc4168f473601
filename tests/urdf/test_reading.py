"""What a file may be made of: paths, encodings, names and numbers; damage to it escapes as nothing else."""

from __future__ import annotations

import os

import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_arm import ARM, TOOL, refused, written

from eladapt.errors import UrdfError
from eladapt.robot.model import Robot
from eladapt.urdf.checks import check_urdf, read_urdf
from eladapt.urdf.numbers import parse


@pytest.mark.parametrize(("name", "problem"), [("none.urdf", "does not exist"), ("", "is a folder")])
def test_a_path_that_is_no_file_is_refused(tmp_path, name, problem):
    """A missing file and a folder are named, with the URDF files that are there."""
    written(tmp_path)
    (finding,) = refused(check_urdf, tmp_path / name).findings
    assert finding.value == str(tmp_path / name)
    assert finding.problem == problem
    assert '"robot.urdf"' in finding.remedy


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_refused_without_waiting(tmp_path):
    """A path that would block when opened is refused by its kind."""
    os.mkfifo(tmp_path / "pipe.urdf")
    assert refused(check_urdf, tmp_path / "pipe.urdf").findings[0].problem == "is not a file"


def test_a_default_namespace_changes_nothing(tmp_path):
    """Pinocchio's reader ignores namespaces, so the checks look through a default one."""
    spaced = ('<robot name="arm">', '<robot name="arm" xmlns="http://www.ros.org">')
    check_urdf(written(tmp_path, spaced))
    (finding,) = refused(check_urdf, written(tmp_path, spaced, ('value="2"', 'value="-2"'))).findings
    assert finding.value == 'value="-2"'


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_float_is_a_number(value):
    """The strict grammar of numbers takes what Python writes."""
    assert parse(repr(value)) == (value,)
    assert parse(f"{value!r}  {value!r} 0", 3) == (value, value, 0.0)


@pytest.mark.parametrize(
    "text", ["", "1_0", "0x10", "1d3", "+-1", ".", "1e", "\u0661", "1\t", "infinity", "true"]
)
def test_what_the_reader_drops_is_not_a_number(text):
    """What Python or a person may take for a number but Pinocchio's reader does not is refused."""
    assert parse(text) is None


@settings(derandomize=True, deadline=None, max_examples=300)
@given(start=st.integers(0, len(ARM)), length=st.integers(0, 60), noise=st.binary(max_size=12))
def test_no_damage_to_a_file_escapes_as_another_error(tmp_path_factory, start, length, noise):
    """A file with a piece cut out and bytes put in either is read by Pinocchio too, or raises UrdfError."""
    path = tmp_path_factory.mktemp("damaged") / "robot.urdf"
    path.write_bytes(ARM[:start].encode() + noise + ARM[start + length :].encode())
    try:
        check_urdf(path)
    except UrdfError:
        return
    pin.buildModelFromUrdf(str(path))


def test_blanks_and_tabs_around_numbers_are_read(tmp_path):
    """As vendors ship them; the model is that of the file without them."""
    changes = [
        ('mass value="2"', 'mass value=" 2 "'),
        ('xyz="0 0 1" rpy="0 0 0"', 'xyz=" 0\t0  1" rpy="0 0 0 "'),
    ]
    assert Robot.from_urdf(written(tmp_path, *changes)).model == Robot.from_urdf(written(tmp_path)).model


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<robot name="arm">', '<robot name="arm" xmlns:xacro="http://elsewhere"><xacro:if value="true"/>'),
        (TOOL, TOOL + '<property name="w" value="0.2"/>'),
        (TOOL, TOOL + '<include filename="arm.xacro"/>'),
    ],
)
def test_xacro_of_any_namespace_or_none_is_refused(tmp_path, old, new):
    with pytest.raises(UrdfError, match="xacro tag"):
        check_urdf(written(tmp_path, (old, new)))


def test_an_unused_xacro_namespace_is_none(tmp_path):
    """What xacro leaves when it expands a file."""
    check_urdf(
        written(tmp_path, ('<robot name="arm">', '<robot name="arm" xmlns:xacro="http://ros.org/xacro">'))
    )


@pytest.mark.parametrize("encoding", ["gbk", "shift_jis", "utf-8"])
def test_a_file_is_read_in_the_encoding_that_it_declares(tmp_path, encoding):
    path = tmp_path / "arm.urdf"
    text = f'<?xml version="1.0" encoding="{encoding}"?>' + ARM.replace(
        'name="tool"', 'name="\u624b"'
    ).replace('link="tool"', 'link="\u624b"')
    path.write_bytes(text.encode(encoding))
    assert Robot.from_urdf(path).model.existFrame("\u624b")


def test_materials_of_one_name_are_named(tmp_path):
    twice = '<material name="grey"/>' * 2
    with pytest.raises(UrdfError, match='material "grey": 2 times'):
        check_urdf(written(tmp_path, (TOOL, TOOL + twice)))


@pytest.mark.parametrize("encoding", ["punycode", "zlib", "rot13", "nonsense"])
def test_an_encoding_that_nobody_writes_in_is_refused(tmp_path, encoding):
    """Without a try at it: decoding five megabytes of punycode takes hours."""
    path = tmp_path / "arm.urdf"
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>'.encode() + b"a" * 4_000_000)
    with pytest.raises(UrdfError, match="encoding"):
        read_urdf(path)
