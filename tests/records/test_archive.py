"""A record or a state that was forged, damaged or made to fill the memory is refused as what it is not."""

import dataclasses
import io
import json
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shared import load

import eladapt as ea
from eladapt.errors import RecordError, StateError
from eladapt.records.archive import MOST_ARRAYS
from eladapt.records.record import MOST_BYTES, SHAPES

KINDS = ("record", "state")


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def declaring(text):
    """An array's head alone."""
    return b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + text.encode().ljust(117) + b"\n"


@pytest.fixture(scope="module")
def controller():
    return ea.CompositeController.for_robot(load("two_link"))


@pytest.fixture(scope="module")
def good(controller, tmp_path_factory):
    """The members of a good file of each kind."""
    folder, robot = tmp_path_factory.mktemp("good"), controller.robot
    plant = ea.PinocchioPlant(robot, robot.configuration(robot.home))
    record = ea.simulate(controller, plant, robot.configuration(robot.target), 0.02, progress=False)
    files = {
        "record": record.save(folder / "record.npz"),
        "state": ea.save_state(folder / "state.npz", controller, record.final_state),
    }
    members = {}
    for kind, path in files.items():
        with zipfile.ZipFile(path) as archive:
            members[kind] = {name: archive.read(name) for name in archive.namelist()}
    return members


@pytest.fixture
def refused(controller):
    """Loads a file of a kind, which is to be refused; returns what is said."""

    def refused(kind, path):
        with pytest.raises(RecordError if kind == "record" else StateError) as caught:
            ea.Record.load(path) if kind == "record" else ea.load_state(path, controller)
        assert str(path) in str(caught.value)
        return str(caught.value)

    return refused


