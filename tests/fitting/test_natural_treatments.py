"""Treatments on the natural knee (synthetic) do what mechanics says: directions, closed forms, what stays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fitting.treatments import Treatment, femoral_derotation, trochleoplasty
from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.dynamics.simulate import equilibrium
from pftwin.geometry.bones.surfaces import bones
from pftwin.geometry.contact import distance_grid
from pftwin.rig.natural import scene as natural

NORMAL = rig.Anatomy()


@pytest.fixture(scope="module")
def knee():
    return rig.knee(duration=0.5, resolution_mm=2.0)


@pytest.fixture(scope="module")
def quickly():
    """Makes knees whose contact nobody looks at: its table of depths has cubes of 4 mm in the place of 1 mm."""

    def made(*given, **more):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(natural, "TABLE", 4e-3)
            patch.setattr(distance_grid, "_ALLOWED", np.inf)
            return rig.knee(*given, duration=0.5, resolution_mm=2.0, **more)

    return made


@pytest.fixture(scope="module")
def still(quickly):
    return quickly()


def points(vec) -> np.ndarray:
    return np.stack([np.asarray(a) for a in (vec.x, vec.y, vec.z)], axis=-1)


def test_derotation_turns_the_muscles_origins_inward_about_the_long_axis(still):
    """The knee turned externally, its front laterally (y): in its frame what is above turns by as much, z to -y."""
    before, after = (
        points(s.effect("quadriceps").origin) for s in (still, femoral_derotation(still, np.radians(15.0)))
    )
    expected = Rotation.from_euler("X", 15, degrees=True).apply(before.reshape(-1, 3)).reshape(before.shape)
    np.testing.assert_allclose(after, expected, atol=1e-6)
    assert np.all(after[..., 1] < before[..., 1])
    for name in ("mpfl", "lpfl", "patellar_tendon"):
        same = [points(s.effect(name).origin) for s in (still, femoral_derotation(still, 0.2))]
        np.testing.assert_array_equal(*same)


@pytest.mark.slow
def test_a_trochleoplasty_makes_the_trochlea_anew_and_leaves_soft_tissues(quickly):
    flat = rig.Anatomy.dejour("B")
    before = quickly(flat)
    deeper = {"sulcus_angle_deg": 145.0, "lateral_inclination_deg": 18.0, "trochlear_depth_mm": 4.0}
    after = quickly(flat, trochleoplasty=deeper | {"prominence_mm": 0.0})
    for name in ("mpfl", "lpfl", "patellar_tendon"):
        np.testing.assert_array_equal(*(s.get(f"{name}.slack_length") for s in (before, after)))
    np.testing.assert_array_equal(*(points(s.effect("quadriceps").origin) for s in (before, after)))
    new = rig.Anatomy(145.0, 18.0, flat.facet_ratio, 4.0, prominence_mm=0.0)
    assert after.bones is not None
    np.testing.assert_array_equal(after.bones.surfaces["femur"].vertices, bones(new, 2.0).femur.vertices)


def test_depth_with_less_radius_and_prominence_sets_the_floor_back_and_leaves_the_shaft():
    """Floor at the axis 23 to 19.6 mm from it; the shaft's front, radius less prominence, stays at 19."""
    flat = rig.Anatomy.dejour("B")
    lower = dataclasses.replace(
        flat,
        sulcus_angle_deg=140.0,
        lateral_inclination_deg=21.0,
        trochlear_depth_mm=5.0,
        trochlear_radius_mm=19.6,
        prominence_mm=0.6,
    )
    fronts = []
    for anatomy in (flat, lower):
        x, y, z = 1e3 * bones(anatomy, 2.0).femur.vertices.T
        at_axis, above = ((np.abs(x - place) < 2) & (z > 0) for place in (0.0, 70.0))
        fronts.append((z[at_axis & (np.abs(y) < 1)].max(), z[above].max()))
    (floor, shaft), (new_floor, new_shaft) = fronts
    assert floor == pytest.approx(23.0, abs=0.5)
    assert new_floor == pytest.approx(19.6, abs=0.5)
    assert new_shaft == pytest.approx(shaft, abs=0.5)


def test_what_a_trochleoplasty_cannot_change_is_refused(still):
    with pytest.raises(InputError, match=r"trochleoplasty: found 'tt_tg_mm'; expected: some of: sulcus_angle_deg, "):
        rig.knee(trochleoplasty={"tt_tg_mm": 10.0})
    with pytest.raises(InputError, match=r"try: another trochlea of a natural knee: pftwin.rig.knee\(anatomy, troch"):
        trochleoplasty(still, 0.002)


@pytest.mark.slow
def test_treatments_move_the_patella_where_they_pull_it(knee):
    """Origins and grafts that pull more medially leave it more medial; a tunnel moved away tightens the graft."""
    untreated = equilibrium(knee)
    assert untreated.converged
    for medial in (
        Treatment.of("tibial_tuberosity_transfer", medialisation=0.005),
        Treatment.of("femoral_derotation", external_rotation=np.radians(10.0)),
        Treatment.of("mpfl_graft", shortening=0.006, stiffening=1.0),
        Treatment.of("mpfl_graft", shortening=0.006, anteriorisation=-0.005),
    ):
        treated = equilibrium(medial(knee))
        assert treated.converged, medial.describe()
        assert treated.position[1] < untreated.position[1] - 0.05e-3, medial.describe()


@pytest.mark.slow
def test_released_strands_lengthen(knee):
    """Of a stable equilibrium: without a pull the ends go apart."""
    tight = knee.set("lpfl.slack_length", knee.get("lpfl.slack_length") - 0.006)
    held, released = (equilibrium(t(tight)) for t in (Treatment(), Treatment.of("lateral_release", release=1.0)))
    assert held.converged
    assert released.converged
    ends = knee.effect("lpfl")

    def length(at) -> float:
        turn = Rotation.from_quat(at.quaternion, scalar_first=True)
        return np.linalg.norm(at.position + turn.apply(points(ends.insertion)) - points(ends.origin), axis=1).mean()

    assert length(released) > length(held) + 0.1e-3


@pytest.mark.slow
def test_a_trochlea_made_deeper_takes_away_lateral_tilt():
    flat = rig.Anatomy.dejour("B")
    deeper = {"sulcus_angle_deg": 140.0, "lateral_inclination_deg": 21.0, "trochlear_depth_mm": 5.0}
    tilts = []
    for numbers in ({}, deeper | {"prominence_mm": 0.0}):
        at = equilibrium(rig.knee(flat, duration=0.5, resolution_mm=2.0, trochleoplasty=numbers))
        assert at.converged
        front = Rotation.from_quat(at.quaternion, scalar_first=True).apply([0.0, 0.0, 1.0])
        tilts.append(np.degrees(np.arctan2(front[1], front[2])))
    assert tilts[1] < tilts[0] - 2
