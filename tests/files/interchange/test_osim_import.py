"""OpenSim models as scene folders: what is taken over, what is left out, what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from knee_models import BUTTON_RADIUS, FEMUR, PATELLA, PT, START, TIBIA, as_left, ligament, ligaments, model, write_knee
from typer.testing import CliRunner

from pftwin.base.errors import InputError, OutputError
from pftwin.base.rotations import tibiofemoral_angles
from pftwin.cli import app
from pftwin.files.interchange import import_osim
from pftwin.files.scene_file import load_scene_file
from pftwin.geometry.mesh.mesh import load_mesh
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.motion_on_host import tibia_orientation

ANATOMICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # proximal, lateral, anterior of x, y, z


@pytest.fixture(scope="module")
def knee(tmp_path_factory):
    """The whole model, imported: the scene file's content, and what was told."""
    folder = tmp_path_factory.mktemp("import")
    imported = import_osim(write_knee(folder / "model"), folder / "scene")
    return load_scene_file(imported.scene), imported, folder


def bare(folder: Path, text: str, **options):
    """A model without meshes."""
    folder.mkdir(exist_ok=True)
    (folder / "bare.osim").write_text(text)
    return import_osim(folder / "bare.osim", folder / "out", **options)


def effect(scene, name: str) -> StrandGroup:
    return scene.effects[scene.index(name)]


def test_ligaments_become_strands(knee):
    strands = effect(knee[0].scene, "pt")
    assert strands.body == "tibia"
    np.testing.assert_allclose(strands.stiffness, [3000, 3100])
    np.testing.assert_allclose(strands.slack_length, [0.06, 0.061])
    np.testing.assert_allclose(strands.toe_strain, [0.05, 0.03])  # the model's default for its ligaments, its own
    np.testing.assert_allclose(strands.damping_time, [0.003, 0.004])  # OpenSim's own default
    np.testing.assert_allclose(strands.insertion.array()[0], ANATOMICAL @ PT[0])
    np.testing.assert_allclose(strands.origin.array()[0], ANATOMICAL @ PT[1])


def test_a_point_on_a_welded_bone_is_brought_to_the_tibia(knee):
    """The shank's origin is 50 mm below the tibia's: its child frame is 50 mm above it."""
    origin = effect(knee[0].scene, "pt").origin.array()[1]
    np.testing.assert_allclose(origin, ANATOMICAL @ [0.045, -0.07, 0.004], atol=1e-12)


def test_a_ligament_may_begin_at_either_end(knee):
    strands = effect(knee[0].scene, "mpfl")
    assert strands.body == "femur"
    np.testing.assert_allclose(strands.insertion.array()[0], ANATOMICAL @ [-0.01, 0.0, -0.02])
    np.testing.assert_allclose(strands.origin.array()[0], ANATOMICAL @ [-0.005, 0.0, -0.03])


def test_the_patella_its_weight_and_its_start(knee):
    scene = knee[0].scene
    assert float(scene.patella.mass) == 0.12
    np.testing.assert_allclose(scene.patella.inertia.array(), ANATOMICAL @ [3e-5, 4e-5, 3.5e-5])
    femur = scene.motion.femur.frames(scene.motion.start_time)
    turn = np.asarray(femur.rotation.array())
    place = turn.T @ (np.asarray(scene.start.position.array()) - np.asarray(femur.origin.array()))
    np.testing.assert_allclose(place, [-0.005, 0.001, 0.0499], atol=1e-9)


def test_contact_meshes_become_an_elastic_foundation(knee):
    contact = knee[0].scene.contact
    assert isinstance(contact, ElasticFoundation)
    written = knee[2] / "scene" / "geometry"
    from pftwin.geometry.mesh.mesh import load_mesh

    button = load_mesh(written / "patella_button.stl", units="m")  # in millimetres, and scaled by the model
    assert np.linalg.norm(button.vertices, axis=1).max() == pytest.approx(BUTTON_RADIUS, rel=1e-5)
    text = (knee[2] / "scene" / "scene.toml").read_text()
    assert "femur_layer = { modulus_MPa = 4, poisson_ratio = 0.45, thickness_m = 0.005 }" in text
    assert "button_layer = { modulus_MPa = 5, poisson_ratio = 0.45, thickness_m = 0.005 }" in text
    assert 'law = "linear"' in text
    assert any("lumps both" in note for note in knee[1].notes)


