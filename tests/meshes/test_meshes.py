"""A mesh is what lies in its own file, within bounds; anything else is a MeshError that names the file."""

import base64
import json
import os
import struct
import time
from pathlib import Path

import coal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import eladapt as ea
from eladapt.errors import MeshError
from eladapt.meshes.mesh import MOST_BYTES, MOST_TRIANGLES, READERS, read_mesh
from eladapt.robot import library

CORNERS = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.3, 0], [0, 0, 0.5]], dtype="<f4")
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype="<u2")
SECONDS = 3.0  # of the processor, for what takes 0.2 s on a machine of 2020 and took minutes


def stl(corners=CORNERS, sides=SIDES):
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *corners[side].ravel(), 0) for side in sides)
    return bytes(80) + struct.pack("<I", len(sides)) + facets


def stl_text(corners=CORNERS, sides=SIDES):
    loops = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x:.9e} {y:.9e} {z:.9e}\n" for x, y, z in corners[side])
        + "endloop\nendfacet\n"
        for side in sides
    )
    return f"solid vertex of a cone\n{loops}endsolid\n".encode()


def obj(head="mtllib paint.mtl\n"):
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    faces = "f 1/1/1 3//1 2\nf -4 -3 -1\nf 1 4 \\\n3\nf 2 3 4\n"
    return (head + "o cone\n" + vertices + "usemtl red\n" + faces + "l 1 2\n").encode()


COLLADA = """<?xml version="1.0"?><c:COLLADA xmlns:c="http://www.collada.org/2005/11/COLLADASchema">
<c:library_geometries><c:geometry id="g"><c:mesh>
<c:source id="s"><c:float_array id="f" count="12">{corners}</c:float_array><c:technique_common>
<c:accessor source="#f" count="4" stride="3"/></c:technique_common></c:source>
<c:vertices id="v"><c:input semantic="POSITION" source="#s"/></c:vertices>{parts}
</c:mesh></c:geometry></c:library_geometries>
{library}<c:library_visual_scenes><c:visual_scene id="sc">{nodes}</c:visual_scene></c:library_visual_scenes>
<c:scene><c:instance_visual_scene url="#sc"/></c:scene></c:COLLADA>"""
INPUTS = (
    '<c:input semantic="VERTEX" source="#v" offset="0"/><c:input semantic="NORMAL" source="#n" offset="1"/>'
)
USE = '<c:instance_geometry url="#g"/>'
TRIANGLE = f'<c:triangles count="1">{INPUTS}<c:p>0 0 2 0 1 0</c:p></c:triangles>'
PARTS = (
    TRIANGLE
    + f'<c:polylist count="2">{INPUTS}<c:vcount>3 3</c:vcount><c:p>0 0 1 0 3 0 0 0 3 0 2 0</c:p></c:polylist>'
    + f'<c:tristrips count="1">{INPUTS}<c:p>1 0 2 0 3 0</c:p></c:tristrips>'
)


def dae(parts=PARTS, nodes=f"<c:node>{USE}</c:node>", corners=CORNERS, library=""):
    text = " ".join(map(str, np.ravel(corners)))
    return COLLADA.format(corners=text, parts=parts, nodes=nodes, library=library).encode()


def gltf_document(uri=None, **changes):
    data = CORNERS.tobytes() + SIDES.tobytes()
    where = {} if uri is None else {"uri": uri}
    return {
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": len(data), **where}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0, **changes,
    }  # fmt: skip


def gltf(**changes):
    data = base64.b64encode(CORNERS.tobytes() + SIDES.tobytes()).decode()
    uri = changes.pop("uri", f"data:application/octet-stream;base64,{data}")
    return json.dumps(gltf_document(uri, **changes)).encode()


def glb(document=None):
    text = json.dumps(document or gltf_document()).encode()
    text += b" " * (-len(text) % 4)
    data = CORNERS.tobytes() + SIDES.tobytes()
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x4E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