def pack(path, members, how=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", how) as archive:
        for name, contents in members.items():
            archive.writestr(name, contents)
    return path


def changed(contents, place, new):
    return contents[:place] + new + contents[place + len(new) :]


FORGED = {  # a member's name, "first" for some array, to what it holds instead
    **{f"a header {text[:8]}": {"header.npy": npy(np.array(text))} for text in (
        "[" * 200_000, "5", "[1]", "null", '"a"', "{}", '{"format": 2}', '{"format": []}', "{", "",
        '{"format": 2, "tree": ' + '{"list": [' * 400 + "]}" * 400 + "}",
    )},
    "a header of numbers": {"header.npy": npy(np.zeros(3))},
    "a header of objects": {
        "header.npy": declaring("{'descr': '|O', 'fortran_order': False, 'shape': (), }")
    },
    "one array more": {"wings.npy": npy(np.zeros(3))},
    "a member that is no array": {"first": b"not an array"},
    "an empty member": {"first": b""},
    "an array of 320 GB": {
        "first": declaring("{'descr': '<f8', 'fortran_order': False, 'shape': (40000000000,), }")
    },
    "an array of nothing without end": {
        "first": declaring("{'descr': '<U0', 'fortran_order': False, 'shape': (40000000000,), }")
    },
    "a head that is code": {"first": declaring("__import__('os').abort()")},
    "a head without end": {"first": declaring("{'descr': [" + "(" * 80)},
    "texts": {"first": npy(np.full(21, "wing"))},
    "complex numbers": {"first": npy(np.full(21, 1j))},
    "another shape": {"first": npy(np.zeros((21, 21, 21)))},
    "too many arrays": {f"a{k}.npy": b"" for k in range(MOST_ARRAYS)},
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FORGED)
def test_a_forged_file_is_refused(good, refused, tmp_path, kind, name):
    first = next(member for member in good[kind] if member != "header.npy")
    members = {first if member == "first" else member: new for member, new in FORGED[name].items()}
    refused(kind, pack(tmp_path / "forged.npz", {**good[kind], **members}))


HEADERS = [
    ("title", 5), ("configuration", []), ("robot_source", "panda"), ("n_potential", -1), ("dt", "soon"),
    ("wings", 2), ("joint_names", ["one"]), ("parameter_labels", [1, 2]), ("final_state", 3), ("faults", 3),
    ("faults", ["jump"]), ("faults", [["jump", 0.1]]), ("faults", [["jump", "soon", "too far"]]),
    ("faults", [[{}, 0.1, "too far"]]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), HEADERS)
def test_a_header_of_other_kinds_is_refused(good, refused, tmp_path, name, value):
    header = json.loads(str(np.load(io.BytesIO(good["record"]["header.npy"]))))
    text = json.dumps({**header, name: value})
    members = {**good["record"], "header.npy": npy(np.array(text))}
    refused("record", pack(tmp_path / "forged.npz", members))


@pytest.mark.parametrize("index", [[0, 2], [-1, 0], [0.0, 1.0]])
def test_joints_that_stand_nowhere_in_q_are_refused(good, refused, tmp_path, index):
    members = {**good["record"], "q_index.npy": npy(np.array(index))}
    assert "q_index" in refused("record", pack(tmp_path / "forged.npz", members))


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_zip_is_refused(good, refused, tmp_path, kind):
    whole = pack(tmp_path / "a.npz", good[kind], zipfile.ZIP_DEFLATED).read_bytes()
    entry = whole.find(b"PK\x01\x02")
    damages = {
        "its stream": (60, bytes(30)), "method 99": (entry + 10, b"\x63"), "encrypted": (entry + 8, b"\x01"),
        "its end": (len(whole) - 22, bytes(22)), "its checksum": (entry + 16, bytes(4)),
    }  # fmt: skip
    for name, (place, new) in damages.items():
        (tmp_path / f"{name}.npz").write_bytes(changed(whole, place, new))
        refused(kind, tmp_path / f"{name}.npz")
    for how in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        other = pack(tmp_path / "other.npz", good[kind], how).read_bytes()
        (tmp_path / "other.npz").write_bytes(changed(other, 60, bytes(len(other) // 2)))
        refused(kind, tmp_path / "other.npz")


@pytest.mark.parametrize("kind", KINDS)
def test_a_bomb_is_refused_before_it_goes_off(good, refused, tmp_path, kind):
    """Zeros that would become twice what may be: refused with a hundredth of that memory."""
    bomb = npy(np.zeros(2 * MOST_BYTES // 8))
    first = next(member for member in good[kind] if member != "header.npy")
    path = pack(tmp_path / "bomb.npz", {**good[kind], first: bomb}, zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < MOST_BYTES / 200
    del bomb
    tracemalloc.start()
    assert "bytes would become" in refused(kind, path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2 * MOST_BYTES / 100


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file_is_not_read(refused, tmp_path, kind):
    os.mkfifo(tmp_path / "pipe.npz")
    (tmp_path / "device.npz").symlink_to("/dev/zero")
    for name in ("pipe", "device"):
        assert "is no regular file" in refused(kind, tmp_path / f"{name}.npz")
    assert "no such" in refused(kind, tmp_path / "nowhere.npz")
    assert "save" in refused(kind, tmp_path)


@settings(max_examples=150)
@given(
    place=st.floats(0, 1, exclude_max=True),
    put=st.binary(min_size=1, max_size=8),
    kind=st.sampled_from(KINDS),
)
def test_no_damage_raises_anything_else(good, controller, tmp_path_factory, place, put, kind):
    """Refused, or what was damaged was of no matter; a state that loads is the state."""
    folder = Path(tmp_path_factory.getbasetemp())
    whole = pack(folder / "whole.npz", good[kind]).read_bytes()
    path = folder / "damaged.npz"
    path.write_bytes(changed(whole, int(place * len(whole)), put))
    try:
        ea.Record.load(path) if kind == "record" else ea.load_state(path, controller)
    except (RecordError, StateError):
        return


def test_a_long_record_of_an_arm_mostly_at_rest_is_no_bomb(tmp_path, good):
    """All but the velocities constant, and more than the bytes that any file may take: read."""
    record = ea.Record.load(pack(tmp_path / "record.npz", good["record"]))
    n = MOST_BYTES // 8 // record.parameters.shape[1]
    rows = {name: getattr(record, name) for name in SHAPES if "N" in SHAPES[name]}
    still = {name: np.broadcast_to(a[0], (n, *a.shape[1:])) for name, a in rows.items() if a is not None}
    noise = np.random.default_rng(0).normal(size=(n, 2))
    path = dataclasses.replace(record, **{**still, "v": noise}).save(tmp_path / "long.npz")
    assert len(ea.Record.load(path)) == n