def test_the_knee_is_bent_through_its_range(knee):
    """By pftwin's own angles, from the written poses: from 0.8 rad to the farther end of the range, -0.2."""
    scene = knee[0].scene
    flexion = np.asarray(tibiofemoral_angles(tibia_orientation(scene.motion)).flexion)
    assert flexion[0] == pytest.approx(0.8, abs=1e-6)
    assert flexion[-1] == pytest.approx(-0.2, abs=1e-6)
    assert np.abs(np.diff(flexion)).max() * 100 <= np.radians(45) * 1.001
    assert scene.synthetic  # nobody recorded it


def test_what_is_left_out_is_listed_with_its_reason(knee):
    _, imported, folder = knee
    why = {part.name: part.why for part in imported.left_out}
    assert set(why) == {"MCL1", "LPFL1", "vasint_r"}
    assert why["MCL1"] == "it joins femur and tibia, whose motion is prescribed"
    assert "3 points" in why["LPFL1"]
    assert "insertion_m = [-0.008, 0.02, 0], origin_m = [0.035, 0.22, 0.012] on the femur" in why["vasint_r"]
    report = (folder / "scene" / "not_imported.md").read_text()
    for name, reason in why.items():
        assert f"| {name} | {reason} |" in report


def test_a_frame_within_a_body_carries_its_mesh(tmp_path):
    """As in models with implants: a frame among a body's components, its place relative to "..", and meshes on it."""
    place = np.array([0.002, 0.003, -0.004])
    frame = (
        '<components><PhysicalOffsetFrame name="femur_implant"><components><Mesh name="component">'
        "<socket_frame>..</socket_frame><mesh_file>femur.stl</mesh_file></Mesh></components>"
        '<FrameGeometry name="frame_geometry"><socket_frame>..</socket_frame></FrameGeometry>'
        "<socket_parent>..</socket_parent>"
        f"<translation>{' '.join(map(str, place))}</translation><orientation>0 0 0</orientation>"
        "</PhysicalOffsetFrame></components>"
    )
    text = model().replace('<Body name="femur_r">', f'<Body name="femur_r">{frame}', 1)
    on_it = f"<socket_frame>{FEMUR}/femur_implant</socket_frame>"
    surface = '<Smith2018ContactMesh name="femur_cartilage">'
    assert f"{surface}<socket_frame>{FEMUR}</socket_frame>" in text
    text = text.replace(f"{surface}<socket_frame>{FEMUR}</socket_frame>", surface + on_it)
    imported = import_osim(write_knee(tmp_path / "model", text), tmp_path / "scene")
    own = load_mesh(tmp_path / "model" / "femur.stl", units="m").vertices.mean(axis=0)
    for name, moved in (("femur_cartilage", place), ("component", place), ("femur_r_bone", np.zeros(3))):
        written = load_mesh(imported.scene.parent / "geometry" / f"{name}.stl", units="m").vertices.mean(axis=0)
        np.testing.assert_allclose(written, own + moved, atol=1e-7, err_msg=name)


def test_the_case_of_a_files_name_does_not_matter(tmp_path):
    """Where models are written, it mostly does not; an exact name comes first, and of two alike none is taken."""
    folder = tmp_path / "model"
    path = write_knee(folder, model().replace(">femur.stl<", ">Femur.STL<"))
    assert any(p.name == "femur_cartilage.stl" for p in import_osim(path, tmp_path / "scene").files)
    (folder / "FEMUR.stl").write_bytes((folder / "femur.stl").read_bytes())
    why = {part.name: part.why for part in import_osim(path, tmp_path / "other").left_out}
    assert "no mesh 'Femur.STL'" in why["pf_contact"]
    assert "several that it may be: FEMUR.stl, femur.stl" in why["pf_contact"]


