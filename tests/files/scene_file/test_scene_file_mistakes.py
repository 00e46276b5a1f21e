"""Scene files: what they say about mistakes, with file, line and field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toy_scene_files import LIGHT, SCENE, changed, refused

from pftwin.base.errors import InputError
from pftwin.files.scene_file import load_scene

MISTAKES = [
    ("schema = 1", "", "bad.toml, schema: is missing; expected: schema = 1"),
    ("schema = 1", "schema = 2", "bad.toml, line 2, schema: found 2"),
    ("schema = 1", "schema = 1\nbananas = 3", "line 3, bananas: unknown field; expected: one of schema, name, side"),
    ("mass_kg", "mas_kg", "line 12, [patella] mas_kg: unknown field; expected: did you mean mass_kg?"),
    ("mass_kg = 0.12\n", "", "line 11, [patella] mass_kg: is missing; expected: mass of the patella [kg]"),
    ("mass_kg = 0.12", "mass_kg = -0.12", "line 12, [patella] mass_kg: found -0.12; expected: a positive number"),
    ("mass_kg = 0.12", "mass_kg = 0", "[patella] mass_kg: found 0; expected: a positive number"),
    ("mass_kg = 0.12", 'mass_kg = "0.12"', "[patella] mass_kg: found '0.12'; expected: a number"),
    ("mass_kg = 0.12", "mass_kg = nan", "[patella] mass_kg: found nan; expected: a finite number"),
    ("[3e-5, 3e-5, 4e-5]", "[3e-5, 3e-5]", "[patella] inertia_kg_m2: found [3e-05, 3e-05]; expected: 3 values"),
    ("[3e-5, 3e-5, 4e-5]", "[3e-5, 0, 4e-5]", "inertia_kg_m2 number 2: found 0; expected: a positive number"),
    ("= 629", "= -629", "line 32, [[tendon]] number 2 (patellar_tendon), stiffness_N_per_m: found -629"),
    ("= 629", "= 0", "stiffness_N_per_m: found 0; expected: a positive number (stiffness K [N/m])"),
    ("length_mm = 143.2", "length_mm = -1", "number 1 (quadriceps), slack_length_mm: found -1; expected: a positive"),
    ("mm = 143.2", "mm = 143.2\nslack_length_m = 0.1", "both slack_length_m and slack_length_mm are given"),
    ("length_mm = 143.2", "lenght_mm = 143.2", "slack_lenght_mm: unknown field; expected: did you mean slack_length_m"),
    ('body = "femur"', 'body = "femurr"', "body: found 'femurr'; expected: one of 'femur', 'tibia' or 'ground'"),
    ("= 156", "= [1, 2, 3]\ndamping_N_s_per_m = [1, 2]", "both damping_N_s_per_m and damping_time_s are given"),
    ("radius_mm = 22\n", "", "[contact]: the sphere has no radius; expected: radius_m and center_m, or button"),
    ("= 156", "= [1, 2, 3]\ntags = 1", "tags: unknown field"),
    ("insertion_mm = [20, 0, -8]", "insertion_mm = [20, 0]", "insertion_mm: found [20, 0]; expected: 3 values"),
    ("[20, 0, -8]", "[[2, 0, 1], [3, 4]]", "insertion_mm number 2: found [3, 4]; expected: 3 values"),
    ('"patellar_tendon"', '"quadriceps"', "two effects are named 'quadriceps'"),
    ('"patellar_tendon"', '"patellar tendon"', "expected: a name of letters, digits and _"),
    (
        "{ position_m",
        "{ quaternion_wxyz = [1, 1, 0, 0], position_m",
        "quaternion_wxyz: found a quaternion of length 1.41",
    ),
    ('"flores"', '"floress"', "[contact] law: type is 'floress'; expected: table: the normal force's law"),
    ('type = "flores", ', "", "[contact] law: type is missing"),
    ("restitution = 0.6", "restitution = 1.6", "law.restitution: found 1.6; expected: a number of at most 1"),
    ("restitution = 0.6", "restituton = 0.6", "law.restituton: unknown field; expected: did you mean restitution?"),
    ("radius_mm = 22", "radius_mm = 0", "[contact] radius_mm: found 0; expected: a positive number"),
    ("coefficients_m = [0.004, ", "coefficients_m = [", "surface.coefficients_m: 5 coefficients; expected: the 6"),
    ('"P2"', '"Q2"', "surface.degree: found 'Q2'; expected: a polynomial"),
    ('type = "plane"', 'type = "cylinder"', "surface.chart: a cylinder chart without radius_m"),
    ('"poses.csv"', '"missing.csv"', "line 6, [motion] poses: missing.csv: no such file"),
    ('"poses.csv"', '"poses.csv"\nend_time_s = 5', "line 7, [motion] end_time_s: found 5; expected: a time within"),
    ('"poses.csv"', '"poses.csv"\nend_time_s = 0.02', "a motion of 3 frames is shorter than its interpolation needs"),
    ('"poses.csv"', '"poses.csv"\nstart_time_s = 1\nend_time_s = 0', "expected: start < end"),
    (
        'body = "tibia"\n',
        'body = "tibea"\n',
        "line 9, [tibia] body: poses.csv: no body called 'tibea'; expected: did you mean",
    ),
    ('[tibia]\nbody = "tibia"', "[tibia]", "[tibia]: nothing says where it is; expected: one of fixed, body"),
    ('[tibia]\nbody = "tibia"', "[tibia]\nfixed = {}", "[tibia] fixed: the tibia is fixed; expected: a recording"),
    ('[tibia]\nbody = "tibia"', "", "bad.toml, tibia: is missing"),
    ("[gravity]", "[gravity", "line 17, column 9: not valid TOML"),
    ("[gravity]", "[gravty]", "line 17, [gravty]: unknown field; expected: did you mean gravity?"),
    ("[0, 0, -9.81]", "9.81", "[gravity] acceleration_m_per_s2: found 9.81; expected: a list in square brackets"),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES, ids=[m[2][:60] for m in MISTAKES])
def test_a_mistake_is_named_with_file_line_and_field(toy: Path, old: str, new: str, message: str) -> None:
    assert message in refused(toy, changed(old, new))


MESH_MISTAKES = [
    ('"femur.stl"', '"femurs.stl"', "[contact] surface.mesh: femurs.stl: no such file"),
    ('"femur.stl"', '"empty.stl"', "[contact] surface.mesh: empty.stl: the file is empty"),
    ('"femur.stl"', '"half.stl"', "surface.mesh: half.stl: a truncated or damaged binary STL"),
    ('"femur.stl"', '"poses.csv"', "surface.mesh: poses.csv: unknown mesh format .csv"),
    ('"femur.stl"', '"nan.stl"', "vertices are not finite"),
    ('"femur.stl"', '"flipped.stl"', "the normals of the foremost vertices point backward"),
    ('"femur.stl"', '"mixed.stl"', "surface.mesh: mixed.stl: "),
    ('units = "m"', 'units = "mm"', "a longest side of 0.064 mm is implausible"),
    ('units = "m"\n', "", "[contact] surface.units: is missing; expected: unit of the mesh's coordinates"),
    ("[-75, 30], half_width_mm = 20", "[-60, 0], half_width_mm = 8", "vertices for the 91 coefficients of P12"),
    ('chart = "plane"', 'chart = "sphere"', "surface.chart: found 'sphere'; expected: one of 'plane' or 'cylinder'"),
    ("[-75, 30]", "[30, -75]", "surface.region: angles_deg is [30.0, -75.0]; expected: the lower limit first"),
    ("axis_radius_mm = 24.8, ", "", "only one of axis_origin_m and axis_radius_m is given"),
    ("region = {", "region = { anterior = [1, 0, 0],", "anterior and proximal are 0 deg apart"),
    ("region = {", "region = { anterior = [0, 0, 0],", "region.anterior: found the zero vector"),
    ("region = {", "emphasis = [{ weight = 0 }]\nregion = {", "surface.emphasis number 1.weight: found 0"),
    (
        "region = {",
        "emphasis = [{ weight = 2, across_mm = [5, -5] }]\nregion = {",
        "across_m is [0.005, -0.005]; expected: the lower limit first",
    ),
]


@pytest.fixture(scope="module")
def bad_meshes(toy: Path) -> Path:
    data = (toy / "femur.stl").read_bytes()
    (toy / "empty.stl").write_bytes(b"")
    (toy / "half.stl").write_bytes(data[: len(data) // 2 - 7])
    triangles = np.frombuffer(data[84:], dtype=np.uint8).reshape(-1, 50).copy()
    corners = triangles[:, 12:48].copy().view("<f4").reshape(-1, 3, 3)

    def save(name: str, points: np.ndarray) -> None:
        out = triangles.copy()
        out[:, 12:48] = np.ascontiguousarray(points, dtype="<f4").reshape(-1, 9).view(np.uint8)
        (toy / name).write_bytes(data[:84] + out.tobytes())

    save("nan.stl", np.where(np.arange(len(corners))[:, None, None] == 5, np.nan, corners))
    save("flipped.stl", corners[:, ::-1])
    some = np.arange(len(corners)) % 7 == 0
    save("mixed.stl", np.where(some[:, None, None], corners[:, ::-1], corners))
    return toy


@pytest.mark.parametrize(("old", "new", "message"), MESH_MISTAKES, ids=[m[2][:60] for m in MESH_MISTAKES])
def test_a_mesh_that_cannot_be_used_is_named(bad_meshes: Path, old: str, new: str, message: str) -> None:
    text = changed('"P5"', '"P12"', SCENE) if "P12" in message else SCENE
    assert message in refused(bad_meshes, changed(old, new, text))


MARKERS = changed('poses = "poses.csv"', 'markers = "walk.trc"\ncutoff_Hz = 12')
MARKERS = changed(
    'body = "tibia"', "cluster_mm = { T1 = [-150, 50, 40], T2 = [-200, -40, 50], T3 = [-250, 20, 80] }", MARKERS
)
MARKER_MISTAKES = [
    ("cutoff_Hz = 12", "cutoff_Hz = 60", "[motion] cutoff_Hz: cutoff: a cut-off of 60 Hz cannot be had at 100 Hz"),
    ("cutoff_Hz = 12", "cutoff_Hz = 12\nend_time_s = 0.02", "shorter than its interpolation needs"),
    ("cutoff_Hz = 12", "cutoff_Hz = 2", "samples are too few for a filter of 2 Hz"),
    ("walk.trc", "gap.trc", "gaps that cannot be filled: 'T2' frames 6 to 25"),
    ("walk.trc", "poses.csv", "[motion] markers: poses.csv"),
    ("walk.trc", "walk.xyz", "the suffix '.xyz' is not known"),
    ("walk.trc", "binary.trc", "binary.trc: the content is binary, not text"),
    ("walk.trc", "cut.trc", "cut.trc, line"),
    ("walk.trc", "words.trc", "not a number"),
    ("walk.trc", "twice.trc", "repeats the time"),
    ("T3 = [-250, 20, 80]", "T9 = [-250, 20, 80]", "[tibia] cluster_mm: "),
    (", T3 = [-250, 20, 80]", "", "fewer than three markers"),
    ("T3 = [-250, 20, 80]", "T3 = [-250, -130, 60]", "lie on a line"),
]


@pytest.fixture(scope="module")
def bad_markers(toy: Path) -> Path:
    text = (toy / "walk.trc").read_text()
    lines = text.split("\n")
    (toy / "binary.trc").write_bytes(b"\x00\x01\x02" * 100)
    (toy / "cut.trc").write_text(text[:-40])
    (toy / "words.trc").write_text(text.replace(lines[10].split("\t")[5], "high"))
    cells = [line.split("\t") for line in lines]
    column = cells[3].index("T2")
    for row in cells[11:31]:
        row[column : column + 3] = ["", "", ""]
    (toy / "gap.trc").write_text("\n".join("\t".join(row) for row in cells))
    frame, _, *rest = lines[9].split("\t")
    doubled = [*lines[:9], "\t".join([frame, lines[8].split("\t")[1], *rest]), *lines[10:]]
    (toy / "twice.trc").write_text("\n".join(doubled))
    return toy


@pytest.mark.parametrize(("old", "new", "message"), MARKER_MISTAKES, ids=[m[2][:60] for m in MARKER_MISTAKES])
def test_a_recording_that_cannot_be_used_is_named(bad_markers: Path, old: str, new: str, message: str) -> None:
    assert message in refused(bad_markers, changed(old, new, MARKERS))


def test_poses_that_are_none_are_named(toy: Path) -> None:
    text = (toy / "poses.csv").read_text().splitlines()
    cells = [line.split(",") for line in text]
    cells[5][4] = "2.0"
    (toy / "skewed.csv").write_text("\n".join(",".join(c) for c in cells) + "\n")
    assert "skewed.csv, body 'tibia': row 5: a quaternion of length" in refused(
        toy, changed('"poses.csv"', '"skewed.csv"')
    )


def test_every_problem_is_listed_at_once(toy: Path) -> None:
    message = refused(toy, changed("mass_kg = 0.12", "mass_kg = -1", changed("= 629", "= -629")))
    assert message.splitlines() == [
        "bad.toml: 2 problems:",
        "  line 12, [patella] mass_kg: found -1; expected: a positive number (mass of the patella [kg])",
        "  line 32, [[tendon]] number 2 (patellar_tendon), stiffness_N_per_m: found -629; expected: a positive number"
        " (stiffness K [N/m])",
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "the file is empty"), (b"\x00\xff\x01" * 50, "the content is binary, not text"), (None, "no such file")],
)
def test_a_file_that_is_no_scene(tmp_path: Path, content: bytes | None, message: str) -> None:
    file = tmp_path / "scene.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=message):
        load_scene(file)


def test_a_scene_without_effects_is_refused(toy: Path) -> None:
    assert "no effect acts on the patella" in refused(toy, LIGHT[: LIGHT.index("[gravity]")])
