"""Muscles of OpenSim models whose tension follows from their activation."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from knee_models import FEMUR, FEMUR_AT, MUSCLE, PATELLA, TIBIA, body, coordinate, model, point, write_knee
from pose_matrices import written
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.files.interchange import import_osim
from pftwin.files.interchange.osim_document import read_osim
from pftwin.files.interchange.osim_muscle_force import read_force
from pftwin.files.scene_file import load_scene_file

ANATOMICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # proximal, lateral, anterior of x, y, z
INSERTION, VIA, START = (-0.008, 0.02, 0.0), (0.04, 0.12, 0.01), (0.035, 0.22, 0.012)
PATELLA_AT, FLEX = (0.0499, -0.005, 0.001), 0.3  # of the knee's model by default: place in the femur [m] and turn [rad]
FORCE = (
    "<max_isometric_force>900</max_isometric_force><optimal_fiber_length>0.08</optimal_fiber_length>"
    "<tendon_slack_length>0.14</tendon_slack_length><pennation_angle_at_optimal>0.1</pennation_angle_at_optimal>"
)


def muscle(name: str, *points: tuple[str, tuple[float, ...]], kind="Millard2012EquilibriumMuscle", more=FORCE) -> str:
    path = "".join(point(f"{name}{k}", frame, place) for k, (frame, place) in enumerate(points))
    return (
        f'<{kind} name="{name}"><GeometryPath name="geometrypath"><PathPointSet><objects>{path}</objects>'
        f"</PathPointSet></GeometryPath>{more}</{kind}>"
    )


VASTUS = muscle("vas int", (FEMUR, START), (FEMUR, VIA), (PATELLA, INSERTION))
RECTUS = muscle("recfem", ("/bodyset/pelvis", (0.04, 0.26, 0.02)), (PATELLA, INSERTION), kind="Thelen2003Muscle")
PELVIS = (
    '<PinJoint name="hip_joint"><socket_parent_frame>/bodyset/femur_r</socket_parent_frame>'
    "<socket_child_frame>/bodyset/pelvis</socket_child_frame><coordinates>"
    + coordinate("hip", 0.1, -2, 2)
    + "</coordinates></PinJoint>"
)
OVER = '<PathWrapSet><objects><PathWrap name="w"><wrap_object>roll</wrap_object></PathWrap></objects></PathWrapSet>'
ROLL = (
    '<WrapObjectSet name="wrapobjectset"><objects><WrapCylinder name="roll"><translation>0 0 0</translation>'
    "<radius>0.03</radius></WrapCylinder></objects></WrapObjectSet>"
)
# The patella moves in the femur, so that the muscles lengthen.
MOTION = "\n".join(
    ["name", "inDegrees=no", "endheader", "time\tknee_flex_r\tpf_flex_r\tpf_ty_r\thip"]
    + [
        f"{t:.2f}\t{0.5 * t:.6f}\t{FLEX + 0.4 * t:.6f}\t{-0.005 - 0.02 * t:.6f}\t{0.2 * t:.6f}"
        for t in np.arange(51) / 50
    ]
)


def knee_file(folder, muscles: str = VASTUS + RECTUS, *, meshes: bool = False):
    text = model(joints=PELVIS, meshes=meshes).replace(MUSCLE, muscles)
    text = text.replace("</objects></BodySet>", body("pelvis", 1.0) + "</objects></BodySet>")
    (folder / "walk.mot").write_text(MOTION + "\n")
    if meshes:
        return write_knee(folder / "model", text)
    (folder / "knee.osim").write_text(text)
    return folder / "knee.osim"


def brought_in(folder, muscles: str = VASTUS + RECTUS, **options):
    path = knee_file(folder, muscles)
    return path, import_osim(path, folder / "scene", **{"motion": folder / "walk.mot", "activation": 0.2, **options})


@pytest.fixture(scope="module")
def knee(tmp_path_factory):
    path, report = brought_in(tmp_path_factory.mktemp("activated"))
    return path, report, load_scene_file(report.scene).scene


def inserted(t):
    """Where the muscles end in the femur at a time: the patella flexes about z, by minus its angle, and moves down."""
    place = np.array([PATELLA_AT[0], -0.005 - 0.02 * t, PATELLA_AT[2]])
    return Rotation.from_rotvec([0, 0, -(FLEX + 0.4 * t)]).apply(INSERTION) + place


def along(*points) -> np.ndarray:
    return np.array([sum(np.linalg.norm(np.subtract(a, b)) for a, b in pairwise(points))])


def test_tensions_follow_from_lengths_of_whole_paths_and_the_activation(knee):
    path, report, scene = knee
    forces = {
        m.name: read_force(m, {})
        for k in ("Millard2012EquilibriumMuscle", "Thelen2003Muscle")
        for m in read_osim(path).all(k)
    }
    effect = scene.effect("quadriceps")
    for t in (0.0, 0.5, 1.0):
        pelvis = Rotation.from_rotvec([0, 0, 0.2 * t]).apply((0.04, 0.26, 0.02))
        lengths = {"vas int": along(START, VIA, inserted(t)), "recfem": along(pelvis, inserted(t))}
        expected = [forces[name].tensions(lengths[name], np.array([0.2]))[0] for name in lengths]
        tension, origin = effect.at(t)
        np.testing.assert_allclose(np.asarray(tension), expected, rtol=1e-5)
        np.testing.assert_allclose(np.asarray(origin.array()), [ANATOMICAL @ VIA, ANATOMICAL @ pelvis], atol=1e-6)
        if t == 0:
            assert report.tensions == pytest.approx(dict(zip(lengths, expected, strict=True)), rel=1e-6)
    assert effect.body == "femur"
    np.testing.assert_allclose(np.asarray(effect.insertion.array()), [ANATOMICAL @ INSERTION] * 2, atol=1e-7)
    assert min(expected) > 50


def test_notes_say_what_was_assumed(knee):
    _, report, scene = knee
    tensions = np.asarray(scene.effect("quadriceps").tension).sum(axis=1)
    (said,) = [n for n in report.notes if n.startswith("tensions by activations of 0.2")]
    assert "no force-velocity" in said
    assert f"together {tensions[0]:.3g} N in the first frame, {tensions.min():.3g} to {tensions.max():.3g} N" in said
    assert "lengths of muscles: with the patella where the model has it" in report.notes
    assert any(n.startswith("recfem from the pelvis: the line begins where") for n in report.notes)
    assert not {"vas int", "recfem"} & {part.name for part in report.left_out}


def test_a_file_has_an_activation_for_each_muscle_over_time(tmp_path):
    """By paths or by names; between its times linearly, in ten steps where the motion has fifty."""
    times = np.arange(11) / 10
    paths = ["time\t/forceset/vas int/activation\tother\trecfem"]
    rows = [f"{t}\t{0.1 + 0.6 * t}\t7\t{0.5 - 0.5 * t}" for t in times]
    (tmp_path / "a.sto").write_text("\n".join(["x", "inDegrees=yes", "endheader", *paths, *rows]) + "\n")
    names = ["time_s,vas int,recfem", *(f"{t},{0.1 + 0.6 * t},{0.5 - 0.5 * t}" for t in times)]
    (tmp_path / "a.csv").write_text("\n".join(names) + "\n")
    tables = []
    for kind in ("sto", "csv"):
        (tmp_path / kind).mkdir()
        path, report = brought_in(tmp_path / kind, activation=tmp_path / f"a.{kind}")
        tables.append((report.scene.parent / "tensions.csv").read_text())
    assert tables[0] == tables[1]
    t = 0.34
    tension = load_scene_file(report.scene).scene.effect("quadriceps").at(t)[0]
    force = read_force(next(read_osim(path).all("Millard2012EquilibriumMuscle")), {})
    expected = force.tensions(along(START, VIA, inserted(t)), np.array([0.1 + 0.6 * t]))
    assert float(tension[0]) == pytest.approx(expected[0], rel=1e-5)
    assert any("activations below the model's minimum_activation" in n and "recfem 0.01" in n for n in report.notes)


WRONG = {  # what is in the file, and what is said of it
    "a muscle's is missing": ("time_s,vas int\n0,0.1\n1,0.1\n", "no activation of recfem; expected: columns"),
    "it begins late": ("time_s,vas int,recfem\n0.5,0.1,0.1\n1,0.1,0.1\n", "from 0.5 s to 1 s; expected: for the whole"),
    "it ends early": ("time_s,vas int,recfem\n0,0.1,0.1\n0.9,0.1,0.1\n", "from 0 s to 0.9 s"),
    "percent": ("time_s,vas int,recfem\n0,0.1,0.1\n1,0.1,20\n", "row 2, recfem: an activation of 20; expected: 0 to 1"),
    "nothing in a cell": ("time_s,vas int,recfem\n0,,0.1\n1,0.1,0.1\n", "row 1, vas int: an activation of nan"),
}


@pytest.mark.parametrize("case", WRONG)
def test_files_that_cannot_be_are_refused_and_nothing_is_written(tmp_path, case):
    text, words = WRONG[case]
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        brought_in(tmp_path, activation=tmp_path / "a.csv")
    assert not (tmp_path / "scene").exists()


@pytest.mark.parametrize("given", [-0.1, 1.1, float("nan"), "inf"])
def test_what_is_no_activation_is_refused(tmp_path, given):
    with pytest.raises(InputError, match=r"activation: found .*; expected: an activation from 0 to 1"):
        brought_in(tmp_path, activation=given)


def test_a_tension_and_an_activation_exclude_each_other(tmp_path):
    with pytest.raises(InputError, match="activation: both a tension and an activation"):
        brought_in(tmp_path, quadriceps=20.0)
    with pytest.raises(InputError, match=r"no such file|does not exist|nothing\.sto"):
        brought_in(tmp_path, activation=tmp_path / "nothing.sto")


def test_muscles_of_which_no_force_is_known_are_named(tmp_path):
    odd = muscle("odd", (FEMUR, VIA), (PATELLA, INSERTION), kind="RigidTendonMuscle")
    off = muscle("off", (FEMUR, VIA), (PATELLA, INSERTION), more=FORCE + "<appliesForce>false</appliesForce>")
    over = muscle("over", (FEMUR, VIA), (PATELLA, INSERTION), (TIBIA, (0.045, -0.07, 0.0)))
    _, report = brought_in(tmp_path, odd + VASTUS + off + over)
    assert [*report.tensions] == ["vas int"]
    assert "odd: no tension, for none follows from the activation of a <RigidTendonMuscle>" in report.notes
    assert "off: no tension, it is switched off in the model" in report.notes
    assert "without a tension: odd, off, over" in report.notes
    assert {"odd", "off", "over"} <= {part.name for part in report.left_out}
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="no muscle of the patella can have a tension"):
        brought_in(tmp_path / "none", odd + off + over)


def test_a_patella_that_stays_while_the_knee_bends_is_said_loudly(tmp_path):
    _, report = brought_in(tmp_path, motion=None)
    assert any("IT DOES NOT MOVE in the femur while the knee bends" in note for note in report.notes)
    table = np.loadtxt(report.scene.parent / "tensions.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(np.ptp(table[:, 1:], axis=0), 0, atol=1e-9)


def test_a_measured_patella_gives_the_lengths_and_one_that_jumps_does_not(tmp_path):
    n = 31
    t = np.linspace(0, 1, n)
    femur, tibia = np.tile(np.eye(4), (n, 1, 1)), np.tile(np.eye(4), (n, 1, 1))
    femur[:, :3, 3] = FEMUR_AT
    tibia[:, :3, :3] = Rotation.from_rotvec(np.outer(-0.8 * t, [0, 0, 1])).as_matrix()
    patella = np.tile(np.eye(4), (n, 1, 1))
    patella[:, :3, 3] = np.outer(np.ones(n), PATELLA_AT) - np.outer(t, [0, 0.02, 0])
    lengths = np.array([along(START, VIA, p[:3, 3] + INSERTION)[0] for p in patella])
    patella[12, :3, 3] += (0.0, -0.04, 0.0)
    bodies = {"femur_r": femur, "tibia_r": femur @ tibia, "patella_r": femur @ patella}
    recording = written(tmp_path / "measured.sto", bodies, np.arange(n))
    path, report = brought_in(tmp_path, VASTUS, motion=recording, rate=30.0)
    (said,) = [note for note in report.notes if note.startswith("lengths of muscles: ")]
    assert "as it was measured, in frame 13, where that is out of line, as between the frames around" in said
    table = np.loadtxt(report.scene.parent / "tensions.csv", delimiter=",", skiprows=1)
    force = read_force(next(read_osim(path).all("Millard2012EquilibriumMuscle")), {})
    lengths[12] = 0.5 * (lengths[11] + lengths[13])
    np.testing.assert_allclose(table[:, 1], force.tensions(lengths, np.full(n, 0.2)), rtol=1e-6)


def command_for(folder) -> list[str]:
    path = knee_file(folder, VASTUS.replace("</GeometryPath>", f"{OVER}</GeometryPath>") + RECTUS, meshes=True)
    path.write_text(path.read_text().replace('<Body name="femur_r">', f'<Body name="femur_r">{ROLL}', 1))
    return ["import", str(path), "--motion", str(folder / "walk.mot"), "-o", str(folder / "out")]


@pytest.mark.slow
def test_the_command_takes_a_number(tmp_path):
    """In a process of its own: JAX has to be configured before wrapped lengths are computed."""
    command = command_for(tmp_path)
    alone = [sys.executable, "-m", "pftwin", *command, "--activation", "0.2"]
    done = subprocess.run(alone, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    said = " ".join(f"{done.stdout} {done.stderr}".split())
    assert "tensions by activations of 0.2" in said
    assert "wrapping is in the lengths of vas int" in said


def test_the_command_refuses_what_is_no_activation(tmp_path):
    command = command_for(tmp_path)
    done = CliRunner().invoke(app, [*command, "--activation", "strong"])
    assert done.exit_code == 2
    assert "strong" in done.output
    done = CliRunner().invoke(app, [*command, "--activation", "0.2", "--quadriceps", "20"])
    assert done.exit_code == 2
    assert "both a tension and an activation" in done.output


@pytest.mark.parametrize("muscles", ["", VASTUS.replace(">0.14<", ">0.4<")], ids=["no muscle", "a slack one"])
def test_a_scene_that_nothing_pulls_upward_is_code_3(tmp_path, muscles):
    path = knee_file(tmp_path, muscles, meshes=True)
    given = ["--activation", "0.2"] if muscles else []
    done = CliRunner().invoke(app, ["import", str(path), "-o", str(tmp_path / "out"), *given])
    assert done.exit_code == 3, done.output
    assert "scene.toml: nothing in it pulls the patella upward" in " ".join(done.stderr.split())
    assert (tmp_path / "out" / "scene.toml").is_file()
