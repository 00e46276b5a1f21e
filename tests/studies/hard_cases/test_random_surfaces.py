"""Surfaces of random coefficients: every invariant holds, whatever bumps a trochlea has."""

from __future__ import annotations

from dataclasses import replace

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st

from pftwin.dynamics.integrators import LinearImplicit
from pftwin.geometry.patch.polynomial import exponents
from pftwin.studies.hard_cases.batch import built_scene, member, stacked
from pftwin.studies.hard_cases.case import HardCase
from pftwin.studies.hard_cases.invariants import CHECKS, TOLERANCES, Look
from pftwin.studies.hard_cases.knee import BUMPS, DEGREE, KneeNumbers, bumpy
from pftwin.studies.hard_cases.programs import compiled, depths, equilibrium_with_derivatives, run

COEFFICIENTS = st.lists(
    st.floats(-2 * BUMPS, 2 * BUMPS), min_size=len(exponents(DEGREE)), max_size=len(exponents(DEGREE))
)


@hypothesis.settings(max_examples=12, deadline=None, derandomize=True)
@hypothesis.given(COEFFICIENTS, st.floats(7.5, 9.5), st.floats(0.03, 0.3))
@pytest.mark.slow
def test_invariants_hold_on_any_surface(coefficients, stiffness, mass):
    plain = KneeNumbers(ground=bumpy(np.array(coefficients)), mass=mass)
    knee = replace(plain, law=replace(plain.law, stiffness=10**stiffness))
    case = HardCase("any", "at random", "Any surface.", lambda: knee)
    scenes, none = stacked([built_scene(case, "P5").unnamed()]), jnp.zeros((1, 4))
    start = compiled(equilibrium_with_derivatives, True)(scenes, none).equilibrium
    hypothesis.assume(float(start.residual[0]) < 1e-6)
    forward = compiled(run, True, integrator=LinearImplicit())(scenes, start, jnp.array([10]), none)
    depth = np.asarray(compiled(depths, True)(scenes, forward.observation.center))[0]
    look = Look(case, knee, "P5", member(jax.device_get(forward), 0), TOLERANCES["float64"], 1e-3, depth)
    assert not [words for check in CHECKS if (words := check(look)) is not None]
