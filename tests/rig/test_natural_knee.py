"""The natural knee in motion (synthetic): where its parts are, what they pull, and a patella that tracks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.base.rotations import tibiofemoral_angles
from pftwin.dynamics.simulate import equilibrium, simulate
from pftwin.dynamics.status import Status
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.tibiofemoral import FemurShape
from pftwin.model.motion_on_host import tibia_orientation
from pftwin.rig.natural import motion, placing

NORMAL = Anatomy()


def test_the_tibia_moves_as_prescribed():
    done = motion.squat(2.0)
    flexion, adduction, rotation = (np.degrees(a) for a in tibiofemoral_angles(tibia_orientation(done.motion)))
    np.testing.assert_allclose(flexion, done.flexion, atol=1e-4)
    np.testing.assert_allclose(adduction, 0, atol=1e-4)
    np.testing.assert_allclose(flexion[[0, len(flexion) // 2, -1]], [15, 90, 15], atol=1e-4)
    assert rotation[flexion > 30.1] == pytest.approx(8, abs=1e-3)
    assert rotation[flexion < 16].max() < 5  # the last degrees of extension turn it outward


def test_frames_are_even_so_that_one_is_at_the_deepest():
    assert motion.squat(0.35).flexion.max() == pytest.approx(90, abs=1e-9)


def test_the_squat_leans_thigh_and_shank_alike_and_pulls_with_the_sine():
    done = motion.squat(1.0)
    frame = done.motion.frames(done.motion.times)[0]
    assert frame is not None
    proximal = np.asarray(frame.rotation.array())[:, :, 0]
    half = np.radians(done.flexion / 2)
    np.testing.assert_allclose(proximal, np.stack([np.cos(half), 0 * half, -np.sin(half)], axis=1), atol=1e-5)
    np.testing.assert_allclose(done.pull, np.sin(half) / np.sin(np.radians(45)))


def test_in_an_extension_the_thigh_is_horizontal_and_the_pull_follows_the_weights_lever():
    """The shank's proximal axis leans backward as it is raised: its horizontal part is the lever."""
    done = motion.extension(1.0)
    femur, tibia = done.motion.frames(done.motion.times)
    assert femur is not None
    axes = np.asarray(femur.rotation.array())
    np.testing.assert_allclose(axes[:, :, 0], np.tile([0, 0, -1], (len(axes), 1)), atol=1e-6)
    np.testing.assert_allclose(axes[:, :, 2], np.tile([1, 0, 0], (len(axes), 1)), atol=1e-6)  # its front is up
    np.testing.assert_allclose(done.flexion[[0, 30, -1]], [90, 15, 90])
    lever = -np.asarray(tibia.rotation.array())[:, 2, 0]
    np.testing.assert_allclose(done.pull, 0.05 + 0.95 * lever / lever[30], atol=1e-5)


def test_the_four_parts_share_the_pull_and_leave_at_their_angles():
    """Farahmand et al. 1998: together nearly along the shaft."""
    ends = placing.muscles(NORMAL)
    place, turn = placing.rest_pose(NORMAL, 0.0)
    way = ends.body - place - turn.apply(ends.patella)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    share = np.array([s for s, _ in placing.QUADRICEPS.values()])
    assert share.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.degrees(np.arctan2(way[:, 1], way[:, 0])), [-27, 18.5, 0, 0], atol=1e-6)
    whole = share @ way
    assert 0 < np.degrees(np.arctan2(whole[1], whole[0])) < 4


@pytest.mark.parametrize("ratio", [0.85, 1.02, 1.3])
@pytest.mark.parametrize("flexion", [0.0, 15.0, 90.0])
def test_at_first_the_patella_lies_in_the_groove_at_its_height(ratio, flexion):
    anatomy = Anatomy(insall_salvati=ratio)
    place, turn = placing.rest_pose(anatomy, flexion)
    apex, tuberosity = (points[2] for points in placing.patellar_tendon(anatomy))  # of the middle strand
    inward = 8.0 if flexion > 30 else (0.0 if flexion == 0 else 4.0)  # half of it at half of 30 deg
    tibia = Rotation.from_euler("YZX", [-flexion, 0, inward], degrees=True)
    axis = np.array([-5.0, 0.0, -8.0])  # about which it turns
    line = place + turn.apply(apex) - axis - tibia.apply(tuberosity - axis)
    assert np.linalg.norm(line) == pytest.approx(ratio * anatomy.patella_height_mm)
    if place[0] < 0:  # on the groove's circle, or where it would be over the notch
        assert np.hypot(place[0], place[2]) == pytest.approx(anatomy.trochlear_radius_mm)
    else:  # on the bone; 2 cm above the axis the shaft is blended in
        assert FemurShape(anatomy)(place[None]).item() == pytest.approx(0, abs=0.05 if place[0] < 15 else 0.7)


def test_a_ratio_that_is_refused_is_made_good_by_what_the_message_says():
    with pytest.raises(InputError, match=r"expected: a ratio of 1.31 to 2.48 for this height") as said:
        placing.rest_pose(Anatomy(patella_height_mm=30.0), 0.0)
    assert said.value.where == "insall_salvati, patella_height_mm"
    placing.rest_pose(Anatomy(patella_height_mm=30.0, insall_salvati=1.31), 0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"quadriceps": 1e5}, r"quadriceps: found 100000.0; expected: 20 to 5000"),
        ({"activity": "walk"}, r"activity: found 'walk'; expected: one of: squat, extension"),
        ({"duration": 0.0}, r"duration: found 0.0; expected: 0.2 to 60 s"),
        ({"resolution_mm": 3.0}, r"resolution_mm: found 3.0; expected: 0.5 to 2"),
    ],
)
def test_what_no_knee_does_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        rig.knee(**options)


