"""Muscles of OpenSim models as prescribed tensions."""

from __future__ import annotations

import re

import numpy as np
import pytest
from knee_models import FEMUR, FEMUR_AT, MUSCLE, PATELLA, START, TIBIA, model, point, write_knee
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.interchange import import_osim
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_lines import PatellarMuscle, shared_tensions
from pftwin.files.scene_file import load_scene_file
from pftwin.model.number_place import starting_instant

ANATOMICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # proximal, lateral, anterior of x, y, z


def muscle(name: str, strength: float, *points: tuple[str, tuple[float, ...]]) -> str:
    path = "".join(point(f"{name}{k}", frame, place) for k, (frame, place) in enumerate(points))
    return (
        f'<Millard2012EquilibriumMuscle name="{name}"><GeometryPath name="geometrypath"><PathPointSet><objects>{path}'
        f"</objects></PathPointSet></GeometryPath><max_isometric_force>{strength}</max_isometric_force>"
        "</Millard2012EquilibriumMuscle>"
    )


MUSCLES = (
    muscle("vas int", 900, (FEMUR, (0.035, 0.22, 0.012)), (FEMUR, (0.04, 0.12, 0.01)), (PATELLA, (-0.008, 0.02, 0.0)))
    + muscle("vaslat", 2100, (FEMUR, (0.03, 0.13, 0.039)), (PATELLA, (0.0017, 0.015, 0.012)))
    + muscle("recfem", 1200, ("/ground", (0.0, 0.9, 0.02)), (PATELLA, (0.0, 0.018, 0.001)))
    + muscle("pes", 500, (TIBIA, (0.03, -0.02, -0.02)), (FEMUR, (0.0, 0.2, 0.0)))
)


@pytest.fixture(scope="module")
def knee(tmp_path_factory):
    folder = tmp_path_factory.mktemp("muscles")
    forces = model().index("<Millard2012EquilibriumMuscle")
    path = write_knee(folder / "model", model()[:forces] + MUSCLES + model()[forces:])
    report = import_osim(path, folder / "scene", quadriceps=42.0)
    return load_scene_file(report.scene).scene, report


def test_a_tension_is_shared_by_strength(knee):
    """Of 900, 2100, 1200 N and the 5000 N of the model's own muscle."""
    _, report = knee
    whole = 900 + 2100 + 1200 + 5000
    expected = {"vas int": 900 * 42 / whole, "vaslat": 2100 * 42 / whole, "recfem": 1200 * 42 / whole}
    assert report.tensions == pytest.approx(expected | {"vasint_r": 5000 * 42 / whole})
    assert any(note.startswith("tensions, constant, by maximum isometric force") for note in report.notes)
    assert not {part.name for part in report.left_out} & {*report.tensions}
    assert "pes" in {part.name for part in report.left_out}


def test_they_pull_along_the_last_straight_piece_of_their_paths(knee):
    """That from the ground, to which the femur is welded in this model, from the femur too."""
    scene, report = knee
    welded = Rotation.from_euler("y", 0.1).inv().apply(np.array([0.0, 0.9, 0.02]) - FEMUR_AT)
    lines = {
        "recfem": (welded, (0.0, 0.018, 0.001)),
        "vas int": ((0.04, 0.12, 0.01), (-0.008, 0.02, 0.0)),
        "vaslat": ((0.03, 0.13, 0.039), (0.0017, 0.015, 0.012)),
        "vasint_r": ((0.035, 0.22, 0.012), (-0.008, 0.02, 0.0)),
    }
    effect = scene.effect("quadriceps")
    tension, origin = (np.asarray(a) for a in (effect.at(0.0)[0], effect.at(0.0)[1].array()))
    for name, (start, end) in lines.items():
        k = int(np.argmin(np.abs(tension - report.tensions[name])))
        assert float(tension[k]) == pytest.approx(report.tensions[name], rel=1e-6)
        np.testing.assert_allclose(origin[k], ANATOMICAL @ start, atol=1e-7)
        np.testing.assert_allclose(np.asarray(effect.insertion.array())[k], ANATOMICAL @ end, atol=1e-7)
    assert (len(tension), effect.body) == (4, "femur")
    np.testing.assert_array_equal(effect.at(scene.motion.end_time)[0], effect.at(scene.motion.start_time)[0])


def test_what_comes_from_elsewhere_has_no_tension():
    """A muscle from the pelvis, of which a scene knows nothing, and one without a strength."""
    at = np.array([0.1, 0.2, 0.3])
    pelvis = PatellarMuscle(Element("Muscle", "recfem", "m.osim", 1), at, at, "pelvis", 800.0)
    unknown = PatellarMuscle(Element("PathSpring", "band", "m.osim", 1), at, at, "femur", None)
    vastus = PatellarMuscle(Element("Muscle", "vaslat", "m.osim", 1), at, at, "femur", 800.0)
    assert shared_tensions([pelvis, vastus, unknown], 12.0) == {"vaslat": 12.0}
    with pytest.raises(InputError, match="no muscle of the patella can have a tension"):
        shared_tensions([pelvis, unknown], 12.0)
    for total in (0.0, -3.0, np.nan, np.inf):
        with pytest.raises(InputError, match="quadriceps: found"):
            shared_tensions([vastus], total)


