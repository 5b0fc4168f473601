"""What is drawn comes from the folders that the one who opens it allows, and from nowhere else."""

import base64
import contextlib
import json
import os
import pickle
import re
import struct
import subprocess
import sys

import numpy as np
import pytest

import eladapt as ea
from eladapt.cli import main
from eladapt.display.report import report
from eladapt.errors import MeshWarning, RecordError
from eladapt.urdf.editing import Edits
from eladapt.viewing import meshes as drawing
from eladapt.viewing.scene import visuals_of

CANARY = 0.12345679  # [m] of a vertex in files that lie outside
INERTIAL = (
    '<inertial><origin xyz="0 0 0.2"/><mass value="1"/>'
    '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
)
ARM = """<robot name="arm"><link name="base"/><link name="link">{inertial}{visuals}</link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="link"/><origin xyz="0 0 0.3"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="3"/></joint></robot>"""
VISUAL = '<visual><geometry><mesh filename="{}"/></geometry></visual>'


def stl(size):
    corners = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, size, 0, 0, 0, size, 0, 0)
    return bytes(80) + struct.pack("<I", 1) + corners


def collada(use):
    return f"""<COLLADA><library_visual_scenes><visual_scene id="s"><node>{use}</node></visual_scene>
    </library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def gltf(uri):
    return json.dumps({
        "buffers": [{"uri": uri, "byteLength": 36}], "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    })  # fmt: skip


HOSTILE = {  # by name: contents, with OUT for the folder outside; what is said
    "relative.gltf": (gltf("../outside/canary.bin"), "refers to another file"),
    "absolute.gltf": (gltf("OUT/canary.bin"), "refers to another file"),
    "canary.dae": (collada('<instance_geometry url="../outside/canary.dae#g"/>'), "refers to another file"),
    "scene.lws": ("LWSC\n1\nLoadObject OUT/canary.stl\n", "expected one of the formats"),
    "scene.irr": (
        '<irr_scene><string name="Mesh" value="OUT/canary.stl"/></irr_scene>',
        "one of the formats",
    ),
    "nan.stl": (stl(np.nan), "finite"),
    "link.stl": (None, "lies outside the folders"),
    "pipe.stl": (None, "is no regular file"),
    "device.stl": (None, "lies outside the folders"),
    "missing.stl": (None, "there is none in"),
}


@pytest.fixture
def folder(tmp_path):
    """An arm's folder, and one outside with the canary."""
    for name in ("arm", "outside"):
        (tmp_path / name).mkdir()
    corners = np.array([[0, 0, 0], [CANARY, 0, 0], [0, CANARY, 0]], "<f4")
    (tmp_path / "outside" / "canary.bin").write_bytes(corners.tobytes())
    (tmp_path / "outside" / "canary.stl").write_bytes(stl(CANARY))
    return tmp_path / "arm"


def arm(folder, *names, **options):
    visuals = "".join(map(VISUAL.format, names))
    (folder / "arm.urdf").write_text(ARM.format(inertial=INERTIAL, visuals=visuals))
    return ea.Robot.from_urdf(folder / "arm.urdf", **options)


def lay(folder, name):
    contents = HOSTILE[name][0]
    path = folder / name
    if name == "link.stl":
        path.symlink_to(folder.parent / "outside" / "canary.stl")
    elif name == "pipe.stl":
        os.mkfifo(path)
    elif name == "device.stl":
        path.symlink_to("/dev/zero")
    elif isinstance(contents, bytes):
        path.write_bytes(contents)
    elif contents is not None:
        path.write_text(contents.replace("OUT", str(folder.parent / "outside")))


def holds(text, size):
    """Whether a page's commands have a vertex of that size in them."""
    packed = re.findall(r"[A-Za-z0-9+/]{40,}", text)
    return any(
        struct.pack("<f", size) in base64.b64decode(part + "=" * (-len(part) % 4))
        for part in packed
        if len(part) % 4 != 1
    )


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_mesh_is_named_and_left_out(folder, name):
    """With the reason; the arm's other mesh is still there."""
    (folder / "own.stl").write_bytes(stl(0.25))
    robot = arm(folder, "own.stl", name)  # made while none of it was there
    lay(folder, name)
    (own,) = shapes(robot, name, HOSTILE[name][1])
    assert own.box()[1].max() == 0.25


def test_no_byte_from_outside_is_in_a_page(folder, record_of):
    (folder / "own.stl").write_bytes(stl(0.25))
    inside = [name for name, (_, said) in HOSTILE.items() if "outside" not in said]
    for name in inside:
        lay(folder, name)
    record = record_of(arm(folder, "own.stl", *inside))
    with pytest.warns(MeshWarning):
        page = ea.view(record, html=folder / "run.html").path.read_text("utf-8")
    assert holds(page, 0.25)
    assert not holds(page, CANARY)


def shapes(robot, *said):
    with pytest.warns(MeshWarning) as caught:
        visuals = visuals_of(robot)
    assert len(caught) == 1
    for part in said:
        assert part in str(caught[0].message)
    return visuals


def test_the_canary_would_be_found(folder, record_of):
    """The search itself: the same mesh, with its folder allowed, is in the page."""
    outside = folder.parent / "outside"
    record = record_of(arm(folder, outside / "canary.stl", package_dirs=[outside]))
    assert holds(ea.view(record, html=folder / "run.html").path.read_text("utf-8"), CANARY)


