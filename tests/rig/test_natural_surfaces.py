"""The natural knee's surfaces (made by formulas): closed, and measured on their triangles as a radiologist would."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from pftwin.base.errors import InputError
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.implicit import mesh_of
from pftwin.geometry.bones.patella import PatellaShape
from pftwin.geometry.bones.surfaces import bones
from pftwin.geometry.bones.tibiofemoral import FemurShape
from pftwin.geometry.mesh.doctor import examine
from pftwin.geometry.mesh.mesh import SurfaceMesh

KNEES = {
    "normal": Anatomy(),
    "other": Anatomy(
        sulcus_angle_deg=128,
        lateral_inclination_deg=28,
        facet_ratio=0.8,
        trochlear_depth_mm=7,
        trochlear_radius_mm=26,
        prominence_mm=-3,
        condyle_radius_mm=25,
        epicondylar_width_mm=88,
        patella_height_mm=47,
        patella_width_mm=49,
        patella_thickness_mm=27,
        ridge_angle_deg=120,
        wiberg_ratio=1.8,
        tt_tg_mm=18,
    ),
    **{kind: Anatomy.dejour(kind) for kind in "ABCD"},
}
RESOLUTION = 1.5
WIDE = {"sulcus_angle_deg": 168, "lateral_inclination_deg": 6, "facet_ratio": 0.25}


@pytest.fixture(scope="module", params=["normal", "other", "D"])
def knee(request):
    anatomy = KNEES[request.param]
    return anatomy, bones(anatomy, RESOLUTION)


def cut(mesh: SurfaceMesh, axis: int, level: float) -> np.ndarray:
    """Where the mesh's edges cross a plane (n, 3) [mm]."""
    p = 1e3 * mesh.vertices
    pairs = np.concatenate([mesh.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    a, b = p[pairs[:, 0]], p[pairs[:, 1]]
    crossed = (a[:, axis] > level) != (b[:, axis] > level)
    a, b = a[crossed], b[crossed]
    share = (level - a[:, axis]) / (b[:, axis] - a[:, axis])
    return a + share[:, None] * (b - a)


def axial(anatomy: Anatomy) -> dict[str, np.ndarray]:
    """Groove and ridges (y, z) in the axial cut through the trochlear axis: lowest point, and the highest beside it.

    Of the front of a slice of the femur, in triangles of 0.4 mm: coarse ones miss the highest place of a rounded ridge.
    """
    body = FemurShape(anatomy)
    low, high = (list(corner) for corner in body.box())
    low[0], high[0], low[2] = -2.4, 2.4, 3.0

    def slice_of(p: np.ndarray) -> np.ndarray:
        return np.min([body(p), 1.5 - np.abs(p[:, 0]), p[:, 2] - 4], axis=0)

    femur = mesh_of(slice_of, tuple(low), tuple(high), 0.4, "slice")
    section = cut(femur, 0, 1e-4)
    front = section[section[:, 2] > 5][:, 1:]
    groove = front[np.abs(front[:, 0]) < 2.5]
    groove = groove[np.argmin(groove[:, 1])]
    sides = {"lateral": front[front[:, 0] > 2.5], "medial": front[front[:, 0] < -2.5]}
    return {name: side[np.argmax(side[:, 1])] - groove for name, side in sides.items()}


def test_all_are_closed_and_sound(knee):
    import trimesh

    for mesh in knee[1]:
        assert mesh.is_closed
        assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight
        found = examine(mesh.vertices, mesh.faces, source=mesh.source, units="m")
        assert not [f for f in found.findings if f.severity == "error"], found.verdict
        assert mesh.volume > 0


@pytest.mark.parametrize("anatomy", KNEES.values(), ids=KNEES)
def test_the_axial_cut_has_the_sulcus_angle_depth_and_facets_asked_for(anatomy):
    at = axial(anatomy)
    angle = {name: np.degrees(np.arctan2(at[name][1], abs(at[name][0]))) for name in ("lateral", "medial")}
    assert 180 - sum(angle.values()) == pytest.approx(anatomy.sulcus_angle_deg, abs=1.0)
    assert angle["lateral"] == pytest.approx(anatomy.lateral_inclination_deg, abs=1.0)
    assert 0.5 * (at["lateral"][1] + at["medial"][1]) == pytest.approx(anatomy.trochlear_depth_mm, abs=0.05)
    ratio = abs(at["medial"][0] / at["lateral"][0])
    assert ratio == pytest.approx(anatomy.facet_ratio, abs=0.06)


def test_the_groove_is_a_circle_of_the_trochlear_radius(knee):
    anatomy, made = knee
    middle = cut(made.femur, 1, 1e-4)
    angle = np.degrees(np.arctan2(middle[:, 0], middle[:, 2]))
    floor = middle[(angle < 0) & (angle > -40)][:, [0, 2]]
    columns = np.column_stack([2 * floor, np.ones(len(floor))])
    a, b, c = np.linalg.lstsq(columns, (floor**2).sum(axis=1), rcond=None)[0]
    assert np.sqrt(c + a * a + b * b) == pytest.approx(anatomy.trochlear_radius_mm, abs=0.3)
    assert np.hypot(a, b) < 0.3


def test_the_groove_stands_before_the_cortex_as_asked_for(knee):
    anatomy, made = knee
    middle = cut(made.femur, 1, 1e-4)
    cortex = middle[(middle[:, 0] > 60) & (middle[:, 0] < 95)][:, 2].max()
    at = middle[np.abs(middle[:, 0]) < 2][:, 2].max()
    assert at - cortex == pytest.approx(anatomy.prominence_mm, abs=0.15)


def test_the_condyles_are_as_wide_and_round_as_asked_for(knee):
    anatomy, made = knee
    p = 1e3 * made.femur.vertices
    assert np.ptp(p[:, 1]) == pytest.approx(anatomy.epicondylar_width_mm, abs=1.2)
    assert -p[:, 0].min() == pytest.approx(anatomy.condyle_radius_mm + 5, abs=0.3)
    assert -p[p[:, 0] < 0][:, 2].min() == pytest.approx(anatomy.condyle_radius_mm + 8, abs=0.4)


def test_the_patella_has_its_size_its_ridge_and_its_facets(knee):
    anatomy, made = knee
    size = 1e3 * np.ptp(made.patella.vertices, axis=0)
    assert size[0] == pytest.approx(anatomy.patella_height_mm, abs=1.5)
    assert size[1] == pytest.approx(anatomy.patella_width_mm, abs=1.5)
    section = cut(made.patella, 0, 1e-4)
    behind = section[section[:, 2] < 0.45 * anatomy.patella_thickness_mm]
    ridge = behind[np.argmin(behind[:, 2])]
    assert np.abs(ridge[1:]).max() < 0.7 * RESOLUTION
    middle = section[np.abs(section[:, 1]) < 1][:, 2]
    assert np.ptp(middle) == pytest.approx(anatomy.patella_thickness_mm, abs=1.0)
    slopes = []
    for side in (1, -1):
        flank = behind[(side * behind[:, 1] > 7) & (side * behind[:, 1] < 13)]
        slopes.append(abs(np.polyfit(flank[:, 1], flank[:, 2], 1)[0]))
    assert 180 - np.degrees(np.arctan(slopes)).sum() == pytest.approx(anatomy.ridge_angle_deg, abs=6)
    lateral, medial = (abs(f(made.patella.vertices[:, 1])) for f in (np.max, np.min))
    assert lateral / medial == pytest.approx(anatomy.wiberg_ratio, rel=0.06)


def test_the_tuberosity_is_lateral_of_the_groove_by_tt_tg(knee):
    anatomy, made = knee
    p = 1e3 * made.tibia.vertices
    assert p[np.argmax(p[:, 2])][1] == pytest.approx(anatomy.tt_tg_mm, abs=1.5)
    assert p[:, 0].max() < -anatomy.condyle_radius_mm - 3  # the eminence reaches into the notch, no condyle


def test_wide_facets_and_a_lateral_tuberosity_keep_the_size_asked_for():
    facets = bones(Anatomy(**WIDE, trochlear_depth_mm=2.29), 2.0).femur
    assert 1e3 * np.ptp(facets.vertices[:, 1]) == pytest.approx(82, abs=1.2)
    tibia = bones(Anatomy(tt_tg_mm=30, epicondylar_width_mm=74), 2.0).tibia
    assert 1e3 * tibia.vertices[:, 1].max() == pytest.approx(30 + 14, abs=1.5)  # its bump is 28 mm wide


@pytest.mark.parametrize("ratio", [0.8, 1.4, 4.0])
def test_the_patella_is_as_thick_as_asked_for_over_its_ridge(ratio):
    shape = PatellaShape(Anatomy(wiberg_ratio=ratio))
    behind, before = (brentq(lambda z: shape(np.array([[0.0, 0.0, z]])).item(), c - 3, c + 3) for c in (0, 25))
    assert before - behind == pytest.approx(25, abs=1e-3)


def test_the_trochlea_is_smooth():
    """Normals turn by little from triangle to triangle where the patella runs, the less the finer they are."""
    import trimesh

    turn = {}
    for resolution in (2.0, 1.0):
        femur = bones(Anatomy(), resolution).femur
        made = trimesh.Trimesh(femur.vertices, femur.faces, process=False)
        middle = 1e3 * made.triangles_center[made.face_adjacency].mean(axis=1)
        radius, angle = np.hypot(middle[:, 0], middle[:, 2]), np.degrees(np.arctan2(middle[:, 0], middle[:, 2]))
        here = (radius > 20) & (angle > -40) & (angle < 20) & (np.abs(middle[:, 1]) < 20)
        turn[resolution] = np.degrees(made.face_adjacency_angles[here]).max()
    assert turn[1.0] < 15
    assert turn[1.0] < 0.85 * turn[2.0]


def test_vertices_are_on_a_known_surface_and_outside_is_out():
    ball = mesh_of(lambda p: 10 - np.linalg.norm(p, axis=1), (-12.0,) * 3, (12.0,) * 3, 1.0, "ball")
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 10e-3, atol=1e-8)
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 1e-6, rel=0.01)
    assert np.einsum("ij,ij->i", ball.vertex_normals, ball.vertices).min() > 9.9e-3


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"sulcus_angle_deg": 100}, r"sulcus_angle_deg: found 100; expected: 115 to 179"),
        ({"insall_salvati": float("nan")}, r"insall_salvati: found nan"),
        ({"sulcus_angle_deg": 165, "lateral_inclination_deg": 20}, r"nothing for the medial facet"),
        ({"sulcus_angle_deg": "138"}, r"sulcus_angle_deg: found '138'; expected: 115 to 179"),
        ({"tt_tg_mm": None}, r"tt_tg_mm: found None"),
        # 35 mm each side: (41 - 2 - 4) (1 + 0.25) tan(6 deg) / 2 = 2.2991
        (WIDE | {"trochlear_depth_mm": 2.3}, r"does not fit .* expected: at most 2.29 mm"),
    ],
)
def test_what_is_no_knee_is_refused(numbers, words):
    with pytest.raises(InputError, match=words):
        Anatomy(**numbers)