@pytest.mark.parametrize("name", ["Geometry", "geometry", "GEOMETRY"])
def test_the_case_of_the_folder_of_meshes_does_not_matter(tmp_path, name):
    path = write_knee(tmp_path / "model")
    (tmp_path / "model" / name).mkdir()
    for mesh in (tmp_path / "model").glob("*.stl"):
        mesh.rename(tmp_path / "model" / name / mesh.name)
    imported = import_osim(path, tmp_path / "scene")
    assert any(p.name == "femur_cartilage.stl" for p in imported.files)
    assert not any("no mesh" in part.why for part in imported.left_out)


def test_blanks_and_underscores_in_a_files_name_do_not_matter(tmp_path):
    """Downloads rename files; a name that differs in case alone comes first, and of two alike none is taken."""
    folder = tmp_path / "model"
    path = write_knee(folder, model().replace(">femur.stl<", ">Femoral Component.stl<"))
    (folder / "femur.stl").rename(folder / "femoral_component.stl")
    assert any(p.name == "femur_cartilage.stl" for p in import_osim(path, tmp_path / "scene").files)
    (folder / "femoral-component.stl").write_bytes(b"not a mesh")
    why = {part.name: part.why for part in import_osim(path, tmp_path / "other").left_out}
    assert "several that it may be: femoral-component.stl, femoral_component.stl" in why["pf_contact"]
    (folder / "femoral_component.stl").rename(folder / "femoral component.stl")
    assert any(p.name == "femur_cartilage.stl" for p in import_osim(path, tmp_path / "third").files)


def test_strands_that_cannot_wrap_are_reported_in_one_note(tmp_path):
    wrap = "<PathWrap><wrap_object>{}</wrap_object></PathWrap>"
    numbered = [("PT1", "PatTen_r"), ("PT2", "PatTen_r"), ("PT3", "PatTen_r"), ("MPFL", "condyle")]
    forces = "".join(
        ligament(name, (PATELLA, PT[0]), (TIBIA, PT[1]), k=1, slack=0.1, more=wrap.format(over))
        for name, over in numbered
    )
    imported = bare(tmp_path, model(forces=forces, meshes=False))
    assert [n for n in imported.notes if "wrapped" in n] == [
        "PT1 to PT3 (3 strands): not wrapped over PatTen_r (the model has no such object)",
        "MPFL: not wrapped over condyle (the model has no such object)",
    ]


def test_every_file_is_there(knee):
    _, imported, folder = knee
    names = sorted(str(p.relative_to(folder / "scene")) for p in imported.files)
    assert names == [
        "geometry/femur_cartilage.stl",
        "geometry/femur_r_bone.stl",
        "geometry/patella_button.stl",
        "geometry/patella_r_bone.stl",
        "not_imported.md",
        "poses.csv",
        "scene.toml",
    ]
    assert all(p.is_file() for p in imported.files)


def test_a_file_that_is_there_is_not_overwritten(knee):
    _, _, folder = knee
    before = (folder / "scene" / "scene.toml").read_text()
    with pytest.raises(OutputError, match="is there already"):
        import_osim(folder / "model" / "knee.osim", folder / "scene")
    assert (folder / "scene" / "scene.toml").read_text() == before


def test_a_left_knee_is_recognised_by_its_names_and_mirrored(tmp_path):
    text = model(forces=ligaments(), meshes=False)
    imported = bare(tmp_path, as_left(text))
    scene = load_scene_file(imported.scene).scene
    lateral = effect(scene, "pt").insertion.array()[1, 1]
    assert lateral == pytest.approx(-0.004)  # to the right of a left knee is medial
    assert 'side = "left"' in imported.scene.read_text()