@pytest.fixture(scope="module")
def squat():
    return simulate(rig.knee(duration=0.5, resolution_mm=2.0), dt=1 / 120)


@pytest.mark.slow
def test_the_squat_is_valid_and_in_its_groove(squat):
    assert squat.verdict.valid, squat.verdict.describe()
    assert squat.status == Status.OK
    assert not squat.dislocations().events


@pytest.mark.slow
def test_the_patella_flexes_more_slowly_than_the_knee(squat):
    """By 5 to 40 % over the whole squat, 15 % at the least where bent: bounds as wide as published knees differ."""
    knee, patella = squat.knee.flexion, squat.angles.flexion
    deep, bent = int(np.argmax(knee)), np.degrees(knee) > 40
    assert 0.6 < (patella[deep] - patella[0]) / (knee[deep] - knee[0]) < 0.95
    assert np.all((patella / knee)[bent] < 0.85)


@pytest.mark.slow
def test_the_patella_stays_within_millimetres_and_degrees(squat):
    assert np.abs(squat.shift).max() < 6e-3
    assert np.abs(np.degrees(squat.angles.tilt)).max() < 15


@pytest.mark.slow
def test_the_strands_of_the_tendon_share_its_pull_in_full_extension():
    """Equal stiffness per strain, slack at the lengths of full extension: stretched alike they pull alike."""
    scene = rig.knee(duration=0.5, resolution_mm=2.0)
    ends = placing.patellar_tendon(NORMAL)
    place, turn = placing.rest_pose(NORMAL, 0.0)
    length = 1e-3 * np.linalg.norm(place + turn.apply(ends.patella) - ends.body, axis=1)
    np.testing.assert_allclose(np.asarray(scene.get("patellar_tendon.slack_length")), length, rtol=1e-5)
    np.testing.assert_allclose(
        np.asarray(scene.get("patellar_tendon.stiffness")), 660e6 * 100e-6 / 5
    )  # Johnson et al. 1994, 100 mm2


@pytest.mark.slow
def test_tendon_and_contact_by_quadriceps_lie_in_wide_bounds_and_change_as_measured(squat):
    """Patellar tendon to quadriceps about 1 near extension and less as the knee bends; contact rises with flexion."""
    pull = squat.effects["quadriceps"]["tension"]
    tendon = squat.effects["patellar_tendon"]["tension"] / pull
    force = squat.effects["contact"]["force"] / pull
    deep = int(np.argmax(squat.knee.flexion))
    assert pull[deep] == pytest.approx(700, rel=1e-3)
    assert 0.85 < tendon[0] < 1.3
    assert 0.3 < tendon[deep] < 0.8
    assert force[0] < 0.6 < 0.8 < force[deep] < 1.3
    contact = squat.effects["contact"]
    assert contact["force_lateral"][deep] > contact["force_medial"][deep]
    assert 150e-6 < contact["area"][deep] < 600e-6


@pytest.mark.slow
def test_an_extension_is_clean_and_bears_as_much_in_proportion_as_a_squat(squat):
    """Slow motions: at the same flexion forces by quadriceps are alike, though in a squat they grow as it bends."""
    done = simulate(rig.knee(activity="extension", duration=1.0, resolution_mm=2.0), dt=1 / 480)
    assert done.verdict.valid, done.verdict.describe()
    assert done.status == Status.OK
    bending = slice(0, int(np.argmax(squat.knee.flexion)) + 1), slice(int(np.argmin(done.knee.flexion)), None)
    ratios = [
        np.interp(np.radians([30, 50, 70]), r.knee.flexion[part], (force / r.effects["quadriceps"]["tension"])[part])
        for r, part in zip((squat, done), bending, strict=True)
        for force in (r.effects["patellar_tendon"]["tension"], r.effects["contact"]["force"])
    ]
    np.testing.assert_allclose(ratios[:2], ratios[2:], atol=0.05)
    tendon = ratios[2]
    assert 0.6 < tendon[2] < tendon[0] < 1.1  # 0.65 at 70 deg in extensions against resistance, Buff et al. 1988


@pytest.mark.slow
def test_the_medial_ligament_hangs_slack_in_a_bent_knee(squat):
    """If at all: Amis et al. 2003, Knee 10:215."""
    bent = np.degrees(squat.knee.flexion) > 45
    assert squat.effects["mpfl"]["tension"][bent].max() < 5


@pytest.mark.slow
def test_a_weak_vastus_medialis_lets_the_patella_go_laterally():
    whole = rig.knee(duration=0.5, resolution_mm=2.0)
    pull = np.array(whole.get("quadriceps.tension"))
    pull[:, 0] = 0.0
    one, other = (equilibrium(scene) for scene in (whole, whole.set("quadriceps.tension", pull)))
    assert one.converged
    assert other.converged
    assert other.position[1] > one.position[1] + 0.2e-3
