"""Errors against measurements with known offsets; the paper's table; dislocations in made-up and fitted grooves."""

from __future__ import annotations

import dataclasses
import re

import equinox as eqx
import numpy as np
import pytest
from scenes import J
from small_scene import GROOVE_AT, groove, polynomial, small_result

import pftwin
from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array
from pftwin.base.rotations import patellar_angles, patellar_orientation
from pftwin.base.spatial import Quaternion
from pftwin.dynamics.status import Status
from pftwin.model.measured import Measured
from pftwin.results import tracking
from pftwin.results.metrics import PAPER_TABLE_1, mean_of, validate


@pytest.fixture(scope="module")
def result():
    return small_result()


def measured_of(result, **changes) -> Measured:
    a = result.angles
    values = {
        "center": result.center,
        "flexion": a.flexion,
        "rotation": a.rotation,
        "tilt": a.tilt,
        "contact_force": result.effects["contact"]["force"],
        "tibial_spring_force": result.effects["patellar_tendon"]["tension"],
        "femoral_spring_force": result.effects["quadriceps"]["tension"],
        **changes,
    }
    turned = host_array(patellar_orientation(*(values.pop(name) for name in a._fields)))
    return Measured(values.pop("times", result.times), quaternion=turned, **values)


def test_a_perfect_twin_has_no_error(result):
    v = validate(result, measured_of(result))
    for row in v.to_rows()[:10]:
        assert row.value == pytest.approx(0.0, abs=1e-9), row.label
    assert v.initial_configuration == result.timing["equilibrium_s"]
    assert v.real_time_factor == pytest.approx(0.4 / result.timing["run_s"])


def test_known_offsets_come_out_in_the_table_units(result):
    a = result.angles
    wave = np.sqrt(2) * np.sin(2 * np.pi * np.arange(result.times.size - 1) / 20)  # rms 1 over whole periods
    wave = np.append(wave, 1.0)
    v = validate(
        result,
        measured_of(
            result,
            center=result.center + np.array([1e-3, -2e-3, 2e-3]),
            flexion=a.flexion + np.radians(1.5) * wave,
            rotation=a.rotation - np.radians(0.5),
            tilt=a.tilt + np.radians(4.0),
            contact_force=result.effects["contact"]["force"] + 3 * wave,
            tibial_spring_force=result.effects["patellar_tendon"]["tension"] - 2,
            femoral_spring_force=None,
        ),
    )
    assert (v.x, v.y, v.z) == pytest.approx((1.0, 2.0, 2.0))
    assert v.mean_distance == pytest.approx(3.0)
    assert (v.flexion, v.internal_rotation, v.tilt) == pytest.approx((1.5, 0.5, 4.0))
    assert (v.contact_force, v.tibial_spring) == pytest.approx((3.0, 2.0))
    assert v.femoral_spring is None


def test_angles_are_compared_around_the_circle(result):
    a = result.angles
    v = validate(result, measured_of(result, tilt=a.tilt + 2 * np.pi - np.radians(2)))
    assert v.tilt == pytest.approx(2.0)


def test_missing_frames_are_left_out_and_counted(result):
    center = result.center + np.array([1e-3, 0.0, 0.0])
    center[4:9] = np.nan
    tilt = np.where(np.arange(result.times.size) < 10, np.nan, result.angles.tilt)
    v = validate(result, measured_of(result, center=center, tilt=tilt))
    assert v.frames - v.frames_compared == 5
    assert v.x == pytest.approx(1.0)
    assert v.tilt == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(InputError, match="no frame has a measured position"):
        validate(result, measured_of(result, center=np.full_like(center, np.nan)))


def test_frames_that_are_not_finite_in_the_simulation_are_not_hidden(result):
    center = result.center.copy()
    center[-1] = np.nan
    v = validate(dataclasses.replace(result, center=center), measured_of(result))
    assert np.isnan(v.x)
    assert np.isnan(v.mean_distance)


