"""Hostile and broken files: each is refused with its cause, within 2 s and 500 MB; no process dies of one.

A robot whose meshes are hostile is read, and drawn without them.

Every file is read in a process of its own, forked from one that has imported eladapt, so that a crash, a hang
or a bloated heap shows in that process alone.
"""

from __future__ import annotations

import base64
import gzip
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from small_arm import ARM, ELBOW
from test_bodies import BODIES
from test_checks import CHAIN, MUTATIONS, NOT_ROBOTS

import eladapt as ea
from eladapt.errors import MeshWarning
from eladapt.meshes.mesh import Mesh
from eladapt.viewing.scene import visuals_of

SECONDS, MEGABYTES = 2.0, 500.0
ROD = '<cylinder radius="0.03" length="0.4"/>'
MOUNT = '<parent link="fore"/> <child link="tool"/> <axis xyz="0 0 0"/>'


class Hostile(NamedTuple):
    """What is written, and a part of what must be said."""

    content: str | bytes
    said: str


def changed(*pairs: tuple[str, str]) -> str:
    text = ARM
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def meshed(filename: str) -> str:
    return changed((ROD, f'<mesh filename="{filename}"/>'))


def chain(links: int, loop: bool = False) -> str:
    joints = "".join(CHAIN.format(k, k + 1) for k in range(links))
    back = '<joint name="back" type="fixed"><parent link="l5"/><child link="l0"/></joint>' if loop else ""
    return f'<robot name="r"><link name="l0"/>{joints}{back}</robot>'


LAUGHS = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
MIMIC = '<mimic joint="{}"/></joint>'
BOMBS = {
    "billion laughs": (
        f'<!DOCTYPE r [<!ENTITY l0 "ha">{LAUGHS}]>' + ARM.replace('"arm"', '"&l9;"'), "document types"
    ),
    "quadratic blow-up": (
        f'<!DOCTYPE r [<!ENTITY a "{"a" * 50_000}">]><robot name="{"&a;" * 50_000}"/>', "document types"
    ),
    "entity from a file": (
        '<!DOCTYPE r [<!ENTITY f SYSTEM "file:///etc/passwd">]><robot name="&f;"/>', "document types"
    ),
    "parameter entity": (
        '<!DOCTYPE r [<!ENTITY % p SYSTEM "http://127.0.0.1:9/x"> %p;]><robot name="r"/>', "document types",
    ),
    "100,000 elements deep": ("<robot>" + "<link>" * 100_000, "depth 33"),
    "a million empty elements": ('<robot name="r">' + "<a/>" * 1_000_000 + "</robot>", "50000 elements"),
    "a name of 4 MB": (changed(('mass value="2"', f'mass value="{"9" * 4_000_000}"')), "finite number"),
    "a comment of 6 MB": (f"<!--{'x' * 6_000_000}-->" + ARM, "bytes"),
    "5,000 joints in a chain": (chain(5_000), "5000 joints"),
    "20,000 joints in a chain": (chain(20_000), "50000 elements"),
    "200 joints and a circle": (chain(199, loop=True), "in a cycle"),
    "10,000 links without joints": (
        '<robot name="r">' + "".join(f'<link name="a{k}"/>' for k in range(10_000)) + "</robot>",
        "10000 links",
    ),
    "30,000 attributes": (
        '<robot name="r"><link name="a" ' + " ".join(f'b{k}=""' for k in range(30_000)) + "/></robot>",
        "no <joint>",
    ),
}  # fmt: skip
BYTES = {
    "gzip": (gzip.compress(ARM.encode()), "expected XML"),
    "not UTF-8": (ARM.replace('"arm"', '"\xe4rm"').encode("latin-1"), "expected XML"),
    "an unknown encoding": (b'<?xml version="1.0" encoding="klingon"?>' + ARM.encode(), "expected XML"),
    "a zero byte": (ARM.replace('"arm"', '"a\0m"'), "expected XML"),
    "two roots": (ARM + ARM, "expected XML"),
    "an attribute twice": (changed(('value="2"', 'value="2" value="3"')), "duplicate attribute"),
    "random": (bytes((k * 167 + 13) % 256 for k in range(4096)), "expected XML"),
    "COLLADA": ("<COLLADA/>", "<COLLADA>"),
    "MJCF": ('<mujoco model="m"><worldbody/></mujoco>', "<mujoco>"),
    "HTML": ("<html><body>404 Not Found</body></html>", "<html>"),
    "robot inside a robot": (f'<robot name="a">{ARM}</robot>', "no <link>"),
}
FILES = {
    "mesh above the folder": (meshed("../../../../../../etc/passwd"), "lies outside"),
    "mesh at an absolute path": (meshed("/etc/passwd"), "lies outside"),
    "mesh by file://": (meshed("file:///etc/passwd"), "lies outside"),
    "mesh above a package": (meshed("package://arm/../../../../../etc/passwd"), "lies outside"),
    "mesh escaped": (meshed("%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd"), "lies outside"),
    "mesh from the network": (meshed("http://127.0.0.1:9/arm.stl"), "http:// is not read"),
    "mesh behind a link": (meshed("link/passwd"), "lies outside"),
    "mesh of a device": (meshed("/dev/zero"), "lies outside"),
    "mesh without a name": (meshed(""), "names no file"),
    "mesh in a namespace of its own": (meshed('/etc/passwd" xmlns="u'), "lies outside"),
    "visual in a namespace of its own": (
        changed(("<visual>", '<visual xmlns="u">'), (ROD, '<mesh filename="/etc/passwd"/>')),
        "lies outside",
    ),
    "mesh that is nowhere": (meshed("no_such_file.stl"), "there is none in"),
    "mesh that is none": (meshed("robot.urdf"), "robot.urdf"),
    "texture above the folder": (
        changed(
            (
                "</geometry></visual>",
                '</geometry><material name="m"><texture filename="../../x"/></material></visual>',
            )
        ),
        "accepted",
    ),
}
MIMICS = {
    "mimics itself": (changed((ELBOW, ELBOW + '<mimic joint="elbow"/>')), "in a circle"),
    "mimics nobody": (changed((ELBOW, ELBOW + '<mimic joint="elbw"/>')), "no joint has this name"),
    "mimics in a circle": (
        changed((ELBOW, ELBOW + '<mimic joint="mount"/>'), (MOUNT, MOUNT + '<mimic joint="elbow"/>')),
        "in a circle",
    ),
    "mimics without a lock": (changed((ELBOW, ELBOW + '<mimic joint="shoulder"/>')), "no torque of its own"),
}
SIZES = {
    "mass of a planet": (changed(('mass value="2"', 'mass value="6e24"')), "at most 1e+06 in size"),
    "arm to the moon": (changed(('xyz="0 0 1"', 'xyz="0 0 4e8"')), "at most 10000 in size"),
    "inertia that overflows": (
        changed(('ixx="0.03"', 'ixx="1e200"'), ('iyy="0.04"', 'iyy="1e200"')), "at most 1e+09 in size"
    ),
    "axis that overflows": (changed(('xyz="1 0 0"', 'xyz="1e300 0 0"')), "at most 1e+06 in size"),
    "angle without end": (changed(('rpy="0 0 0"', 'rpy="0 0 1e308"')), "at most 10000 in size"),
    "damping that overflows": (changed(('damping="0.5"', 'damping="1e300"')), "at most 1e+09 in size"),
}  # fmt: skip
SPECIAL = {  # made by `lay_out`
    "a folder": (None, "is a folder"),
    "a pipe": (None, "is not a file"),
    "an endless device": (None, "is not a file"),
    "a link to nothing": (None, "does not exist"),
    "links in a circle": (None, "does not exist"),
}