def test_a_bone_of_the_other_side_is_not_taken(tmp_path):
    """A patella or femur of the other side would be a wrong knee; names without a side may be of either."""
    text = model(forces=ligaments(), meshes=False)
    left = as_left(text)
    with pytest.raises(InputError, match=r"no patella of the right side, only: patella_l.*try: --patella NAME, or"):
        bare(tmp_path, left, side="right")
    one_left = left.replace("patella_l", "patella_r")
    for change in ({}, {"side": "right"}, {"side": "right", "patella": "patella_r"}):
        with pytest.raises(InputError, match=r"no femur of the right side, only: femur_l"):
            bare(tmp_path, one_left, **change)
    assert 'side = "right"' in bare(tmp_path, re.sub(r"_l\b", "", one_left), side="right").scene.read_text()


@pytest.mark.parametrize("without", [r"patella", r"(patella|femur)"])
def test_the_side_follows_from_the_names_that_have_one(tmp_path, without):
    left = re.sub(rf"{without}_l\b", lambda m: m[0][:-2], as_left(model(forces=ligaments(), meshes=False)))
    assert 'side = "left"' in bare(tmp_path, left).scene.read_text()


def test_a_motion_of_coordinates_moves_the_bones(tmp_path):
    """Exported by us, imported again: the tibia moves in the femur as the result's did."""
    from small_scene import small_result

    from pftwin.files.interchange import export

    result = small_result()
    export(result, tmp_path / "walk.mot")
    imported = bare(tmp_path, model(forces=ligaments(), meshes=False), motion=tmp_path / "walk.mot")
    scene = load_scene_file(imported.scene).scene
    assert not scene.synthetic  # as far as the import can know
    motion = scene.motion
    assert motion.n_frames == result.times.size
    from pftwin.model.motion_on_host import tibia_position

    np.testing.assert_allclose(tibia_position(motion), result.tibia[0], atol=1e-9)
    found = tibiofemoral_angles(tibia_orientation(motion))
    np.testing.assert_allclose(found.flexion, result.knee.flexion, atol=1e-8)
    assert imported.notes[0].startswith("motion: 12 coordinates from")
    assert "not used" not in imported.notes[0]
    changed = (tmp_path / "walk.mot").read_text().replace("knee_tx_r", "shank_tx_r")
    (tmp_path / "misspelt.mot").write_text(changed)
    imported = import_osim(tmp_path / "bare.osim", tmp_path / "other", motion=tmp_path / "misspelt.mot")
    assert "motion: 11 coordinates from" in imported.notes[0]
    assert "; not used: shank_tx_r" in imported.notes[0]


def test_the_command(knee, tmp_path):
    _, _, folder = knee
    command = ["import", str(folder / "model" / "knee.osim"), "-o", str(tmp_path / "s"), "--json", "-"]
    done = CliRunner().invoke(app, [*command, "--quadriceps", "25"])
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["trouble"] is None
    assert facts["tensions_N"] == {"vasint_r": 25.0}
    assert len(facts["not_imported"]) == 2
    assert f"next: pftwin simulate {tmp_path / 's' / 'scene.toml'}" in done.stderr.replace("\n", "")


