"""Clinical indices of a scene whose every landmark is known by hand."""

from __future__ import annotations

from functools import cache

import equinox as eqx
import numpy as np
import pytest
import scenes
from scipy.spatial.transform import Rotation

from fitting.prediction.clinical_indices import USUAL, ClinicalIndices, Landmarks, clinical_indices
from fitting.treatments import femoral_component_rotation, tibial_tuberosity_transfer, trochleoplasty
from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Quaternion
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene

DEPTH, WIDTH, HALF = 0.006, 0.015, 0.020  # of the groove, to its ridges, of the patch [m]
FLEXION = np.radians(np.linspace(50, 20, 7))
ADDUCTION = np.radians(4)


def valley() -> PolynomialPatch:
    """height = depth (2 s - s^2), s = (v / width)^2: bottom at v = 0, ridges at +-width; facing front."""
    b = HALF / WIDTH
    wanted = {(0, 2): 2 * DEPTH * b**2, (0, 4): -DEPTH * b**4}
    return scenes.patch_of([wanted.get(e, 0.0) for e in exponents(4)], 4, (0.02, HALF))


@cache
def knee() -> Scene:
    """A tibia that extends from 50 to 20 deg in 4 deg of varus, its origin at the femur's."""
    times = 0.01 * np.arange(FLEXION.size)
    turns = Rotation.from_euler("YZ", np.stack([-FLEXION, np.full(FLEXION.size, ADDUCTION)], 1))
    tibia = PoseSeries(times, np.zeros((times.size, 3)), turns.as_quat(scalar_first=True))
    scene = scenes.knee(11).with_effect(eqx.tree_at(lambda c: c.surface, scenes.knee(5).contact, valley()))
    start = Pose(scenes.vec(0.01, 0.002, 0.04), Quaternion.identity())
    return eqx.tree_at(lambda s: (s.motion, s.start), scene, (KneeMotion.from_poses(None, tibia), start))


@cache
def plain() -> ClinicalIndices:
    return clinical_indices(knee())


def tuberosity(flexion: float) -> np.ndarray:
    return Rotation.from_euler("YZ", [-flexion, ADDUCTION]).apply([-0.07, 0.01, 0.045])  # as scenes.knee has it


@pytest.mark.slow
def test_tt_tg_is_taken_at_least_flexion_unless_asked_for():
    found = clinical_indices(knee()).tt_tg
    assert found.value == pytest.approx(1e3 * tuberosity(FLEXION[-1])[1])
    assert "at 20.0 deg of knee flexion" in found.note
    bent = clinical_indices(knee(), flexion=FLEXION[0]).tt_tg
    assert bent.value == pytest.approx(1e3 * tuberosity(FLEXION[0])[1])
    assert "at 50.0 deg" in bent.note


def test_medialisation_shortens_tt_tg_by_itself():
    after = clinical_indices(tibial_tuberosity_transfer(knee(), 0.01))
    assert plain().tt_tg.value - after.tt_tg.value == pytest.approx(10 * np.cos(ADDUCTION))


def test_q_angle_lies_between_the_two_lines_in_the_frontal_plane():
    patella, quadriceps, below = np.array([0.01, 0.002]), np.array([0.22, 0.012]), tuberosity(FLEXION[0])[:2]
    one, two = quadriceps - patella, below - patella
    outside = 180 - np.degrees(np.arccos(one @ two / np.linalg.norm(one) / np.linalg.norm(two)))
    found = plain().q_angle
    assert found.value == pytest.approx(outside)
    assert found.value > 0  # the tuberosity lies laterally
    assert "line of pull: the iliac spine is not in the scene" in found.note
    wide = clinical_indices(knee(), landmarks=Landmarks(asis=(0.4, 0.06, 0.0))).q_angle
    turned = np.degrees(np.arctan2(0.058, 0.39) - np.arctan2(0.010, 0.21))
    assert wide.value - found.value == pytest.approx(turned)