def test_positions_alone_can_be_validated(result):
    v = validate(result, Measured(result.times, result.center))
    assert (v.tilt, v.flexion, v.contact_force) == (None, None, None)
    assert v.mean_distance == 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (lambda m: {"contact_force": 1e3 * m.contact_force}, "contact force .* N rms, the simulated one .* unit"),
        (lambda m: {"femoral_spring_force": m.femoral_spring_force / 4.4482}, "femoral spring .* unit and channel"),
        (lambda m: {"tibial_spring_force": -m.tibial_spring_force}, "tibial spring is negative: check its sign"),
        (
            lambda m: {"center": 1e3 * m.center},
            "centre is .* mm or more from the simulated one: check its unit",
        ),
    ],
)
def test_measurements_in_another_unit_sign_or_frame_are_doubted(result, changes, words):
    right = measured_of(result)
    assert validate(result, right).doubts == ()
    [said] = validate(result, dataclasses.replace(right, **changes(right))).doubts
    assert re.search(words, said)


def test_exchanged_springs_are_doubted_also_with_gaps_and_noise(result):
    right, random = measured_of(result), np.random.default_rng(5)
    noise = 0.1 * random.normal(size=(2, result.times.size))
    noise[0, 3:9] = np.nan
    # Both springs pull more than the twin's, as in the rig's cases.
    forces = (1.16 * right.tibial_spring_force + noise[0], 1.07 * right.femoral_spring_force + noise[1])
    names = ("tibial_spring_force", "femoral_spring_force")
    assert validate(result, dataclasses.replace(right, **dict(zip(names, forces, strict=True)))).doubts == ()
    [said] = validate(result, dataclasses.replace(right, **dict(zip(names, forces[::-1], strict=True)))).doubts
    assert "tibial and femoral spring" in said
    assert said.endswith("check their channels")


def test_springs_that_are_alike_or_measured_once_are_not_called_exchanged(result):
    right = measured_of(result)
    twice = dataclasses.replace(right, femoral_spring_force=right.tibial_spring_force)
    assert validate(result, twice).doubts == ()
    assert validate(result, dataclasses.replace(right, tibial_spring_force=None)).doubts == ()


def test_forces_of_a_twin_with_stiffness_off_by_half_are_not_doubted(result):
    right = measured_of(result)
    weaker = dataclasses.replace(right, contact_force=0.5 * right.contact_force, center=right.center + 8e-3)
    assert validate(result, weaker).doubts == ()