@pytest.mark.parametrize("nearer", [0.0, 0.006])
def test_the_command_names_an_overlap_where_the_patella_starts(tmp_path, nearer):
    """By default the button, a ball about the patella's origin, clears the femur; 6 mm further back it does not."""
    text, there = model(), START["pf_tx_r"]
    assert f"<default_value>{there}<" in text
    path = write_knee(tmp_path / "m", text.replace(f"<default_value>{there}<", f"<default_value>{there - nearer}<"))
    command = ["import", str(path), "-o", str(tmp_path / "s"), "--quadriceps", "25", "--json", str(tmp_path / "facts")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    remark = json.loads((tmp_path / "facts").read_text())["start_overlap"]
    said = " ".join(done.stdout.split())
    assert bool(remark) == (nearer > 0)
    assert ("remark: the surfaces in contact overlap by" in said) == (nearer > 0)
    if nearer:
        center = [there - nearer, START["pf_ty_r"], START["pf_tz_r"]]
        off = np.linalg.norm(load_mesh(tmp_path / "m" / "femur.stl", units="m").vertices - center, axis=1).min()
        assert float(re.findall(r"by ([0-9.]+) mm", remark)[0]) == pytest.approx(1e3 * (BUTTON_RADIUS - off), abs=0.3)


@pytest.mark.parametrize("flexions", [[0.0], "0,30", [30.0, 0.0], [0.0, 200.0], 3.0, []])
def test_flexions_of_a_tension_rise_and_are_of_a_knee(knee, tmp_path, flexions):
    with pytest.raises(InputError, match=r"at least two flexions, each larger than .*, from -180 to 180 deg"):
        import_osim(knee[2] / "model" / "knee.osim", tmp_path / "s", quadriceps=25.0, quadriceps_knots=flexions)
    assert not (tmp_path / "s").exists()
    imported = import_osim(
        knee[2] / "model" / "knee.osim", tmp_path / "s", quadriceps=25.0, quadriceps_knots=np.array([0.0, 30.0])
    )
    assert "at_flexion_deg = [0, 30]" in imported.scene.read_text()


def test_the_command_takes_flexions_of_a_tension(knee, tmp_path):
    command = ["import", str(knee[2] / "model" / "knee.osim"), "-o", str(tmp_path / "s"), "--quadriceps", "25"]
    for wrong in ("0,thirty", "0,30,60 mm", ""):
        done = CliRunner().invoke(app, [*command, "--quadriceps-knots", wrong])
        assert done.exit_code == 2, done.output
        assert "flexions in degrees, such as 0,30,60" in done.stderr
    assert not (tmp_path / "s").exists()
    done = CliRunner().invoke(app, [*command, "--quadriceps-knots", "-5, 30,60 deg"])
    assert done.exit_code == 0, done.output
    text = (tmp_path / "s" / "scene.toml").read_text()
    assert "tension_N = [25, 25, 25]" in text
    assert "at_flexion_deg = [-5, 30, 60]" in text
    assert "shares = [25]" in text


def test_a_knee_whose_muscles_were_left_out_is_code_3(knee, tmp_path):
    done = CliRunner().invoke(app, ["import", str(knee[2] / "model" / "knee.osim"), "-o", str(tmp_path / "s")])
    assert done.exit_code == 3, done.output
    said = " ".join(done.stderr.split())
    assert "muscles of the patella were left out (vasint_r); try: --quadriceps NEWTONS" in said
    assert (tmp_path / "s" / "scene.toml").is_file()


def test_a_scene_that_needs_more_is_code_3(tmp_path):
    (tmp_path / "bare.osim").write_text(model(forces=ligaments(), meshes=False))
    done = CliRunner().invoke(app, ["import", str(tmp_path / "bare.osim"), "-o", str(tmp_path / "s")])
    assert done.exit_code == 3, done.output
    assert "a scene without contact" in done.stderr
    assert (tmp_path / "s" / "scene.toml").is_file()


@pytest.mark.slow
def test_an_imported_knee_simulates(tmp_path):
    """With a quadriceps, as a ligament that pulls from the femur: it finds its balance, and follows the motion."""
    from pftwin import Status, simulate

    quadriceps = ligament("QT1", (PATELLA, (-0.008, 0.02, 0.0)), (FEMUR, (0.035, 0.22, 0.012)), k=3000, slack=0.19)
    imported = import_osim(
        write_knee(tmp_path / "m", model().replace("<objects><Blank", f"<objects>{quadriceps}<Blank", 1)),
        tmp_path / "s",
    )
    result = simulate(load_scene_file(imported.scene).scene, dt=2e-3)
    assert result.equilibrium.converged
    assert Status.NOT_FINITE not in result.status
    assert result.effects["contact"]["force"].max() > 1
