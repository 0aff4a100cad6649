"""Files written and read back by others."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from plyfile import PlyData

from mpf_core.errors import NoSurface
from mpf_core.surface.export import glb_bytes, write_glb, write_ply
from mpf_core.surface.mesh import Mesh
from mpf_core.surface.normals import vertex_normals
from tests import gltf

UTM = np.array([448_262.125, 5_411_932.5, 312.0])


def sphere(shift: Any = 0.0, *, colored: bool = False) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=3)
    vertices = np.array(made.vertices) * 40 + shift
    ramp = np.arange(3 * len(vertices)).reshape(-1, 3) % 256
    colors = ramp.astype(np.uint8) if colored else None
    return Mesh(vertices, np.array(made.faces, np.int64), np.array(made.vertices), colors)


def test_glb_keeps_millimetres_in_utm(tmp_path: Path) -> None:
    mesh = sphere(UTM)
    write_glb(mesh, tmp_path / "a.glb")
    read = trimesh.load_mesh(tmp_path / "a.glb", process=False)
    assert np.abs(read.vertices - mesh.vertices).max() < 1e-5
    assert np.array_equal(read.faces, mesh.faces)
    _, normals = attribute((tmp_path / "a.glb").read_bytes(), "NORMAL")
    assert np.abs(normals - mesh.normals).max() < 1e-6


def attribute(content: bytes, name: str) -> tuple[dict[str, Any], Any]:
    """The JSON of a GLB and one vertex attribute of its only mesh."""
    length = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20 : 20 + length])
    index = document["meshes"][0]["primitives"][0]["attributes"][name]
    accessor = document["accessors"][index]
    start = 28 + length + document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    kind = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
    width = {"VEC3": 3, "VEC4": 4}[accessor["type"]]
    values = np.frombuffer(content, kind, width * accessor["count"], start)
    return document, values.reshape(-1, width)


def test_glb_material_and_colors() -> None:
    mesh = sphere(colored=True)
    document, stored = attribute(glb_bytes(mesh, name="ball"), "COLOR_0")
    assert document["nodes"][0]["name"] == "ball"
    (material,) = document["materials"]
    assert material["doubleSided"] is True
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert material["pbrMetallicRoughness"]["roughnessFactor"] == 0.8
    linear = stored[:, :3] / 65535
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.array_equal(np.round(255 * srgb), mesh.colors)
    assert (stored[:, 3] == 65535).all()


def test_glb_makes_normals_when_there_are_none() -> None:
    mesh = sphere()
    _, normals = attribute(glb_bytes(Mesh(mesh.vertices, mesh.faces)), "NORMAL")
    assert np.abs(normals - mesh.normals).max() < 0.01


def test_ply_through_two_readers(tmp_path: Path) -> None:
    mesh = sphere(UTM, colored=True)
    write_ply(mesh, tmp_path / "a.ply")
    vertex = PlyData.read(tmp_path / "a.ply")["vertex"]
    assert vertex["x"].dtype == np.float64
    assert np.array_equal(np.stack([vertex[a] for a in "xyz"], 1), mesh.vertices)
    assert vertex["nx"].dtype == np.float32
    assert np.array_equal(np.stack([vertex[c] for c in ("red", "green", "blue")], 1), mesh.colors)
    read = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    assert np.array_equal(read.vertices, mesh.vertices)
    assert np.array_equal(read.faces, mesh.faces)
    assert np.array_equal(read.visual.vertex_colors[:, :3], mesh.colors)


def test_bare_ply_has_coordinates_only(tmp_path: Path) -> None:
    mesh = sphere()
    write_ply(Mesh(mesh.vertices, mesh.faces), tmp_path / "a.ply")
    read = PlyData.read(tmp_path / "a.ply")
    assert [p.name for p in read["vertex"].properties] == ["x", "y", "z"]


def test_nothing_is_written_for_a_mesh_without_faces(tmp_path: Path) -> None:
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    for write in (write_glb, write_ply):
        with pytest.raises(NoSurface):
            write(empty, tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.ply"
    target.mkdir()
    with pytest.raises(OSError):
        write_ply(sphere(), target)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def test_vertex_normals_of_a_cube_do_not_depend_on_its_diagonals() -> None:
    cube = trimesh.creation.box((2, 2, 2))
    normals = vertex_normals(Mesh(np.array(cube.vertices), np.array(cube.faces)))
    assert np.allclose(normals, cube.vertices / np.sqrt(3))


def test_vertex_normals_are_unit_even_without_faces() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5], [2, 0, 0]])
    mesh = Mesh(vertices, np.array([[0, 2, 1], [0, 1, 4]]))
    assert np.allclose(np.linalg.norm(vertex_normals(mesh), axis=1), 1)
    assert np.allclose(vertex_normals(mesh)[2], [0, 0, -1])


@pytest.mark.parametrize("colored", [False, True])
def test_glb_passes_the_validator_of_khronos(tmp_path: Path, colored: bool) -> None:
    assert gltf.is_installed(), "scripts/setup installs the validator"
    write_glb(sphere(UTM, colored=colored), tmp_path / "a.glb")
    gltf.assert_valid(tmp_path / "a.glb")


def test_the_validator_is_one_that_finds_faults(tmp_path: Path) -> None:
    content = glb_bytes(sphere())
    broken = content.replace(b'"count":642', b'"count":600')
    bounds = content.replace(b'"min":[-40.0,', b'"min":[-41.0,')
    for name, wrong in (("broken", broken), ("bounds", bounds)):
        assert wrong != content
        (tmp_path / name).write_bytes(wrong)
    assert all(found["numErrors"] > 0 for found in gltf.issues(sorted(tmp_path.iterdir())))


def test_ply_in_open3d(tmp_path: Path) -> None:
    """Open3D needs libusb, which scripts/test brings where it may."""
    open3d = pytest.importorskip(
        "open3d", reason="open3d, which is optional, cannot be loaded", exc_type=ImportError
    )
    mesh = sphere(UTM, colored=True)
    write_ply(mesh, tmp_path / "a.ply")
    read = open3d.io.read_triangle_mesh(str(tmp_path / "a.ply"))
    assert np.array_equal(np.asarray(read.vertices), mesh.vertices)
    assert np.array_equal(np.asarray(read.triangles), mesh.faces)
    assert np.abs(np.asarray(read.vertex_normals) - mesh.normals).max() < 1e-6
    assert np.array_equal(np.rint(np.asarray(read.vertex_colors) * 255), mesh.colors)