def test_forces_that_are_lost_or_near_zero_are_not_doubted(result):
    """A tendon that is slack in the twin, beside a sensor's noise; a contact lost for a while; a dislocation."""
    n, random = result.times.size, np.random.default_rng(4)
    effects = {name: dict(values) for name, values in result.effects.items()}
    effects["quadriceps"]["tension"] = np.zeros(n)
    effects["contact"]["force"] = np.where(np.arange(n) < n // 5, result.effects["contact"]["force"], 0.0)
    center = result.center + np.where(np.arange(n) > n // 2, 0.06, 0.0)[:, None]
    lost = dataclasses.replace(result, effects=effects, center=center)
    seen = measured_of(result, femoral_spring_force=0.02 * random.normal(size=n))
    assert validate(lost, seen).doubts == ()


def test_an_invalid_motion_does_not_doubt_measurements(result):
    invalid = dataclasses.replace(result, flags=np.full_like(result.flags, int(Status.NO_CONTACT)))
    right = measured_of(result)
    assert validate(invalid, dataclasses.replace(right, contact_force=1e3 * right.contact_force)).doubts == ()


def test_the_mean_over_cases_names_each_cases_doubts(result):
    right = measured_of(result)
    doubted = validate(result, dataclasses.replace(right, contact_force=1e3 * right.contact_force))
    [said] = mean_of([validate(result, right), doubted]).doubts
    assert said == f"{result.scene_name}: {doubted.doubts[0]}"


def test_other_times_are_refused(result):
    n = result.times.size
    shorter = Measured(result.times[:-1], result.center[:-1])
    with pytest.raises(InputError, match=rf"{n - 1} frames at 100 Hz; expected: the simulation's {n} frames at 100 Hz"):
        validate(result, shorter)
    slower = Measured(2 * result.times, result.center)
    with pytest.raises(InputError, match=r"frame 2 was measured at 0\.02 s; expected: 0\.01 s"):
        validate(result, slower)
    with pytest.raises(InputError, match=r"frame 1 was measured at 0\.5 s"):
        validate(result, Measured(result.times + 0.5, result.center))
    rounded = np.round(result.times + 3e-4, 3)
    assert validate(result, Measured(rounded, result.center)).mean_distance == 0


def test_a_force_of_an_effect_that_is_absent_is_refused(result):
    with pytest.raises(InputError, match=r"effect 'patellar_ligament' with a tension, which this scene lacks.*quad"):
        validate(result, measured_of(result), tibial="patellar_ligament")
    assert validate(result, measured_of(result), tibial=None).tibial_spring is None
    with pytest.raises(InputError, match="a force of a contact"):
        validate(dataclasses.replace(result, contact=None), measured_of(result))


def test_a_group_counts_with_the_sum_of_its_tensions(result):
    effects = {**result.effects, "patellar_tendon": {"tension": np.full((result.times.size, 3), 4.0)}}
    grouped = dataclasses.replace(result, effects=effects)
    v = validate(grouped, measured_of(result, tibial_spring_force=np.full(result.times.size, 10.0)))
    assert v.tibial_spring == pytest.approx(2.0)


def test_the_papers_table_and_means(result):
    assert PAPER_TABLE_1["P5"]["tilt"] == 4.45
    assert PAPER_TABLE_1["FM"]["initial_configuration"] == 33.29
    assert PAPER_TABLE_1["CM"]["real_time_factor"] == 0.19
    v = validate(result, measured_of(result))
    rows = v.to_rows(paper="P4")
    assert [row.paper for row in rows][-3:] == [2.99, 0.63, 4.97]
    assert all(row.unit for row in rows)
    with pytest.raises(InputError, match=r"no column 'P9'.*one of: CM, FM, P2, P4, P5"):
        v.to_rows(paper="P9")
    other = dataclasses.replace(v, x=3.0, femoral_spring=None, synthetic=True)
    mean = mean_of([dataclasses.replace(v, x=1.0), other])
    assert mean.x == 2.0
    assert mean.femoral_spring is None
    assert mean.synthetic
    with pytest.raises(InputError, match="no validations"):
        mean_of([])
    assert v.to_dict()["x"] == v.x


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"center": np.zeros((3, 2))}, r"center of shape \(3, 2\); expected: \(3, 3\)"),
        ({"quaternion": np.ones((3, 4))}, "row 1: a quaternion of length 2"),
        ({"quaternion": np.zeros((2, 4))}, r"quaternion of shape \(2, 4\)"),
        ({"contact_force": np.array([0.0, np.inf, 0.0])}, "row 2 of contact_force is infinite"),
        ({"times": np.array([0.0, 0.2, 0.1])}, "row 3 goes back in time"),
        ({"times": np.array([0.0, 0.1, 0.1])}, "row 3 repeats the time"),
        ({"tibial_spring_force": np.zeros(4)}, r"tibial_spring_force of shape \(4,\)"),
    ],
)
def test_measurements_are_checked(changes, message):
    good = {"times": 0.1 * np.arange(3), "center": np.zeros((3, 3))}
    with pytest.raises(InputError, match=message) as caught:
        Measured(**{**good, **changes, "source": "lab.csv"})
    assert str(caught.value).startswith("lab.csv")


def test_measured_angles_round_trip():
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1, 1, (3, 5))
    m = Measured(np.arange(5), np.zeros((5, 3)), host_array(patellar_orientation(*angles)))
    np.testing.assert_allclose(np.stack(m.angles), angles, atol=1e-12)
    np.testing.assert_allclose(patellar_angles(Quaternion(*m.quaternion.T)).tilt, angles[2], atol=1e-12)


def test_groove_line_of_an_oblique_groove():
    """height = 0.5 k (v - s u - v0)^2: the bottom runs along v = v0 + s u."""
    k, s, v0 = 30.0, 0.2, 0.002
    patch = polynomial(
        {
            (0, 2): k / 2,
            (1, 1): -k * s,
            (2, 0): k * s * s / 2,
            (0, 1): -k * v0,
            (1, 0): k * s * v0,
            (0, 0): k * v0**2 / 2,
        }
    )
    line = tracking.groove_line(patch)
    np.testing.assert_allclose(line.v, v0 + s * line.u, atol=1e-9)
    assert line.u.size == 81
    centers = np.asarray(patch.chart.from_frame(patch.chart.local_point(0.01, 0.007, 0.02)).array())[None]
    place, off = tracking.groove_offset(patch, centers)
    np.testing.assert_allclose(place, 0.01, atol=1e-12)
    np.testing.assert_allclose(off, 0.007 - (v0 + 0.01 * s), atol=1e-9)


