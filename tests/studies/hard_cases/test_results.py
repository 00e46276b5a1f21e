"""Cases as results: released where they say so, from equilibrium elsewhere, and refusals in the place of results."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin import InputError, LinearImplicit, Result, simulate
from pftwin.studies.hard_cases import case_named, results
from pftwin.studies.hard_cases.batch import built_scene


@pytest.mark.slow
def test_a_case_in_equilibrium_is_what_simulate_makes_of_it():
    case = case_named("plain_knee")
    found = results([case])["plain_knee"]
    assert isinstance(found, Result)
    same = simulate(built_scene(case, "P5"), integrator=LinearImplicit(), dt=case.step)
    np.testing.assert_allclose(found.center, same.center, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.flags, same.flags)
    assert found.settings["dt_s"] == pytest.approx(case.step)


@pytest.mark.slow
def test_a_released_case_starts_where_it_is_put():
    """3 mm above the plate, at rest, and in the end on it, under its own weight."""
    found = results([case_named(name) for name in ("bounce_to_rest", "radius_negative")])
    assert list(found) == ["bounce_to_rest", "radius_negative"]
    dropped = found["bounce_to_rest"]
    assert isinstance(dropped, Result)
    assert dropped.scene_name == "bounce_to_rest"
    np.testing.assert_allclose(dropped.center[0], [0, 0, 0.025], atol=1e-12)
    assert dropped.energies.kinetic[0] == 0
    assert dropped.effects["contact"]["force"][-1] == pytest.approx(0.12 * 9.81, rel=1e-3)


def test_a_refused_case_is_its_error():
    found = results([case_named("radius_negative")])
    assert isinstance(found["radius_negative"], InputError)
    assert "positive" in str(found["radius_negative"])


def test_a_case_that_a_contact_cannot_have_is_left_out():
    assert results([case_named("dislocation_across_the_edge")], contact="volume") == {}
