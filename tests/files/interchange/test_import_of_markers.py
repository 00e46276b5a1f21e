"""OpenSim models whose bones move as a recording of markers says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import recorded_knee
from knee_models import as_left
from recorded_knee import FRAMES, HIP_IN_FEMUR, PELVIS, PLACES, TIMES, marker, marker_set, motion, osim, record, seen
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.files.interchange import import_osim
from pftwin.files.interchange.osim_scene import Imported
from pftwin.files.mocap import read_trc
from pftwin.files.scene_file import load_scene_file
from pftwin.model.motion import SegmentMotion
from pftwin.model.scene import Scene

ANATOMICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # proximal, lateral, anterior of x, y, z


def imported(folder: Path, recorded: dict[str, np.ndarray], text: str | None = None, **options) -> Imported:
    (folder / "knee.osim").write_text(osim() if text is None else text)
    return import_osim(folder / "knee.osim", folder / "out", motion=record(folder / "gait.trc", recorded), **options)


def load(report: Imported) -> Scene:
    return load_scene_file(report.scene).scene


def poses(guided: SegmentMotion, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 3) and turns (n, 3, 3) of a moving bone at times."""
    frames = [guided.frames(t) for t in times]
    return np.array([f.origin.array() for f in frames]), np.array([f.rotation.array() for f in frames])