PATH = ((FEMUR, (0.035, 0.22, 0.012)), (FEMUR, (0.04, 0.12, 0.01)), (PATELLA, (-0.008, 0.02, 0.0)))


def only(folder, forces: str, **options):
    """What is told of an import whose muscles are these."""
    text = model()
    text = text.replace(MUSCLE, forces)
    assert forces in text
    return import_osim(write_knee(folder / "model", text), folder / "scene", **options)


def test_a_path_may_begin_at_the_patella(tmp_path):
    report = only(tmp_path, muscle("a", 900, *PATH) + muscle("b", 900, (PATELLA, (0.0, 0.0, 0.0)), *PATH[::-1]))
    (a, b) = report.muscles
    np.testing.assert_allclose(a.origin, b.origin)
    np.testing.assert_allclose(a.insertion, b.insertion)
    assert a.takes_tension
    assert b.takes_tension


def test_points_that_move_and_paths_over_the_patella_are_left_out(tmp_path):
    point = r'<PathPoint (name="moving1".*?)</PathPoint>'
    moving = re.sub(point, r"<ConditionalPathPoint \1</ConditionalPathPoint>", muscle("moving", 900, *PATH))
    over = muscle("over", 900, *PATH, (TIBIA, (0.045, -0.07, 0.0)))
    report = only(tmp_path, moving + over)
    assert [m.takes_tension for m in report.muscles] == [False, False]
    np.testing.assert_allclose(report.muscles[0].origin, (0.04, 0.12, 0.01))
    why = {part.name: part.why for part in report.left_out}
    for name in ("moving", "over"):
        assert why[name].startswith("its points move, or it passes over the patella")


def test_a_muscle_without_length_is_left_out_by_name(tmp_path):
    """One between a point of the femur and the patella's origin, which the model puts there; and two of one place."""
    place = (START["pf_tx_r"], START["pf_ty_r"], START["pf_tz_r"])
    origin = (PATELLA, (0.0, 0.0, 0.0))
    forces = muscle("pulls", 900, *PATH) + muscle("none", 900, (FEMUR, place), origin)
    forces += muscle("twice", 900, origin, origin) + muscle("once", 900, origin)
    report = only(tmp_path, forces, quadriceps=10.0)
    assert report.tensions == {"pulls": 10.0}
    why = {part.name: part.why for part in report.left_out}
    assert why["none"].startswith("its line has no length where the model has the patella; insertion_m = [0, 0, 0]")
    assert why["twice"] == why["once"] == "its path has no length: all its points are in the same place"


def test_names_that_are_equal_in_a_scene_are_refused():
    at = np.array([0.1, 0.2, 0.3])
    alike = [
        PatellarMuscle(Element("Muscle", name, "m.osim", 1), at, at, "femur", 800.0) for name in ("vas int", "vas_int")
    ]
    with pytest.raises(InputError, match="vas_int"):
        shared_tensions(alike, 12.0)


def test_nothing_is_written_where_a_tension_is_refused(tmp_path):
    path = write_knee(tmp_path / "model")
    with pytest.raises(InputError, match="quadriceps: found -1"):
        import_osim(path, tmp_path / "scene", quadriceps=-1.0)
    assert not (tmp_path / "scene").exists()


def test_a_tension_at_flexions_keeps_its_shares(knee, tmp_path):
    """At each of them the tension is the constant one, until one is changed."""
    constant, report = knee
    forces = model().index("<Millard2012EquilibriumMuscle")
    path = write_knee(tmp_path / "model", model()[:forces] + MUSCLES + model()[forces:])
    made = import_osim(path, tmp_path / "scene", quadriceps=42.0, quadriceps_knots=(0, 30, 75.5))
    scene = load_scene_file(made.scene).scene
    assert made.tensions == report.tensions
    now = starting_instant(scene)
    effect, other = scene.effect("quadriceps"), constant.effect("quadriceps")
    np.testing.assert_allclose(effect.tension, [42, 42, 42])
    np.testing.assert_allclose(np.degrees(effect.knots), [0, 30, 75.5])
    np.testing.assert_allclose(effect.tensions(now), other.tensions(now), rtol=1e-9)
    np.testing.assert_array_equal(effect.origin.array(), other.origin.array())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"quadriceps_knots": (0, 30)}, "quadriceps_knots: flexions without a tension"),
        ({"quadriceps_knots": (0, 30), "activation": 0.1}, "quadriceps_knots: flexions without a tension"),
        ({"quadriceps_knots": (30, 0), "quadriceps": 10.0}, "quadriceps_knots: tensions at flexions of 30, 0 deg"),
        ({"quadriceps_knots": (30,), "quadriceps": 10.0}, "at least two flexions"),
    ],
)
def test_flexions_that_make_no_tension_are_refused_before_anything_is_written(tmp_path, options, said):
    path = write_knee(tmp_path / "model")
    with pytest.raises(InputError, match=said):
        import_osim(path, tmp_path / "scene", **options)
    assert not (tmp_path / "scene").exists()