def test_a_groove_that_ends_goes_on_straight():
    """Beyond u = 0 the section is a ridge: the bottom's last place holds there."""
    patch = polynomial({(0, 2): 0.0, (1, 2): -1000.0, (0, 1): 0.0, (1, 1): 2 * 1000.0 * GROOVE_AT}, degree=3)
    line = tracking.groove_line(patch)
    assert line.u.max() < 0
    np.testing.assert_allclose(line.at([-0.02, 0.02]), GROOVE_AT, atol=1e-9)


def test_a_surface_without_groove_counts_from_its_middle():
    ridge = polynomial({(0, 2): -20.0})
    assert tracking.groove_line(ridge) is None
    center = np.asarray(ridge.chart.from_frame(ridge.chart.local_point(0.0, 0.004, 0.02)).array())[None]
    np.testing.assert_allclose(tracking.groove_offset(ridge, center)[1], 0.004, atol=1e-12)


def test_the_bottom_of_a_groove_or_the_middle_of_a_surface_without_one():
    ridge = eqx.tree_at(lambda s: s.center, polynomial({(0, 2): -20.0}), (J(0.002), J(0.003)))
    u, v = tracking.groove_bottom(ridge)
    np.testing.assert_allclose(np.interp([-0.05, 0.0, 0.05], u, v), 0.003)
    u, v = tracking.groove_bottom(groove())
    np.testing.assert_allclose(v, GROOVE_AT, atol=1e-6)
    assert u.shape == v.shape


def test_dislocation_and_re_engagement():
    t = 0.1 * np.arange(9)
    offset = 1e-3 * np.array([0, 2, 11, 9.9, 12, 7, 5.9, 2, -10.1])
    out = tracking.find_dislocations(t, offset, np.radians(10.0 * np.arange(9)), threshold=0.010)
    np.testing.assert_array_equal(out.dislocated, [0, 0, 1, 1, 1, 1, 0, 0, 1])
    first, last = out.events
    assert (first.time, first.re_engaged_at, first.side) == pytest.approx((0.2, 0.6, "lateral"))
    assert first.farthest == pytest.approx(0.012)
    assert first.knee_flexion == pytest.approx(np.radians(20))
    assert (last.side, last.re_engaged_at) == ("medial", None)
    assert out.re_engaged is False
    said = "lateral dislocation at 0.20 s at 20.0 deg of knee flexion, up to 12.0 mm lateral of the groove"
    assert f"{said}; re-engaged at 0.60 s" in out.describe()
    assert "did not re-engage within the recording" in out.describe()


def test_normal_tracking_and_missing_frames():
    assert tracking.find_dislocations(np.arange(3), np.zeros(3)).describe() == "normal tracking"
    assert tracking.find_dislocations(np.arange(3), np.zeros(3)).re_engaged is None
    gap = tracking.find_dislocations(np.arange(4), [0.011, np.nan, np.nan, 0.001], threshold=0.010)
    np.testing.assert_array_equal(gap.dislocated, [1, 1, 1, 0])


def test_tracking_refuses_what_it_cannot_judge(result):
    with pytest.raises(InputError, match="a positive distance"):
        tracking.find_dislocations(np.arange(3), np.zeros(3), threshold=0.0)
    with pytest.raises(InputError, match="offsets of shape"):
        tracking.find_dislocations(np.arange(3), np.zeros(2))
    assert dataclasses.replace(result, surface=None).dislocations() is None


def test_dislocated_per_frame(result):
    assert not result.dislocations().dislocated.any()
    lateral = result.center + np.array([0.0, 0.025, 0.0])
    assert dataclasses.replace(result, center=lateral).dislocations().dislocated.all()
    assert groove().degree == 2
    assert pftwin.validate is validate