def cases() -> dict[str, Hostile]:
    groups = {**BOMBS, **BYTES, **MIMICS, **SIZES, **NOT_ROBOTS}
    found = {name: Hostile(*pair) for name, pair in groups.items()}
    for name, (old, new, _, value) in {**MUTATIONS, **BODIES}.items():
        found[name] = Hostile(ARM.replace(old, new), value)
    return {**found, **{name: Hostile("", said) for name, (_, said) in SPECIAL.items()}}


CASES = cases()
DRAWN = {name: Hostile(*pair) for name, pair in FILES.items()}

DRIVER = """
import base64, json, os, resource, signal, sys, time, warnings
import eladapt as ea
from eladapt.errors import UrdfError
from eladapt.viewing.scene import STICK_COLOUR, visuals_of
for name in json.load(sys.stdin):
    back, out = os.pipe()
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (10, 10))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(30)
        began = time.process_time()
        try:
            with warnings.catch_warnings(record=True) as told:
                robot = ea.Robot.from_urdf(os.path.join(sys.argv[1], name, "robot.urdf"))
                robot.gravity(robot.configuration(robot.home))
                left = [visual for visual in visuals_of(robot) if visual.colour is not STICK_COLOUR]
            said = f"accepted with {len(left)} shapes; " + " ".join(str(warning.message) for warning in told)
        except UrdfError as error:
            said = "refused: " + str(error)
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"
        with os.fdopen(out, "w") as file:
            json.dump({"said": said[:20000], "seconds": time.process_time() - began}, file)
        os._exit(0)
    os.close(out)
    with os.fdopen(back) as file:
        text = file.read()
    _, status, usage = os.wait4(child, 0)
    result = {"name": name, "signal": os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0,
              "megabytes": usage.ru_maxrss / (1e3 if sys.platform == "linux" else 1e6)}
    print(json.dumps({**result, **(json.loads(text) if text else {"said": "died", "seconds": 0.0})}))
"""


def folder_of(name: str) -> str:
    return base64.urlsafe_b64encode(name.encode()).decode()