GOOD = {
    "binary.stl": stl(), "text.stl": stl_text(), "capitals.stl": stl_text().upper(),
    "cone.obj": obj(), "cone.dae": dae(), "cone.gltf": gltf(), "cone.GLB": glb(),
}  # fmt: skip


def read(folder, name, contents, **options):
    (folder / name).write_bytes(contents)
    return read_mesh(folder / name, **options)


def shape_of(mesh):
    """The corners (m, 3, 3) of the triangles, in an order that does not depend on the file's."""
    corners = mesh.vertices[mesh.triangles]
    first = np.array([np.lexsort(triangle.T)[0] for triangle in corners])
    turned = np.stack([np.roll(triangle, -k, axis=0) for triangle, k in zip(corners, first, strict=True)])
    return turned[np.lexsort(turned.reshape(len(turned), -1).T)]


@pytest.mark.parametrize("name", GOOD)
def test_every_format_tells_the_same_mesh(tmp_path, name):
    """Four triangles on four vertices, each facing outwards, scaled."""
    mesh = read(tmp_path, name, GOOD[name], scale=(2, 2, 2))
    assert mesh.vertices.shape == (4, 3)
    expected = shape_of(type(mesh)(2.0 * CORNERS, SIDES.astype(int)))
    np.testing.assert_allclose(shape_of(mesh), expected, atol=1e-6)  # single precision in the files


@pytest.mark.parametrize("kind", ["stl", "obj", "dae"])
def test_published_meshes_are_read_as_pinocchio_reads_them(kind):
    """Of each format 20: as many triangles, and the same box."""
    folder = library.example_robot_data()
    files = [path for path in sorted(folder.rglob("*")) if path.suffix.lower() == f".{kind}"]
    files = [path for path in files if path.stat().st_size < 1e6]
    for path in files[:: max(1, len(files) // 20)]:
        mesh, theirs = read_mesh(path), coal.MeshLoader().load(str(path), np.ones(3))
        theirs.computeLocalAABB()
        assert len(mesh.triangles) == theirs.num_tris, path
        size = np.ptp(mesh.vertices, axis=0).max()
        # single precision of either, after the few transformations of a node
        np.testing.assert_allclose(mesh.vertices.min(axis=0), theirs.aabb_local.min_, atol=1e-6 * size)
        np.testing.assert_allclose(mesh.vertices.max(axis=0), theirs.aabb_local.max_, atol=1e-6 * size)


def test_nodes_place_their_meshes(tmp_path):
    """The same chain of placements in COLLADA and glTF: turned by 90 deg about z, doubled, moved; twice."""
    chain = "<c:translate>1 2 3</c:translate><c:rotate>0 0 1 90</c:rotate><c:scale>2 2 2</c:scale>"
    inner = f"<c:node><c:matrix>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</c:matrix>{USE}</c:node>"
    collada = read(tmp_path, "a.dae", dae(nodes=f"<c:node>{chain}{inner}</c:node><c:node>{USE}</c:node>"))
    half = float(np.sqrt(0.5))
    outer = {"translation": [1, 2, 3], "rotation": [0, 0, half, half], "scale": [2, 2, 2], "children": [1]}
    moved = {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]}
    nodes = {"nodes": [outer, moved, {"mesh": 0}], "scenes": [{"nodes": [0, 2]}]}
    other = read(tmp_path, "a.gltf", gltf(**nodes))
    x, y, z = CORNERS.T
    placed = np.stack([1 - 2 * y, 2 + 2 * (x + 5), 3 + 2 * z], axis=1)
    for mesh in (collada, other):
        assert len(mesh.triangles) == 8
        found = {tuple(np.round(vertex, 5)) for vertex in mesh.vertices}
        assert found == {
            tuple(np.round(vertex, 5)) for vertex in (*placed.astype(float), *CORNERS.astype(float))
        }


def test_an_object_file_does_not_open_its_materials(tmp_path):
    """A pipe in their place would have a reader of it wait for ever."""
    os.mkfifo(tmp_path / "paint.mtl")
    assert len(read(tmp_path, "a.obj", obj()).triangles) == 4


OUTSIDE = "../outside.bin"
FOREIGN = {
    "a.gltf": (gltf(uri=OUTSIDE), "refers to another file"),
    "b.gltf": (gltf(uri="file:///etc/passwd"), "refers to another file"),
    "a.glb": (glb(gltf_document(OUTSIDE)), "refers to another file"),
    "a.dae": (dae(nodes='<c:node><c:instance_geometry url="../outside.dae#g"/></c:node>'), "to another file"),
    "b.dae": (dae(nodes='<c:node><c:instance_node url="../outside.dae#n"/></c:node>'), "to another file"),
    "c.dae": (dae().replace(b'source="#s"', b'source="../outside.dae#s"'), "refers to another file"),
    "d.dae": (
        dae().replace(b'"1.0"?>', b'"1.0"?><!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]>'), "DTD",
    ),
    **{
        f"a{suffix}": (b"LWSC\n1\nLoadObject ../outside.stl\n", "expected one of the formats .stl")
        for suffix in (".lws", ".irr", ".ply", ".zae", ".3ds", ".blend", ".x3d", ".fbx", ".ifc", "")
    },
}  # fmt: skip


@pytest.mark.parametrize("name", FOREIGN)
def test_what_lies_in_another_file_is_refused(tmp_path, name):
    contents, said = FOREIGN[name]
    (tmp_path / "outside.stl").write_bytes(stl())
    (tmp_path / "in").mkdir()
    with pytest.raises(MeshError, match=said) as caught:
        read(tmp_path / "in", name, contents)
    assert str(tmp_path / "in" / name) in str(caught.value)


def test_what_is_no_regular_file_or_too_large_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "device.stl").symlink_to("/dev/zero")
    (tmp_path / "folder.stl").mkdir()
    for name in ("pipe", "device", "folder"):
        with pytest.raises(MeshError, match="is no regular file"):
            read_mesh(tmp_path / f"{name}.stl")
    with (tmp_path / "large.stl").open("wb") as file:
        file.truncate(8 << 30)
    with pytest.raises(MeshError, match=f"has more than {MOST_BYTES} bytes"):
        read_mesh(tmp_path / "large.stl")