def test_a_robot_of_which_nothing_can_be_drawn_is_drawn_as_sticks(folder):
    visuals = shapes(arm(folder, "missing.stl", "also.stl"), "link_0", "link_1")
    assert [type(visual.form).__name__ for visual in visuals] == ["Capsule", "Capsule"]


def test_the_meshes_of_a_robot_are_bounded_together(folder, monkeypatch):
    monkeypatch.setattr(drawing, "MOST_TOGETHER", 3)
    (folder / "one.stl").write_bytes(stl(0.25))
    visuals = shapes(arm(folder, *["one.stl"] * 20), "more than 3 triangles", "and 9 more")
    assert len(visuals) == 3


def test_a_record_opens_no_folder_by_itself(folder, record_of, capsys):
    """Its header may name any; those that the opener names are opened, for the view and for reports."""
    package = folder.parent / "package"
    (package / "arm").mkdir(parents=True)
    (package / "arm" / "canary.stl").write_bytes(stl(CANARY))
    robot = arm(folder, "package://arm/canary.stl", package_dirs=[package])
    path = record_of(robot).save(folder / "run.npz")
    for allowed in ([], [package]):
        record = ea.Record.load(path, allowed)
        assert record.robot_source["package_dirs"] == list(map(str, allowed))
        with contextlib.nullcontext() if allowed else pytest.warns(MeshWarning, match=r"canary\.stl"):
            pages = ea.view(record, html=folder / "v.html").path, report(record, folder / "r.html")
        for page in pages:
            assert holds(page.read_text("utf-8"), CANARY) == bool(allowed)
    out = ["--out", str(folder / "c.html")]
    assert main(["report", str(path), *out]) == 0
    said = capsys.readouterr().err
    assert re.search(r"warning: .*canary\.stl.*name its folder in package_dirs \(--package-dir\)", said)
    assert main(["report", str(path), *out, "--package-dir", str(package)]) == 0
    assert capsys.readouterr().err == ""


def test_a_record_brings_its_urdf_along(folder, record_of, tmp_path, capsys):
    """The file is gone: its text makes the same robot. Its meshes come from where the opener says; the folder
    that it once was in opens nothing, since whoever made the record may name any."""
    (folder / "canary.stl").write_bytes(stl(CANARY))
    robot = arm(folder, "canary.stl")
    path = record_of(robot).save(folder / "run.npz")
    robot.path.unlink()
    record = ea.Record.load(path)
    assert ea.Robot.from_source(record.robot_source).model == robot.model
    with pytest.warns(MeshWarning, match="is not there any more. Name the folder"):
        page = report(record, tmp_path / "r.html").read_text("utf-8")
    assert not holds(page, CANARY)
    assert "Not drawn" not in page
    with_folder = ea.Record.load(path, [folder])
    assert holds(report(with_folder, tmp_path / "r.html").read_text("utf-8"), CANARY)
    assert main(["report", str(path), "--out", str(tmp_path / "c.html"), "--no-animation"]) == 0
    assert capsys.readouterr().err == ""


def test_a_robot_is_what_was_read(folder):
    """Whatever becomes of its file: its document, its edits and its pickle."""
    robot = arm(folder)
    before = robot.document().find("link[@name='link']/inertial/mass").get("value")
    robot.path.write_text(robot.path.read_text().replace('mass value="1"', 'mass value="7"'))
    assert robot.document().find("link[@name='link']/inertial/mass").get("value") == before
    assert pickle.loads(pickle.dumps(robot)).document().find("link[@name='link']/inertial/mass") is not None
    assert robot.edited(Edits({}, {"hinge": {"damping": 0.5}})).model.inertias[1].mass == 1
    assert robot.link_names == ("link",)


@pytest.mark.parametrize(
    "source",
    [
        {"urdf": 5},
        {"urdf": "a.urdf", "wings": 2},
        {"urdf": "a", "locked": 5},
        {"urdf": "a", "text": "<no>"},
        {"urdf": "a", "text": 5},
        {"urdf": "a", "text": "\u20ac"},
    ],
)
def test_a_record_that_names_no_robot_is_refused(record_of, tmp_path, source):
    path = record_of("two_link", robot_source=source).save(tmp_path / "run.npz")
    with pytest.raises(ea.EladaptError):
        ea.view(ea.Record.load(path), html=tmp_path / "v.html")
    assert not (tmp_path / "v.html").exists()
    with pytest.raises(RecordError, match="robot_source"):
        ea.Record.load(record_of("two_link", robot_source={}).save(path))


def test_no_reader_of_meshes_is_loaded_but_ours():
    """Assimp follows what a file names; whoever uses it again opens what this file closes."""
    program = (
        "import eladapt as ea, pinocchio as pin\n"
        "def never(*_, **__): raise AssertionError\n"
        "pin.buildGeomFromUrdf = never\n"
        "import coal; coal.MeshLoader.load = coal.CachedMeshLoader.load = never\n"
        "from eladapt.viewing.scene import visuals_of\n"
        "print(sum(len(v.form.triangles) for v in visuals_of(ea.Robot.load('panda'))))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "134913", done.stderr