def check_bone(guided: SegmentMotion, expected: np.ndarray) -> None:
    """Every tenth frame: within 1e-6 m and 1e-6 rad."""
    some = slice(None, None, 10)
    places, turns = poses(guided, TIMES[some])
    np.testing.assert_allclose(places, expected[some, :3, 3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(turns, expected[some, :3, :3] @ ANATOMICAL.T, rtol=0, atol=2e-6)


def test_bones_move_as_their_markers(tmp_path: Path) -> None:
    report = imported(tmp_path, seen())
    scene, bodies = load(report), motion()
    np.testing.assert_allclose(scene.motion.times, TIMES)
    check_bone(scene.motion.femur, bodies["femur_r"])
    check_bone(scene.motion.tibia, bodies["tibia_r"])
    renamed = next(n for n in report.notes if "spells otherwise" in n)
    assert "R.Thigh.A is R_Thigh_A" in renamed
    assert any("femur_r: 3 markers are off a rigid body by 0.0 mm rms" in n for n in report.notes)
    assert any("Butterworth, 12 Hz, order 2" in n for n in report.notes)
    assert (
        "no body and no frame is called '/bodyset/hand'" in {part.name: part.why for part in report.left_out}["R.Wrist"]
    )


def test_the_marker_on_the_patella_is_what_is_compared(tmp_path: Path) -> None:
    report = imported(tmp_path, seen())
    scene = load(report)
    np.testing.assert_allclose(
        np.asarray(scene.effect("r_patella").point.array()),  # type: ignore[attr-defined]
        ANATOMICAL @ PLACES["patella_r"]["R.Patella"],
    )
    measured, bodies = scene.measured, motion()
    assert measured is not None
    assert measured.skin_markers == ("r_patella",)
    assert measured.quaternion is None
    assert np.isnan(measured.center).all()
    button = np.linalg.inv(bodies["femur_r"]) @ bodies["patella_r"]
    there = button[:, :3, :3] @ PLACES["patella_r"]["R.Patella"] + button[:, :3, 3]
    found = np.stack([measured.readings[f"r_patella.{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(found, there @ ANATOMICAL.T, rtol=0, atol=1e-6)


@pytest.mark.parametrize("head", ["", '<OpenSimDocument Version="30000">'])
def test_a_marker_file_of_opensim_3_stands_in_for_the_models_own(tmp_path: Path, head: str) -> None:
    (tmp_path / "own.xml").write_text(head + marker_set(prefix="") + ("</OpenSimDocument>" if head else ""))
    elsewhere = {body: dict.fromkeys(held, (0.1, 0.2, 0.3)) for body, held in PLACES.items()}
    report = imported(tmp_path, seen(), osim(marker_set(elsewhere)), markers=tmp_path / "own.xml")
    check_bone(load(report).motion.tibia, motion()["tibia_r"])


def test_the_longest_stretch_in_which_both_bones_are_known_is_taken(tmp_path: Path) -> None:
    """Fewer than three markers from frame 0 to 49 and 150 to 199; one more of the femur comes and goes, and is left."""
    markers = seen()
    markers["R_Thigh_B"][:50] = np.nan
    markers["R_Shank_C"][150:200] = np.nan
    markers["R_Shank_A"][80:85] = np.nan
    markers["R_Patella"][90:115] = np.nan
    extra = {**PLACES, "femur_r": {**PLACES["femur_r"], "R.Thigh.D": (0.04, 0.05, 0.03)}}
    markers["R_Thigh_D"] = seen(extra)["R_Thigh_D"]
    markers["R_Thigh_D"][60:90] = np.nan
    report = imported(tmp_path, markers, osim(marker_set(extra)))
    scene = load(report)
    np.testing.assert_allclose(scene.motion.times[[0, -1]], TIMES[[50, 149]])
    stretch = next(n for n in report.notes if n.startswith("stretch: "))
    assert f"{TIMES[50]:g} to {TIMES[149]:g} s of {TIMES[0]:g} to {TIMES[-1]:g} s" in stretch
    why = {part.name: part.why for part in report.left_out}
    assert why["R.Thigh.D"] == "it is not in the recording, or not seen throughout, or was left out"
    assert "R_Shank_A: filled frames 81 to 85" in report.notes
    places, _ = poses(scene.motion.femur, TIMES[60:140:20])
    np.testing.assert_allclose(places, motion()["femur_r"][60:140:20, :3, 3], rtol=0, atol=3e-6)
    assert scene.measured is not None
    missing = np.isnan(scene.measured.readings["r_patella.x"])
    np.testing.assert_array_equal(np.flatnonzero(missing), np.arange(40, 65))


def test_markers_that_were_exchanged_are_put_back_before_anything_else(tmp_path: Path) -> None:
    more = {**PLACES, "femur_r": {**PLACES["femur_r"], "R.Thigh.D": (0.04, 0.05, 0.03)}}
    markers = seen(more)
    a, b = markers["R_Thigh_A"].copy(), markers["R_Thigh_B"].copy()
    markers["R_Thigh_A"][60:63], markers["R_Thigh_B"][60:63] = b[60:63], a[60:63]
    report = imported(tmp_path, markers, osim(marker_set(more)))
    assert any("R_Thigh_A, R_Thigh_B exchanged in frames 61 to 63" in n for n in report.notes), report.notes
    check_bone(load(report).motion.femur, motion()["femur_r"])


def test_hip_and_knee_count_as_markers_of_the_femur(tmp_path: Path) -> None:
    """One marker of the femur and both centres are enough; where the knee's differs from the model's is told."""
    everything = {**PLACES, "pelvis": PELVIS}
    markers = seen(everything)
    for lost in ("R_Thigh_B", "R_Thigh_C"):
        markers[lost][:] = np.nan
    report = imported(tmp_path, markers, recorded_knee.with_pelvis(), joint_centers=True)
    said = next(n for n in report.notes if n.startswith("hip_center counts as a marker of femur_r"))
    assert said.endswith("determined from the markers of pelvis")
    written = read_trc(report.scene.with_name("markers.trc"))
    femur = motion()["femur_r"]
    hip = femur[:, :3, :3] @ HIP_IN_FEMUR + femur[:, :3, 3]
    np.testing.assert_allclose(written.marker("hip_center"), hip, rtol=0, atol=1e-8)
    np.testing.assert_allclose(written.marker("knee_r_center"), motion()["tibia_r"][:, :3, 3], rtol=0, atol=1e-8)
    text = report.scene.read_text()
    assert '"hip_center" = [0.003, 0.404, -0.002]' in text
    assert '"knee_r_center" = [0, 0, 0]' in text  # by knee_models.START; it is recorded 2.2 mm from there
    guided = load(report).motion.femur
    places, _ = poses(guided, TIMES[::40])
    off = np.linalg.norm(places - femur[::40, :3, 3], axis=1)
    assert 1e-4 < off.max() < 2.3e-3
    with pytest.raises(InputError, match="'femur_r' is attached to no hip joint"):
        imported(tmp_path, seen(), joint_centers=True)


def test_the_patella_starts_where_the_models_knee_has_it(tmp_path: Path) -> None:
    """By default; or where the flexing coordinate moves it, at the angle that was recorded first: here 0.2 rad."""

    def start(report: Imported) -> np.ndarray:
        scene = load(report)
        places, turns = poses(scene.motion.femur, TIMES[:1])
        return turns[0].T @ (np.asarray(scene.start.position.array()) - places[0])

    report = imported(tmp_path, seen())
    assert any(
        n.startswith("patella_r starts where the model has it in femur_r by default; limits") for n in report.notes
    )
    np.testing.assert_allclose(start(report), [-0.005, 0.001, 0.0499], atol=1e-9)
    coupled = (
        '<ConstraintSet><objects><CoordinateCouplerConstraint name="c"><coupled_coordinates_function><LinearFunction>'
        "<coefficients>-0.05 0.02</coefficients></LinearFunction></coupled_coordinates_function>"
        "<independent_coordinate_names>knee_flex_r</independent_coordinate_names>"
        "<dependent_coordinate_name>pf_ty_r</dependent_coordinate_name></CoordinateCouplerConstraint></objects>"
        "</ConstraintSet></Model>"
    )
    (tmp_path / "coupled").mkdir()
    report = imported(tmp_path / "coupled", seen(), osim().replace("</Model>", coupled))
    assert any("at knee_flex_r = 11.5 deg" in n or "at knee_flex_r = 11.4 deg" in n for n in report.notes)
    np.testing.assert_allclose(start(report)[0], 0.02 - 0.05 * 0.2, atol=0.05 * 1e-3)


def test_a_left_out_marker_changes_the_fit_and_is_named_by_either_name(tmp_path: Path) -> None:
    extra = {**PLACES, "femur_r": {**PLACES["femur_r"], "R.Thigh.D": (0.04, 0.05, 0.03)}}
    wrong = {**extra, "femur_r": {**extra["femur_r"], "R.Thigh.D": (0.04, 0.05, 0.08)}}
    report = imported(tmp_path, seen(extra), osim(marker_set(wrong)))
    note = next(n for n in report.notes if n.startswith("femur_r: 4 markers"))
    assert "; without R_Thigh_D by 0.0 mm rms" in note
    for name in ("R.Thigh.D", "R_Thigh_D"):
        folder = tmp_path / name
        folder.mkdir()
        check_bone(
            load(imported(folder, seen(extra), osim(marker_set(wrong)), without=[name])).motion.femur,
            motion()["femur_r"],
        )
    line = {**PLACES, "femur_r": {f"R.Thigh.{k}": (0.01 * i, 0.1 * i, 0.03) for i, k in enumerate("ABC")}}
    line["femur_r"]["R.Thigh.D"] = (0.04, 0.05, 0.08)
    (tmp_path / "line").mkdir()  # without the fourth, the others are on a line: it is never proposed to its cost
    report = imported(tmp_path / "line", seen(line), osim(marker_set(line)))
    check_bone(load(report).motion.femur, motion()["femur_r"])
    with pytest.raises(InputError, match=r"no marker 'R\.Thigh\.E' of the knee to leave out.*R_Thigh_A"):
        imported(tmp_path, seen(extra), without=["R.Thigh.E"])


def test_too_few_markers_are_named_with_what_can_be_done(tmp_path: Path) -> None:
    markers = seen()
    markers["R_Shank_C"][:] = np.nan
    with pytest.raises(InputError) as report:
        imported(tmp_path, markers)
    for said in (
        "gait.trc: 2 of the markers on tibia_r are seen: R_Shank_A, R_Shank_B; expected: 3 or more",
        "the model has R.Shank.A, R.Shank.B, R.Shank.C there",
        "--markers FILE.xml",
    ):
        assert said in str(report.value)
    apart = seen()
    apart["R_Shank_C"][: FRAMES // 2] = np.nan
    apart["R_Thigh_A"][FRAMES // 2 :] = np.nan
    with pytest.raises(InputError, match="in no two frames enough markers of each segment are seen at once"):
        imported(tmp_path, apart)
    brief = {name: np.where(np.arange(FRAMES)[:, None] < 12, p, np.nan) for name, p in seen().items()}
    with pytest.raises(InputError, match=r"known from 2 to 2\.09.* s at the longest: 12 samples are too few"):
        imported(tmp_path, brief)
    assert not (tmp_path / "out").exists()


def test_names_that_may_mean_several_are_refused(tmp_path: Path) -> None:
    markers = seen()
    both = {**markers, "R Thigh A": markers["R_Thigh_A"]}
    with pytest.raises(InputError, match=r"'R\.Thigh\.A' of the model may be 'R_Thigh_A' or 'R Thigh A'"):
        imported(tmp_path, both)
    exact = {**both, "R.Thigh.A": markers["R_Thigh_A"]}
    imported(tmp_path, exact)
    (tmp_path / "twice").mkdir()
    twice = {**PLACES, "femur_r": {**PLACES["femur_r"], "RTHIGHA": (0, 0, 0.1)}}
    with pytest.raises(InputError, match=r"'R\.Thigh\.A' and 'RTHIGHA' of the model may both be 'R_Thigh_A'"):
        imported(tmp_path / "twice", markers, osim(marker_set(twice)))
    with pytest.raises(InputError, match=r"none of the model's markers \(R\.Thigh\.A.*the recording has other, one"):
        imported(tmp_path / "twice", {"other": markers["R_Thigh_A"], "one": markers["R_Thigh_B"]})
    with pytest.raises(InputError, match=r"none of the model's markers \(it has none\)"):
        imported(tmp_path / "twice", markers, osim(""))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<Model/>", r"the document is a <Model>; expected: a <MarkerSet>"),
        ("<MarkerSet><objects/></MarkerSet>", "a <MarkerSet> without a <Marker>"),
        ("<MarkerSet>", "line 1: no valid XML"),
        ("", "empty"),
        (
            '<MarkerSet><Marker name="a"><body>femur_r</body></Marker></MarkerSet>',
            "line 1: <Marker> 'a' has no <location>",
        ),
        ('<MarkerSet><Marker name="a"><location>0 0 0</location></Marker></MarkerSet>', "<Marker> 'a' has no <socket_"),
        (f"<MarkerSet>{marker('a', 'femur_r', (0.1, 0.2))}</MarkerSet>", "3 finite numbers"),
        (f"<MarkerSet>{2 * marker('a', 'femur_r', (0.1, 0.2, 0.3))}</MarkerSet>", "markers that occur twice: a"),
    ],
)
def test_marker_files_that_are_none_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "own.xml").write_text(text)
    with pytest.raises(InputError, match=said):
        imported(tmp_path, seen(), markers=tmp_path / "own.xml")
    assert not (tmp_path / "out").exists()


def test_options_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    for options, words in (
        ({"rate": 30.0}, "rate given, and a recording of markers"),
        ({"bend": "knee_flex_r"}, "bend given, and a motion"),
    ):
        with pytest.raises(InputError, match=words):
            imported(tmp_path, seen(), **options)
    for options in ({"markers": "own.xml"}, {"units": "mm"}, {"without": ["a"]}, {"joint_centers": True}):
        with pytest.raises(InputError, match="no recording of markers as motion"):
            import_osim(tmp_path / "knee.osim", tmp_path / "out", **options)
    with pytest.raises(InputError, match="most_marker_residual"):
        imported(tmp_path, seen(), limits={"most_marker_residual": 3.0})


def test_the_command_takes_units_and_limits_and_writes_them(tmp_path: Path) -> None:
    (tmp_path / "knee.osim").write_text(osim())
    path = record(tmp_path / "gait.trc", seen())
    lines = path.read_text().splitlines()
    lines[1], lines[2] = lines[1].replace("\tUnits", ""), lines[2].replace("\tmm", "")
    path.write_text("\n".join(lines) + "\n")
    command = ["import", str(tmp_path / "knee.osim"), "--motion", str(path), "-o", str(tmp_path / "out")]
    failed = CliRunner().invoke(app, command)
    assert failed.exit_code == 2
    assert "no unit of length in the file" in failed.output
    done = CliRunner().invoke(app, ["--allow", "most_marker_residual_mm=7", *command, "--units", "mm"])
    assert done.exit_code == 3, done.output  # a scene without contact
    assert "most_marker_residual_mm = 7" in (tmp_path / "out" / "scene.toml").read_text()
    check_bone(load_scene_file(tmp_path / "out" / "scene.toml").scene.motion.tibia, motion()["tibia_r"])


def test_a_left_knee_is_mirrored_with_its_markers(tmp_path: Path) -> None:
    """The model's z is medial then: lateral coordinates change their sign."""
    right, left = (imported_side(tmp_path / side, side) for side in ("right", "left"))
    assert left.measured is not None
    assert right.measured is not None
    for axis, sign in (("x", 1), ("y", -1), ("z", 1)):
        name = f"r_patella.{axis}"
        np.testing.assert_allclose(left.measured.readings[name], sign * right.measured.readings[name], atol=1e-9)


def imported_side(folder: Path, side: str) -> Scene:
    folder.mkdir()
    return load(imported(folder, seen(), as_left(osim()) if side == "left" else osim(), side=side))


@pytest.mark.filterwarnings("ignore:.*DM_smooth1_new")
def test_a_persons_gait(dm_knee: Path, tmp_path: Path) -> None:
    """The published places of the thigh's markers do not fit this recording, which is told; joint centres help."""
    model, gait = dm_knee / "DM.osim", dm_knee / "DM_smooth1_new.trc"
    plain = import_osim(model, tmp_path / "plain", motion=gait, side="right")
    (note,) = (n for n in plain.notes if n.startswith("femur_r: "))
    assert "femur_r: 3 markers are off a rigid body by 33.7 mm rms" in note
    with pytest.raises(InputError, match="most_marker_residual_mm"):
        load(plain)
    report = import_osim(
        model,
        tmp_path / "gait",
        motion=gait,
        side="right",
        markers=dm_knee / "DM_markers.xml",
        joint_centers=True,
        without=["R.Thigh.Lateral"],
        limits={"most_marker_residual_mm": 20.0},
    )
    scene = load(report)
    assert scene.motion.n_frames == 370
    femur, tibia = (poses(part, scene.motion.times[::10]) for part in (scene.motion.femur, scene.motion.tibia))
    turns = Rotation.from_matrix(np.swapaxes(femur[1], 1, 2) @ tibia[1])
    flexion = np.degrees(turns.magnitude())
    assert flexion.min() < 12  # in stance, and some 60 in swing
    assert 55 < flexion.max() < 70
    assert scene.measured is not None
    for axis, low, high in (("x", 20, 50), ("z", 5, 30)):
        assert low < 1e3 * np.ptp(scene.measured.readings[f"r_patella.{axis}"]) < high


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*DM_smooth1_new")
def test_a_persons_patella_goes_up_and_down_with_the_knee(dm_knee: Path, tmp_path: Path) -> None:
    """Half a second of gait from the files to the comparison, as docs/bring_your_own_knee.md does with all of it."""
    scene, report = tmp_path / "gait" / "scene.toml", tmp_path / "validation.json"
    runner, options = CliRunner(), ["--side", "right", "--joint-centers", "--without", "R_Thigh_Lateral"]
    files = [str(dm_knee / "DM.osim"), "--motion", str(dm_knee / "DM_smooth1_new.trc")]
    command = ["import", *files, *options, "--quadriceps", "200", "-o", str(tmp_path / "gait")]
    done = runner.invoke(app, ["--allow", "most_marker_residual_mm=20", *command])
    assert done.exit_code == 0, done.output
    text = scene.read_text()
    scene.write_text(text.replace("[motion]\n", "[motion]\nstart_time_s = 1.1\nend_time_s = 1.6\n"))
    done = runner.invoke(app, ["validate", str(scene), "--json", str(report)])
    assert done.exit_code == 0, done.output
    found = json.loads(report.read_text())
    assert found["status_frames"]["energy_from_nowhere"] == 0
    assert found["mean_distance"] is None
    row = found["skin_markers"]["r_patella.x"]
    assert row["correlation"] > 0.8
    assert 10 < row["measured_range"] < row["simulated_range"] < 60