FAR = np.where(CORNERS == 0, np.float32(0), np.float32(1e30))
GONE = np.where(CORNERS == 0, np.float32(0), np.float32(np.nan))
DOUBLING = "".join(
    f'<c:node id="n{k}"><c:instance_node url="#n{k + 1}"/><c:instance_node url="#n{k + 1}"/></c:node>'
    for k in range(40)
)
BOMBS = {
    "nested.dae": (dae(nodes="<c:node>" * 3000 + USE + "</c:node>" * 3000), "elements within each other"),
    "doubling.dae": (
        dae(
            nodes='<c:node><c:instance_node url="#n0"/></c:node>',
            library=f'<c:library_nodes>{DOUBLING}<c:node id="n40">{USE}</c:node></c:library_nodes>',
        ), "more than 10000 nodes",
    ),
    "circle.dae": (
        dae(
            nodes='<c:node><c:instance_node url="#n"/></c:node>',
            library='<c:library_nodes><c:node id="n"><c:instance_node url="#n"/></c:node></c:library_nodes>',
        ), "more than 10000 nodes",
    ),
    "elements.dae": (dae(nodes="<c:node/>" * 300_000), "more than 200000 elements"),
    "circle.gltf": (gltf(nodes=[{"children": [0, 0]}]), "more than 10000 nodes"),
    "nested.gltf": (b"[" * 500_000, "not a mesh in this format"),
    "values.gltf": (b"[" + b"0," * 2_000_000 + b"0]", "more than 1000000 values"),
    "beyond.gltf": (
        gltf(accessors=[{"bufferView": 0, "componentType": 5126, "count": 10**9, "type": "VEC3"}] * 2),
        "size of buffer",
    ),
    "empty.gltf": (
        gltf(accessors=[{"componentType": 5126, "count": 10**9, "type": "VEC3"}] * 2),
        "bufferView",
    ),
    "blank.stl": (b"solid\n" + b" \n" * 10_000_000, "holds no triangles"),
    "blank.obj": (b"\n" * 10_000_000, "more than 4000000 lines"),
    "wide.obj": (obj() + b"f" + b" 1" * 10_000_000, "not a mesh in this format"),
    "declared.stl": (stl()[:80] + struct.pack("<I", 2**31) + stl()[84:], f"more than {MOST_TRIANGLES} tri"),
    "large.stl": (stl(sides=np.zeros((MOST_TRIANGLES + 1, 3), int)), f"more than {MOST_TRIANGLES} tri"),
    "large.obj": (obj() + b"f 1 2 3\n" * MOST_TRIANGLES, f"more than {MOST_TRIANGLES} tri"),
    "far.stl": (stl(FAR), "within 10000 m"),
    "nan.stl": (stl(GONE), "finite"),
    "nan.dae": (dae(corners=GONE), "finite"),
    "missing.obj": (obj() + b"f 1 2 9\n", "a corner that is none of the 4 vertices"),
    "zero.obj": (obj().replace(b"f 2 3 4", b"f 2 3 0") + b"v 0 0 0\n", "a face has vertex 0"),
    "capitals.stl": (
        b"SOLID" + b"\nVERTEX 0 0 0" * 3 * (MOST_TRIANGLES + 1), f"more than {MOST_TRIANGLES} tri",
    ),
    "before.obj": (b"f -1 -2 -3\n" + obj(), "a corner that is none"),
    "missing.dae": (dae(parts=TRIANGLE.replace("2 0 1 0", "2 0 9 0")), "a corner that is none"),
    "cut.stl": (stl()[:-1], "too short for its 4 triangles"),
    "line.stl": (stl(np.zeros_like(CORNERS)), "holds no triangles"),
    "nothing.obj": (b"", "holds no triangles"),
    "nothing.dae": (dae(nodes=""), "holds no triangles"),
    "nothing.stl": (b"", "not a mesh in this format"),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_what_is_out_of_bounds_or_broken_is_refused_soon(tmp_path, name):
    contents, said = BOMBS[name]
    before = time.process_time()
    with pytest.raises(MeshError, match=said) as caught:
        read(tmp_path, name, contents)
    assert time.process_time() - before < SECONDS
    assert str(tmp_path / name) in str(caught.value)


def test_many_parts_take_time_in_proportion(tmp_path):
    """2,000 parts on shared vertices, which took 10 s, and 9,000 uses of one part."""
    before = time.process_time()
    assert len(read(tmp_path, "parts.dae", dae(parts=TRIANGLE * 2000)).triangles) == 2000
    nodes = "".join(f"<c:node><c:translate>{k} 0 0</c:translate>{USE}</c:node>" for k in range(9000))
    assert len(read(tmp_path, "uses.dae", dae(parts=TRIANGLE, nodes=nodes)).triangles) == 9000
    assert time.process_time() - before < SECONDS


@given(
    name=st.sampled_from(sorted(GOOD)),
    place=st.floats(0, 1, exclude_max=True),
    put=st.binary(min_size=1, max_size=6),
    cut=st.integers(0, 6),
)
def test_no_damage_raises_anything_but_a_mesh_error(tmp_path_factory, name, place, put, cut):
    contents = GOOD[name]
    k = int(place * len(contents))
    path = Path(tmp_path_factory.getbasetemp()) / name
    path.write_bytes(contents[:k] + put + contents[k + cut :])
    try:
        mesh = read_mesh(path)
    except MeshError:
        return
    assert np.isfinite(mesh.vertices).all()
    assert set(np.unique(mesh.triangles)) == set(range(len(mesh.vertices)))


def test_the_formats_are_told():
    assert set(READERS) == {".stl", ".obj", ".dae", ".gltf", ".glb"}
    assert issubclass(MeshError, ea.EladaptError)