def test_sulcus_angle_and_inclination_of_a_known_valley():
    found = plain()
    assert found.sulcus_angle.value == pytest.approx(2 * np.degrees(np.arctan2(WIDTH, DEPTH)), abs=0.05)
    v = np.linspace(0, WIDTH, 2000)
    s = (v / WIDTH) ** 2
    covariance = np.cov(v, DEPTH * (2 * s - s * s))
    along = np.linalg.eigh(covariance)[1][:, 1]
    inclination = np.degrees(np.arctan(along[1] / along[0]))
    assert found.lateral_trochlear_inclination.value == pytest.approx(inclination, abs=0.1)


def test_external_rotation_lowers_the_lateral_facet_and_deepening_raises_it():
    turned = clinical_indices(femoral_component_rotation(knee(), external_rotation=np.radians(5)))
    change = turned.lateral_trochlear_inclination.value - plain().lateral_trochlear_inclination.value
    assert change == pytest.approx(-5)
    assert turned.sulcus_angle.value == pytest.approx(plain().sulcus_angle.value)
    deeper = clinical_indices(trochleoplasty(knee(), 0.002))
    assert deeper.sulcus_angle.value < plain().sulcus_angle.value - 5
    assert deeper.lateral_trochlear_inclination.value > plain().lateral_trochlear_inclination.value + 2


def test_caton_deschamps_needs_its_landmarks():
    found = clinical_indices(knee(), landmarks=Landmarks(articular_inferior=(-0.015, 0, 0))).caton_deschamps
    assert found.value is None
    assert found.note.endswith("tibial plateau, articular superior")
    points = Landmarks(None, (-0.03, 0.0, 0.03), (-0.015, 0.0, 0.0), (0.015, 0.0, 0.0))
    corner = Rotation.from_euler("YZ", [-FLEXION[0], ADDUCTION]).apply([-0.03, 0, 0.03])
    distance = np.linalg.norm(np.array([-0.005, 0.002, 0.04]) - corner)
    assert clinical_indices(knee(), landmarks=points).caton_deschamps.value == pytest.approx(distance / 0.030)


def test_what_is_usual_stands_beside_what_is_known():
    found = plain()
    lines = dict(line.split(": ", 1) for line in found.describe().splitlines())
    assert set(USUAL) == set(found.__dataclass_fields__)
    assert "of knee flexion" in lines["tt tg"]
    assert "15 +- 3 mm there" in lines["tt tg"]
    assert lines["lateral trochlear inclination"].endswith("below 11 deg dysplastic (Carrillon et al. 2000)")
    assert "usual" not in lines["caton deschamps"]  # for it is not known


def test_what_a_scene_lacks_is_not_guessed():
    bare = clinical_indices(knee().without("contact"))
    assert bare.tt_tg.value is None
    assert "no contact" in bare.sulcus_angle.note
    loose = clinical_indices(knee().without("patellar_tendon").without("quadriceps"))
    assert loose.tt_tg.value is None
    assert "patellar_tendon" in loose.tt_tg.note
    assert loose.q_angle.value is None
    assert "neither" in loose.q_angle.note
    contact = knee().contact
    assert contact is not None
    bowl = contact.with_fitted_surface(scenes.fitted(lambda u, v: 25 * v**2, 2))
    rising = clinical_indices(knee().with_effect(bowl))
    assert rising.sulcus_angle.value is None
    assert "no medial and no lateral ridge" in rising.sulcus_angle.note
    assert "sulcus angle: not known (no medial and no lateral ridge" in rising.describe()


def test_cases_1_and_2_differ_by_their_tuberosities():
    one, two = (clinical_indices(rig.case(n), flexion=np.radians(45)) for n in (1, 2))
    assert two.tt_tg.value - one.tt_tg.value == pytest.approx(16, abs=1)
    assert two.sulcus_angle.value == one.sulcus_angle.value


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"flexion": 2.5}, r"143\.2 deg was not recorded.*20 to 50 deg"),
        ({"level": 1.5}, r"level: found 1\.5"),
        ({"landmarks": Landmarks(asis=(0.1, 0.2))}, "three finite numbers"),
        ({"landmarks": Landmarks(tibial_plateau=(0.1, np.nan, 0))}, r"landmarks\.tibial_plateau"),
    ],
)
def test_bad_input_is_named(options, message):
    with pytest.raises(InputError, match=message):
        clinical_indices(knee(), **options)
