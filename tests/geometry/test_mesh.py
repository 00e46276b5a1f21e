"""Meshes: what is read, what is refused, and with which words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pftwin.base.errors import InputError, OutputError
from pftwin.geometry.mesh.mesh import SurfaceMesh, check_mesh, load_mesh, save_mesh


@pytest.fixture
def box() -> tuple[np.ndarray, np.ndarray]:
    """A closed box of 30 x 40 x 50 mm, outward."""
    import trimesh

    b = trimesh.creation.box((0.03, 0.04, 0.05))
    return np.asarray(b.vertices), np.asarray(b.faces)


def sheet(n: int = 12, size: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """An open flat sheet that looks along z."""
    x = np.linspace(0, size, n)
    vertices = np.stack([*(g.ravel() for g in np.meshgrid(x, x, indexing="ij")), np.zeros(n * n)], axis=1)
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def test_box_has_the_area_volume_and_normals_of_a_box(box):
    mesh = check_mesh(*box)
    assert mesh.is_closed
    np.testing.assert_allclose(mesh.area, 2 * (0.03 * 0.04 + 0.03 * 0.05 + 0.04 * 0.05))
    np.testing.assert_allclose(mesh.volume, 0.03 * 0.04 * 0.05)
    np.testing.assert_allclose(mesh.vertex_areas.sum(), mesh.area)
    assert (np.einsum("ij,ij->i", mesh.vertices, mesh.vertex_normals) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1)


def test_normals_are_weighted_by_area():
    tall, low = 0.04, 0.01  # two triangles on the edge along y, at a right angle
    vertices = np.array([[0, 0, 0], [0, 0.03, 0], [-tall, 0, 0], [0, 0, -low]])
    mesh = check_mesh(vertices, [[0, 1, 2], [1, 0, 3]])
    shared = mesh.vertex_normals[np.argmin(np.linalg.norm(mesh.vertices - vertices[0], axis=1))]
    expected = np.array([low, 0, tall]) / np.hypot(low, tall)
    np.testing.assert_allclose(shared, expected, atol=1e-12)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
@pytest.mark.parametrize("units", ["m", "mm"])
def test_round_trip_in_every_format(tmp_path, suffix, units):
    mesh = check_mesh(*sheet())
    save_mesh(mesh, tmp_path / f"sheet.{suffix}", units=units)
    back = load_mesh(tmp_path / f"sheet.{suffix}", units=units)
    assert (back.vertices.shape, back.faces.shape) == (mesh.vertices.shape, mesh.faces.shape)
    np.testing.assert_allclose(back.area, 0.05**2, rtol=1e-5)
    np.testing.assert_allclose(back.vertex_normals, np.tile([0, 0, 1.0], (len(back.vertices), 1)), atol=1e-6)
    assert not back.is_closed
    assert [p.name for p in tmp_path.iterdir()] == [f"sheet.{suffix}"]


def test_ascii_stl_is_read_and_its_vertices_merged(tmp_path):
    def facet(*corners: str) -> str:
        return "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {c}\n" for c in corners) + "endloop\nendfacet\n"

    text = f"solid a\n{facet('0 0 0', '40 0 0', '40 30 0')}{facet('0 0 0', '40 30 0', '0 30 0')}endsolid a\n"
    (tmp_path / "a.stl").write_text(text)
    mesh = load_mesh(tmp_path / "a.stl", units="mm")
    assert len(mesh.vertices) == 4
    np.testing.assert_allclose(mesh.area, 0.04 * 0.03)


def binary_stl(tmp_path: Path) -> bytes:
    save_mesh(check_mesh(*sheet()), tmp_path / "whole.stl")
    return (tmp_path / "whole.stl").read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.stl", b"", "the file is empty"),
        ("blank.obj", b" \n\n", "the file is empty"),
        ("noise.stl", bytes(range(128, 256)) * 40, "truncated or damaged binary STL"),
        ("noise.ply", bytes(range(128, 256)) * 40, "not a readable PLY mesh"),
        ("noise.obj", bytes(range(128, 256)) * 40, "no triangles"),
        ("words.stl", b"hello world\n", "no triangles"),
        ("points.obj", b"v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\n", "no triangles"),
        ("index.obj", b"v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 9\n", "index.obj"),
        (
            "nan.obj",
            b"v 0 0 0\nv nan 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 3\nf 1 3 4\n",
            "1 of 4 vertices are not finite",
        ),
        ("flat.obj", b"v 0 0 0\nv 0.05 0 0\nv 0.1 0 0\nf 1 2 3\n", "have no area"),
        ("mesh.step", b"ISO-10303-21;", "unknown mesh format .step"),
        (
            "letters.stl",
            b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 x\n"
            b"vertex 0 1 0\nvertex 1 1 0\nendloop endfacet endsolid",
            "not a readable STL mesh",
        ),
        (
            "cut.stl",
            b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 1 0\nendloop\nendfacet\nfac",
            "truncated text STL",
        ),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        load_mesh(tmp_path / name, units="m")
    assert name in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"gone\.stl: no such file"):
        load_mesh(tmp_path / "gone.stl", units="mm")


def test_truncated_binary_stl_says_how_much_is_missing(tmp_path):
    data = binary_stl(tmp_path)
    (tmp_path / "half.stl").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="promises 242 triangles, 120 follow"):
        load_mesh(tmp_path / "half.stl", units="m")


def text_ply(vertices: str, faces: str) -> bytes:
    corners = "0 0 0\n0.05 0 0\n0 0.05 0\n"
    about = "property float x\nproperty float y\nproperty float z\n"
    lists = "property list uchar int vertex_indices\nend_header\n"
    head = f"ply\nformat ascii 1.0\nelement vertex {vertices}\n{about}element face {faces}\n{lists}"
    return (head + corners + "3 0 1 2\n").encode()


def test_a_text_ply_keeps_the_promises_of_its_header(tmp_path):
    file = tmp_path / "a.ply"
    file.write_bytes(text_ply("3", "1"))
    assert len(load_mesh(file, units="m").faces) == 1
    file.write_bytes(text_ply("3", "1000000000000"))
    with pytest.raises(InputError, match=r"promises 3 of vertex and 1000000000000 of face, 4 lines follow"):
        load_mesh(file, units="m")
    for count in ("-3", "many", 5000 * "9"):
        file.write_bytes(text_ply("3", count))
        with pytest.raises(InputError, match="does not say how many vertices and faces there are"):
            load_mesh(file, units="m")


def test_a_binary_ply_keeps_them_too(tmp_path):
    file = tmp_path / "a.ply"
    save_mesh(check_mesh(*sheet()), file)
    data = file.read_bytes()
    assert b"format binary" in data
    for old, new in ((b"element face 242", b"element face 243"), (b"element face 242", b"element face 99999999999999")):
        assert old in data
        file.write_bytes(data.replace(old, new))
        with pytest.raises(InputError, match="not a readable PLY mesh"):
            load_mesh(file, units="m")


def test_wrong_units_are_noticed_and_the_right_ones_named(tmp_path):
    save_mesh(check_mesh(*sheet()), tmp_path / "a.stl", units="mm")
    with pytest.raises(InputError, match=r"50 m = 5e\+04 mm is implausible.*between 20 and 200 mm.*units='mm'"):
        load_mesh(tmp_path / "a.stl", units="m")
    with pytest.raises(InputError, match="unknown length unit 'furlong'"):
        load_mesh(tmp_path / "a.stl", units="furlong")
    assert load_mesh(tmp_path / "a.stl", units="m", size=None).extent == pytest.approx(50)


def test_mixed_normals_are_counted_and_can_be_repaired():
    vertices, faces = sheet()
    mixed = faces.copy()
    mixed[40:47] = mixed[40:47, ::-1]
    with pytest.raises(InputError, match=r"mixed normals: 7 of 242 triangles.*repair=True"):
        check_mesh(vertices, mixed)
    repaired = check_mesh(vertices, mixed, repair=True)
    np.testing.assert_allclose(repaired.vertex_normals[:, 2], 1)


def test_inside_out_closed_mesh(box):
    vertices, faces = box
    with pytest.raises(InputError, match=r"flipped normals.*volume -60 cm\^3"):
        check_mesh(vertices, faces[:, ::-1])
    assert check_mesh(vertices, faces[:, ::-1], repair=True).volume > 0


def test_a_moebius_strip_has_no_sides_to_choose():
    n = 30
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    edges = [
        np.stack([(0.03 + w * np.cos(t / 2)) * np.cos(t), (0.03 + w * np.cos(t / 2)) * np.sin(t), w * np.sin(t / 2)], 1)
        for w in (-0.01, 0.01)
    ]
    k, after = np.arange(n), np.roll(np.arange(n), -1)
    low, high = k, k + n
    low_after, high_after = after.copy(), after + n
    low_after[-1], high_after[-1] = n, 0  # half a turn
    faces = np.concatenate([np.stack([low, low_after, high], 1), np.stack([low_after, high_after, high], 1)])
    with pytest.raises(InputError, match="no choice of sides"):
        check_mesh(np.concatenate(edges), faces, repair=True)


def test_faces_that_name_absent_vertices():
    with pytest.raises(InputError, match="a face names vertex 7, but there are 3"):
        check_mesh(np.eye(3) * 0.05, [[0, 1, 7]])


def test_unwritable_place(tmp_path):
    mesh = check_mesh(*sheet())
    with pytest.raises(OutputError, match=r"folder\.stl: cannot be written: there is no folder"):
        save_mesh(mesh, tmp_path / "no" / "such" / "folder.stl")
    with pytest.raises(InputError, match="unknown mesh format"):
        save_mesh(mesh, tmp_path / "mesh.docx")


def test_flipped_turns_every_normal():
    mesh = check_mesh(*sheet())
    assert isinstance(mesh.flipped(), SurfaceMesh)
    np.testing.assert_allclose(mesh.flipped().vertex_normals, -mesh.vertex_normals)


def test_dm_meshes_are_read(dm_knee):
    femur = load_mesh(dm_knee / "femoral_component_contact.stl", units="m")
    assert femur.faces.shape == (24960, 3)
    assert not femur.is_closed
    bone = load_mesh(dm_knee / "patella.stl", units="m")
    assert bone.is_closed
    assert 10e-6 < bone.volume < 30e-6
    with pytest.raises(InputError, match="units='m'"):
        load_mesh(dm_knee / "patella.stl", units="mm")
