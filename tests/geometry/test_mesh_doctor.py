"""The mesh doctor: every disease by name, what is repaired, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.geometry.mesh import files
from pftwin.geometry.mesh.doctor import Diagnosis, examine, examine_file, repaired
from pftwin.geometry.mesh.mesh import SurfaceMesh, check_mesh, load_mesh, save_mesh
from pftwin.geometry.patch.implant import rig_implant
from pftwin.geometry.patch.region import principal_axes
from pftwin.results.plots.region import plot_principal


def ball(radius: float = 0.025) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    mesh = trimesh.creation.icosphere(3, radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def cup() -> tuple[np.ndarray, np.ndarray]:
    """An open half of the ball, in numbers as a file in millimetres has them."""
    p, f = ball(25.0)
    return p, f[(p[f][:, :, 2] > -1e-9).all(axis=1)]


def kinds(found: Diagnosis) -> dict[str, int]:
    return {f.kind: f.count for f in found.findings}


def joined(*meshes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(p) for p, _ in meshes)])
    faces = np.concatenate([f + start for (_, f), start in zip(meshes, starts[:-1], strict=True)])
    return np.concatenate([p for p, _ in meshes]), faces


def test_healthy_meshes_have_no_findings():
    closed, opened = examine(*ball()), examine(*cup())
    assert not closed.findings
    assert not opened.findings
    assert (closed.verdict, opened.verdict) == ("usable", "usable")
    assert closed.units == ["m"]
    assert opened.units == ["mm"]
    assert not closed.parts[0].loops
    assert closed.parts[0].volume == pytest.approx(4 / 3 * np.pi * 0.025**3, rel=0.02)
    (rim,) = opened.parts[0].loops
    assert not rim.is_hole
    assert rim.length == pytest.approx(2 * np.pi * 25, rel=0.2)  # it runs in zigzag


def test_doubled_and_empty_triangles_are_dropped():
    p, f = cup()
    sliver = [f[0, 0], f[0, 1], len(p)]  # a point on an edge
    p_bad = np.concatenate([p, 0.5 * (p[f[0, :1]] + p[f[0, 1:2]])])
    f_bad = np.concatenate([f, f[3:5], np.roll(f[7:8], 1, axis=1), [sliver], [[f[0, 0], f[0, 0], f[0, 1]]]])
    assert kinds(examine(p_bad, f_bad)) == {"zero_area": 2, "duplicate": 3}
    mesh, after = repaired(p_bad, f_bad)
    assert after.verdict == "usable"
    np.testing.assert_allclose(mesh.area, SurfaceMesh(p, f).area, rtol=1e-14)
    assert len(mesh.faces) == len(f)


@pytest.mark.parametrize("make", [ball, cup])
def test_mixed_winding_is_turned_to_where_most_face(make):
    p, f = make()
    mixed = f.copy()
    mixed[5:25] = mixed[5:25, ::-1]
    assert kinds(examine(p, mixed)) == {"mixed_winding": 20}
    mesh, after = repaired(p, mixed)
    assert not after.findings
    assert (np.einsum("ij,ij->i", mesh.area_vectors, mesh.vertices[mesh.faces].mean(axis=1)) > 0).all()


def test_an_inside_out_ball_is_turned_and_an_inside_out_cup_is_left():
    p, f = ball()
    backward = f[:, ::-1].copy()
    backward[:9] = f[:9]
    assert kinds(examine(p, backward)) == {"mixed_winding": 9, "flipped": len(f)}
    assert repaired(p, backward)[0].volume > 0
    q, g = cup()
    mesh, after = repaired(q, g[:, ::-1])
    assert kinds(after) == {"inward": len(g)}
    assert after.verdict == "usable"
    np.testing.assert_allclose(mesh.area_vectors.sum(axis=0)[2], -SurfaceMesh(q, g).area_vectors.sum(axis=0)[2])


def test_an_open_surface_without_a_majority_is_refused():
    p, f = cup()
    torn = f.copy()
    torn[::3] = torn[::3, ::-1]
    assert kinds(examine(p, torn))["ambiguous_winding"] == len(f)
    with pytest.raises(InputError, match=r"ambiguous_winding: an open surface of .*would change the answer"):
        repaired(p, torn)


def test_a_cavity_is_not_turned():
    p, f = joined(ball(0.03), (ball(0.01)[0], ball(0.01)[1][:, ::-1]))
    found = examine(p, f)
    assert kinds(found) == {"cavity": 1280, "isolated_part": 1}
    assert repaired(p, f)[0].volume == pytest.approx(SurfaceMesh(p, f).volume)


def test_holes_are_found_measured_and_left_open():
    p, f = ball()
    near = np.linalg.norm(p[f].mean(axis=1) - p[0], axis=1) < 1e-3 * 3
    found = examine(p, f[~near])
    assert kinds(found) == {"hole": 1}
    np.testing.assert_allclose(found.findings[0].places[0], p[0], atol=1e-3)
    (loop,) = found.parts[0].loops
    assert (loop.n_edges, loop.is_hole) == (int(near.sum()), True)
    mesh, _ = repaired(p, f[~near])
    assert len(mesh.faces) == len(f) - near.sum()


def test_a_third_sheet_on_an_edge_and_a_two_faced_sheet_are_refused():
    p, f = cup()
    top = f[np.argmax(p[f][:, :, 2].mean(axis=1))]
    fin = np.array([[top[0], top[1], len(p)]])
    p_fin = np.concatenate([p, 1.3 * p[top[:1]]])
    assert kinds(examine(p_fin, np.concatenate([f, fin])))["non_manifold_edge"] == 1
    with pytest.raises(InputError, match="non_manifold_edge: 1 edges"):
        repaired(p_fin, np.concatenate([f, fin]))
    both = np.concatenate([f, f[:4, ::-1]])
    assert kinds(examine(p, both))["two_faced"] == 8
    with pytest.raises(InputError, match="two_faced"):
        repaired(p, both)


def test_debris_is_reported_but_not_removed():
    p, f = joined(ball(0.03), (0.05 + 0.05 * ball()[0], ball()[1]))
    found = examine(p, f)
    assert kinds(found) == {"isolated_part": 1}
    assert "0.17 % of the area" in found.findings[0].words
    assert len(repaired(p, f)[0].faces) == len(f)


def test_one_sided_surfaces_are_fatal():
    k = np.arange(5)
    a = 2 * np.pi * k / 5
    strip = 0.05 * np.stack([np.cos(a), np.sin(a), 0.3 * np.cos(2 * a)], axis=1)
    found = examine(strip, np.stack([k, (k + 1) % 5, (k + 2) % 5], axis=1))  # the five-triangle Moebius strip
    assert "one_sided" in kinds(found)
    assert found.verdict.startswith("not to be used")


def test_scale_is_guessed_and_a_wrong_unit_named():
    p, f = cup()
    assert examine(p, f, units="mm").findings == []
    (finding,) = examine(p, f, units="m").findings
    assert finding.kind == "scale"
    assert finding.words.endswith("not the size of a part of the knee in m; in mm it is")
    assert "any unit" in examine(1e5 * p, f).findings[0].words


def test_what_is_not_finite_or_nowhere_is_fatal():
    p, f = cup()
    broken = p.copy()
    broken[f[0, 0]] = np.nan
    assert kinds(examine(broken, f)) == {"not_finite": 1}
    assert kinds(examine(np.zeros((3, 3)), [[0, 1, 2]])) == {"no_surface": 1}


def test_huge_files_are_refused_before_they_are_read(tmp_path, monkeypatch):
    save_mesh(check_mesh(*ball()), tmp_path / "ball.stl")
    save_mesh(check_mesh(*ball()), tmp_path / "ball.ply")
    monkeypatch.setattr(files, "MESH_TRIANGLES", 1000)
    for name in ("ball.stl", "ball.ply"):
        with pytest.raises(InputError, match=rf"{name}: 1280 triangles; expected: at most 1000"):
            load_mesh(tmp_path / name, units="m")
    monkeypatch.setattr(files, "MESH_BYTES", 10_000)
    with pytest.raises(InputError, match="the file has 0 MB; expected: at most 0 MB"):
        examine_file(tmp_path / "ball.stl")


def command(*arguments: object):
    return CliRunner().invoke(
        app, ["doctor-mesh", *(str(a) for a in arguments)], env={"COLUMNS": "160", "NO_COLOR": "1"}
    )


def test_the_command_reports_repairs_and_refuses(tmp_path):
    p, f = cup()
    mixed = f.copy()
    mixed[:7] = mixed[:7, ::-1]
    save_mesh(SurfaceMesh(p, mixed), tmp_path / "cup.obj")
    before = (tmp_path / "cup.obj").read_bytes()
    refused = command(tmp_path / "cup.obj", "--repair", tmp_path / "sub" / ".." / "cup.obj")
    assert refused.exit_code == 2
    assert (tmp_path / "cup.obj").read_bytes() == before
    result = command(tmp_path / "cup.obj", "--repair", tmp_path / "healed.ply", "--json", tmp_path / "o.json")
    assert result.exit_code == 0, result.output
    assert "7 triangles face the other side than their neighbours" in result.stdout
    assert "likely unit: mm" in result.stdout
    assert "verdict: to be repaired: mixed_winding (--repair does it)" in result.stdout
    facts = json.loads((tmp_path / "o.json").read_text())
    assert facts["findings"][0]["kind"] == "mixed_winding"
    assert facts["repaired"]["verdict"] == "usable"
    assert load_mesh(tmp_path / "healed.ply", units="mm").area == pytest.approx(1e-6 * SurfaceMesh(p, f).area)
    save_mesh(SurfaceMesh(p, np.concatenate([f, f[:4, ::-1]])), tmp_path / "two.ply")
    refused = command(tmp_path / "two.ply", "--repair", tmp_path / "no.ply")
    assert refused.exit_code == 2
    assert "error: " in refused.stderr
    assert "two_faced" in refused.stderr
    assert not (tmp_path / "no.ply").exists()
    assert command(tmp_path / "two.ply", "--units", "ell").exit_code == 2


def box(*sides: float) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    mesh = trimesh.creation.box(sides)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def test_principal_directions_of_a_turned_box_are_its_edges():
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    p, f = box(0.02, 0.06, 0.035)
    axes = principal_axes(SurfaceMesh(p @ turn.T + [1.0, 2.0, 3.0], f))
    for axis, column, length in zip(axes, (1, 2, 0), (0.06, 0.035, 0.02), strict=True):
        assert abs(axis.direction @ turn[:, column]) == pytest.approx(1, abs=1e-12)
        assert axis.extent == pytest.approx(length, rel=1e-12)
    assert np.linalg.det([axis.direction for axis in axes]) == pytest.approx(1)


def test_the_command_proposes_the_axes_along_which_there_is_a_groove(tmp_path):
    mesh = rig_implant().mesh(deviation=0.05e-3)
    swapped = np.stack([-mesh.vertices[:, 2], mesh.vertices[:, 0], -mesh.vertices[:, 1]], axis=1)
    save_mesh(SurfaceMesh(1e3 * swapped, mesh.faces), tmp_path / "femur.stl")
    result = command(tmp_path / "femur.stl", "-o", tmp_path / "axes.png", "--json", tmp_path / "o.json")
    assert result.exit_code == 0, result.output
    assert "a groove along --anterior=-x --proximal=+y" in result.stdout
    assert "principal" not in result.stdout
    found = json.loads((tmp_path / "o.json").read_text())["axes"]
    assert (found["unit"], found["grooves"][0]["anterior"], found["grooves"][0]["proximal"]) == ("mm", "-x", "+y")
    assert (tmp_path / "axes.png").read_bytes().startswith(b"\x89PNG")


def test_without_a_groove_it_gives_the_principal_directions(tmp_path):
    save_mesh(SurfaceMesh(*box(20.0, 60.0, 35.0)), tmp_path / "box.stl")
    result = command(tmp_path / "box.stl", "--units", "mm", "-o", tmp_path / "axes.png")
    assert result.exit_code == 0, result.output
    assert "no trochlear groove is found" in result.stdout
    assert "principal direction 1: (0.000, 1.000, 0.000), 60.0 mm long" in result.stdout
    assert "principal direction 3: (1.000, 0.000, 0.000), 20.0 mm long" in result.stdout
    assert (tmp_path / "axes.png").read_bytes().startswith(b"\x89PNG")


def test_no_axes_are_computed_for_an_unusable_mesh(tmp_path):
    p, f = box(1.0, 3.0, 2.0)
    save_mesh(SurfaceMesh(1e7 * p, f), tmp_path / "huge.stl")
    assert "no axes computed: no unit suits its size" in command(tmp_path / "huge.stl").stdout
    save_mesh(SurfaceMesh(20 * p, np.concatenate([f, f[:1, ::-1]])), tmp_path / "bad.ply")
    picture = tmp_path / "axes.png"
    refused = command(tmp_path / "bad.ply", "-o", picture)
    assert refused.exit_code == 3
    assert "no axes computed: the mesh is not to be used" in refused.stdout
    assert not picture.exists()


def test_the_three_views_name_the_meshs_own_axes():
    mesh = SurfaceMesh(*box(0.02, 0.06, 0.035))
    views = plot_principal(principal_axes(mesh), mesh).axes
    assert [sorted(t.get_text() for t in view.texts) for view in views] == [["+y", "+z"], ["+x", "+z"], ["+x", "+y"]]
    assert views[0].get_xlabel() == "along (0.00, 1.00, 0.00) [mm]"


def test_dm_meshes_are_healthy(dm_knee):
    for name, closed in (("femoral_component_contact", False), ("patellar_button_contact", False), ("patella", True)):
        found = examine_file(dm_knee / f"{name}.stl")
        assert not found.findings, name
        assert (not found.parts[0].loops) == closed
        assert found.units == ["m"]