def lay_out(top: Path) -> None:
    for name, case in {**CASES, **DRAWN}.items():
        folder = top / folder_of(name)
        folder.mkdir()
        path = folder / "robot.urdf"
        if name == "a folder":
            path.mkdir()
        elif name == "a pipe":
            os.mkfifo(path)
        elif name == "an endless device":
            path.symlink_to("/dev/zero")
        elif name == "a link to nothing":
            path.symlink_to("nothing")
        elif name == "links in a circle":
            path.symlink_to("robot.urdf")
        else:
            content = case.content
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        if name == "mesh behind a link":
            (folder / "link").symlink_to("/etc")


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    top = tmp_path_factory.mktemp("hostile")
    lay_out(top)
    names = json.dumps([folder_of(name) for name in {**CASES, **DRAWN}])
    command = [sys.executable, "-c", DRIVER, str(top)]
    done = subprocess.run(command, input=names, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return {result["name"]: result for result in map(json.loads, done.stdout.splitlines())}


def test_there_are_enough():
    assert len(CASES) >= 60


@pytest.mark.parametrize("name", CASES)
def test_a_hostile_file_is_refused_with_its_cause(outcomes, name):
    """Refused by name, in time and in space; the process that read it ends as it should."""
    result = bounded(outcomes[folder_of(name)])
    assert result["said"].startswith("refused: "), result["said"][:300]
    assert "robot.urdf" in result["said"]
    assert CASES[name].said in result["said"]


@pytest.mark.parametrize("name", DRAWN)
def test_a_hostile_mesh_is_left_out_of_the_view_alone(outcomes, name):
    """The robot has its dynamics; its view lacks the mesh and says which and why. No texture is read."""
    result = bounded(outcomes[folder_of(name)])
    shapes = 1 if "texture" in name else 0
    assert result["said"].startswith(f"accepted with {shapes} shapes"), result["said"][:300]
    assert DRAWN[name].said in result["said"]
    assert ("upper_0: " in result["said"]) == (shapes == 0)


def bounded(result: dict[str, Any]) -> dict[str, Any]:
    """What became of a file, in a process that ended as it should, in time and in space."""
    assert result["signal"] == 0, f"killed by signal {result['signal']}"
    assert result["seconds"] < SECONDS  # of the processor: the clock of a busy machine says nothing
    assert result["megabytes"] < MEGABYTES  # of the whole process, with numpy and pinocchio
    return result


CORNERS = "outer loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop"
TRIANGLE = f"solid part\nfacet normal 0 0 1\n{CORNERS}\nendfacet\nendsolid part\n"
INSIDE = ("part.stl", "./meshes/part.stl", "meshes/../part.stl", "package://arm/part.stl")


def drawn(urdf: Path, *package_dirs: Path) -> int:
    """How many meshes the view has, where every warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", MeshWarning)
        visuals = visuals_of(ea.Robot.from_urdf(urdf, package_dirs=package_dirs))
    return sum(isinstance(visual.form, Mesh) for visual in visuals)


@pytest.mark.parametrize("filename", INSIDE)
def test_meshes_beside_the_file_are_drawn(tmp_path, monkeypatch, filename):
    """Found from where the URDF lies, wherever the program runs."""
    folder = tmp_path / "arm"
    (folder / "meshes").mkdir(parents=True)
    for place in (folder / "part.stl", folder / "meshes" / "part.stl"):
        place.write_text(TRIANGLE)
    (folder / "robot.urdf").write_text(meshed(filename))
    monkeypatch.chdir("/")
    assert drawn(folder / "robot.urdf", *([tmp_path] if "package" in filename else [])) == 1


def test_a_package_folder_may_be_anywhere_but_not_left(tmp_path):
    """package_dirs open their own folders, through a link too, and nothing above them."""
    (tmp_path / "urdf").mkdir()
    (tmp_path / "packages" / "arm").mkdir(parents=True)
    for place in (tmp_path / "packages" / "arm" / "part.stl", tmp_path / "secret.stl"):
        place.write_text(TRIANGLE)
    (tmp_path / "linked").symlink_to(tmp_path / "packages")
    urdf = tmp_path / "urdf" / "robot.urdf"
    for folder in ("packages", "linked"):
        urdf.write_text(meshed("package://arm/part.stl"))
        assert drawn(urdf, tmp_path / folder) == 1
        urdf.write_text(meshed("package://arm/../../secret.stl"))
        with pytest.raises(MeshWarning, match="lies outside the folders"):
            drawn(urdf, tmp_path / folder)
    (tmp_path / "share").mkdir()  # as a workspace has it, whose packages are links to their sources
    (tmp_path / "share" / "arm").symlink_to(tmp_path / "packages" / "arm")
    urdf.write_text(meshed("package://arm/part.stl"))
    assert drawn(urdf, tmp_path / "share") == 1
    for out in ("package://arm/../../secret.stl", "package://../secret.stl", "package://arm/../arm/out.stl"):
        (tmp_path / "packages" / "arm" / "out.stl").unlink(missing_ok=True)
        (tmp_path / "packages" / "arm" / "out.stl").symlink_to(tmp_path / "secret.stl")
        urdf.write_text(meshed(out))
        with pytest.raises(MeshWarning, match="lies outside the folders"):
            drawn(urdf, tmp_path / "share")
    urdf.write_text(meshed("../packages/arm/part.stl"))
    with pytest.raises(MeshWarning, match="lies outside the folders"):
        drawn(urdf)
    assert drawn(urdf, tmp_path / "packages") == 1
