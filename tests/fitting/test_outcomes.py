"""Outcome measures against `pftwin.results.tracking` and plain numpy, on real runs and on made-up ones."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fitting.prediction.outcomes import MEASURES, Course, dislocated, groove_surface, measure, outcomes, running_median
from pftwin import LinearImplicit, rig, simulate
from pftwin.base.errors import InputError
from pftwin.dynamics.status import Status
from pftwin.results.tracking import DISLOCATED, find_dislocations


@pytest.fixture(scope="module", params=[1, 2])
def result(request):
    return simulate(rig.case(request.param), dt=2.5e-3, integrator=LinearImplicit())


def test_dislocation_is_that_of_the_result(result):
    found, tracked = outcomes(result), result.dislocations()
    assert found["dislocations"] == len(tracked.events)
    assert found["dislocated_share"] == pytest.approx(tracked.dislocated.mean())
    assert found["largest_offset"] == pytest.approx(np.abs(tracked.offset).max())
    assert found["dislocation_margin"] == pytest.approx(0.020 - np.abs(tracked.offset).max())
    if tracked.events:
        (event,) = tracked.events
        assert found["dislocation_time"] == pytest.approx(event.time)
        assert found["dislocation_flexion"] == pytest.approx(event.knee_flexion)
        assert found["dislocation_side"] == 1.0
        assert found["tracks_at_end"] == 0.0
        assert np.isnan(found["re_engagement_time"])
    else:
        assert np.isnan(found["dislocation_time"])
        assert found["tracks_at_end"] == 1.0


def test_loads_motion_and_path_are_those_of_the_result(result):
    found, report = outcomes(result), result.effects["contact"]
    medial, lateral = (medfilt5(report[f"force_{side}"]) for side in ("medial", "lateral"))
    total, contact = medial + lateral, medfilt5(report["force"])
    assert found["peak_contact_force"] == pytest.approx(contact.max())
    assert found["mean_contact_force"] == pytest.approx(contact.mean())
    assert found["mean_contact_force"] == pytest.approx(report["force"].mean(), rel=0.01)
    assert found["medial_share"] == pytest.approx(medial.sum() / total.sum())
    assert found["medial_share"] + found["lateral_share"] == pytest.approx(1)
    assert found["least_lateral_force"] == pytest.approx(lateral.min())
    with np.errstate(invalid="ignore"):
        share = np.where(total > 0, np.minimum(medial, lateral) / total, 0)
    assert found["stability_margin"] == pytest.approx(share.min())
    assert found["one_facet_share"] == pytest.approx(((total > 0) & (share <= 0)).mean())
    assert found["mean_tilt"] == pytest.approx(result.angles.tilt.mean())
    assert found["largest_shift"] == pytest.approx(result.shift.max())
    medial, lateral = report["force_medial"], report["force_lateral"]
    total = medial + lateral
    weighted = np.nan_to_num(medial[:, None] * report["point_medial"])
    weighted += np.nan_to_num(lateral[:, None] * report["point_lateral"])
    assert (total > 0).all()
    path = np.stack([medfilt5(p) for p in (weighted / total[:, None]).T], axis=1)
    assert found["contact_path_lateral_range"] == pytest.approx(np.ptp(path[:, 1]))
    assert found["contact_path_proximal_range"] == pytest.approx(np.ptp(path[:, 0]))
    assert found["contact_path_length"] == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def medfilt5(force):
    return np.median([np.pad(force, 2, mode="edge")[i : i + force.size] for i in range(5)], axis=0)


def test_one_frames_impact_is_no_peak():
    force = np.full(20, 8.0)
    force[[7, 8]] = [4000.0, 60.0]
    np.testing.assert_allclose(running_median(jnp.asarray(force)), 8.0)
    noise = np.random.default_rng(0).standard_normal(500)
    np.testing.assert_array_equal(running_median(jnp.asarray(noise)), medfilt5(noise))


program, left = eqx.filter_jit(measure), jax.jit(dislocated)


def measured(course: Course, threshold: float = DISLOCATED) -> dict:
    """By one program for all thresholds."""
    return program(course, jnp.asarray(threshold))


def made_up(offset, status=0, force=(3.0, 5.0)) -> Course:
    y = jnp.asarray(offset, dtype=float)
    n = y.size
    points = jnp.zeros((n, 3))
    flags = jnp.full(n, int(status))
    t, one = 0.1 * jnp.arange(n).astype(float), jnp.ones(n)
    total = one * jnp.sqrt(force[0] ** 2 + force[1] ** 2)  # of facets at right angles
    return Course(t, 0.5 * t, y, 0 * y, y, (force[0] * one, force[1] * one), (points, points), total, flags)


def test_a_medial_dislocation_that_comes_back():
    found = measured(made_up([0.0, -0.01, -0.021, -0.03, -0.015, -0.011, 0.0, 0.022]))
    assert float(found["dislocations"]) == 2
    assert float(found["dislocation_side"]) == -1
    assert float(found["dislocation_time"]) == pytest.approx(0.2)
    assert float(found["re_engagement_time"]) == pytest.approx(0.5)
    assert float(found["re_engagement_flexion"]) == pytest.approx(0.25)
    assert float(found["tracks_at_end"]) == 0
    assert float(found["dislocated_share"]) == pytest.approx(4 / 8)


@pytest.mark.parametrize(("threshold", "margin", "times"), [(0.035, 0.005, 0), (0.025, -0.005, 1), (0.008, -0.022, 3)])
def test_another_threshold_moves_the_margin_and_the_dislocations(threshold, margin, times):
    """Offsets of up to 30 mm; the button is back below three fifths of the threshold."""
    offset = [0.0, 0.009, 0.0, -0.010, -0.030, 0.0045, 0.0, 0.012]
    found = measured(made_up(offset), threshold)
    assert float(found["dislocation_margin"]) == pytest.approx(margin)
    assert float(found["dislocations"]) == times
    assert float(found["largest_offset"]) == pytest.approx(0.030)
    assert float(found["largest_lateral_offset"]) == pytest.approx(0.012)
    assert len(find_dislocations(np.arange(8.0), np.array(offset), threshold=threshold).events) == times


@pytest.mark.parametrize(("offset", "times"), [(0.0199, 0), (0.0201, 1)])
def test_by_default_20_mm_are_a_dislocation(offset, times):
    assert len(find_dislocations(np.arange(3.0), np.array([0.0, offset, 0.0])).events) == times
    assert float(measured(made_up([0.0, offset, *[0.0] * 6]))["dislocations"]) == times


def test_the_outcomes_of_a_result_take_the_threshold(result):
    farthest = np.abs(result.groove[1]).max()
    found = outcomes(result, threshold=0.5 * farthest)
    assert found["dislocation_margin"] == pytest.approx(-0.5 * farthest)
    assert found["dislocations"] >= 1
    assert outcomes(result, threshold=2 * farthest)["dislocation_margin"] == pytest.approx(farthest)


@settings(deadline=None)
@given(st.lists(st.one_of(st.floats(-0.04, 0.04), st.just(float("nan"))), min_size=12, max_size=12))
def test_dislocated_frames_are_those_of_tracking(offset):
    y = np.array(offset)
    np.testing.assert_array_equal(left(jnp.asarray(y)), find_dislocations(np.arange(12.0), y).dislocated)


@pytest.mark.parametrize("flag", [Status.NOT_FINITE, Status.START_NOT_IN_EQUILIBRIUM, Status.NO_CONTACT])
def test_a_run_that_may_not_be_spoken_of_has_no_outcomes(flag):
    found = measured(made_up([0.0, 0.001, 0.002, *[0.0] * 5], flag))
    assert set(found) == set(MEASURES)
    assert all(np.isnan(v) for v in found.values())


@pytest.mark.slow
def test_a_button_that_touches_nothing_has_no_share():
    found = measured(made_up([0.0, 0.001, *[0.0] * 6], force=(0.0, 0.0)))
    assert np.isnan(found["medial_share"])
    assert np.isnan(found["contact_path_lateral_range"])
    assert float(found["peak_contact_force"]) == 0
    assert float(found["one_facet_share"]) == 0
    share = jax.grad(lambda f: measure(made_up([0.0, 0.001, *[0.0] * 6], force=(f, 2 * f)))["medial_share"])
    assert float(share(jnp.asarray(0.0))) == 0


def test_smooth_outcomes_have_their_derivatives():
    y = jnp.asarray([0.001, 0.004, -0.002])

    def smooth(scale):
        found = measure(made_up(scale * y, force=(3.0 * scale, 5.0)))
        names = ("largest_offset", "dislocation_margin", "mean_shift", "peak_contact_force", "medial_share")
        return jnp.stack([found[n] for n in names])

    slopes = jax.jit(jax.jacfwd(smooth))(jnp.asarray(1.0))
    np.testing.assert_allclose(slopes, [0.004, -0.004, 0.001, 9 / 34**0.5, 3 * 5 / 64], rtol=1e-9)


def test_the_contact_force_is_the_contacts_own_and_not_always_the_sum_of_the_facets():
    found = measured(made_up([0.0, 0.001, *[0.0] * 6]))
    assert found["peak_contact_force"] == pytest.approx(34**0.5)
    assert found["mean_contact_force"] == pytest.approx(34**0.5)


def test_a_result_without_contact_is_refused(result):
    bare = dataclasses.replace(result, contact=None, surface=None, scene=result.scene.without("contact"))
    with pytest.raises(InputError, match="no contact between a button and a trochlea"):
        outcomes(bare)


def test_a_scene_without_a_groove_is_refused_and_why():
    scene = rig.case(1, contact="P4")
    with pytest.raises(InputError, match="no contact between a button and a trochlea"):
        groove_surface(scene.without("contact"))
    meshes = SimpleNamespace(surface=None, contact=SimpleNamespace(name="sliding"), name="knee")
    with pytest.raises(InputError, match="the meshes of 'sliding' do not tell"):
        groove_surface(meshes)  # type: ignore[arg-type]