def test_the_page_lists_each_number_with_its_default_range_and_source():
    page = Path(__file__).parents[2] / "docs/natural_knee.md"
    numbers = re.findall(r"^\| (`\w+` \| -?\d.*) \|$", page.read_text(), re.MULTILINE)
    rows = [line.split(" | ") for line in numbers]
    expected = [
        [f"`{name}`", f"{getattr(Anatomy(), name):g}", f"{low:g} to {high:g}", source]
        for name, (low, high, source) in Anatomy.ranges().items()
    ]
    assert rows == expected


def test_what_cannot_be_made_is_refused():
    with pytest.raises(InputError, match=r"no type 'E' of trochlear dysplasia; expected: one of: A, B, C, D"):
        Anatomy.dejour("E")
    with pytest.raises(InputError, match=r"resolution_mm: found 9; expected: 0.4 to 5 mm"):
        bones(Anatomy(), 9)
    with pytest.raises(InputError, match=r"patella_thickness_mm: .* thicker than 18 mm at its border; .* 27.5 mm"):
        bones(Anatomy(patella_width_mm=58, patella_thickness_mm=18, ridge_angle_deg=100))
    with pytest.raises(InputError, match=r"does not fit in its box"):
        mesh_of(lambda p: 10 - np.linalg.norm(p, axis=1), (-9.0,) * 3, (12.0,) * 3, 1.0, "ball")


def test_dysplasia_is_beyond_the_limits_of_its_sources():
    for kind in "ABCD":
        assert Anatomy.dejour(kind).trochlear_depth_mm < 3
        assert Anatomy.dejour(kind).sulcus_angle_deg > 145
    assert all(Anatomy.dejour(kind).facet_ratio < 0.4 for kind in "CD")
    assert all(Anatomy.dejour(kind).prominence_mm > 3 for kind in "BD")
