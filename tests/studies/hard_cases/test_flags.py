"""A step that is too long is told by flags and in words: energy from nowhere, and what is not finite any more."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2, LinearImplicit, Newmark, SymplecticEuler
from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases import case_named
from pftwin.studies.hard_cases.batch import built_scene, member, stacked
from pftwin.studies.hard_cases.programs import compiled, equilibrium_with_derivatives, run


def flags_of(names: list[str], integrator: Integrator, substeps: int) -> list[Status]:
    """All flags of each case's frames."""
    cases = [case_named(n) for n in names]
    scenes, none = stacked([built_scene(c, "P5").unnamed() for c in cases]), jnp.zeros((len(cases), 4))
    starts = compiled(equilibrium_with_derivatives, True)(scenes, none)
    chosen = [member(starts.released if c.released else starts.equilibrium, k) for k, c in enumerate(cases)]
    steps = jnp.full(len(cases), substeps)
    observation = compiled(run, True, integrator=integrator)(scenes, stacked(chosen), steps, none).observation
    return [Status(int(np.bitwise_or.reduce(row))) for row in np.asarray(jax.device_get(observation.status))]


@pytest.mark.slow
def test_a_bounce_shorter_than_an_undamped_step_is_said_to_create_energy():
    bouncing, plain = flags_of(["bounce_to_rest", "plain_knee"], Newmark(), 10)
    assert Status.ENERGY_FROM_NOWHERE in bouncing
    assert "energy has increased by more than the work done" in bouncing.describe()
    assert plain == Status.OK


@pytest.mark.parametrize("integrator", [LinearImplicit(), BDF2()], ids=lambda i: i.name)
@pytest.mark.slow
def test_damped_steps_create_none(integrator):
    """The second-order one starts afresh after an impact, and work is taken by the velocity of the loads."""
    for flags in flags_of(["bounce_to_rest", "plain_knee"], integrator, 10):
        assert Status.ENERGY_FROM_NOWHERE not in flags


@pytest.mark.slow
def test_an_explicit_step_that_blows_up_says_that_it_is_too_long():
    light, plain = flags_of(["patella_of_1_g", "plain_knee"], SymplecticEuler(), 100)
    assert Status.NOT_FINITE in light
    assert Status.STEP_TOO_LONG in light
    assert plain == Status.OK


@pytest.mark.slow
def test_an_explicit_step_in_which_contact_chatters_says_that_it_is_too_long():
    """Nothing blows up, as a contact cannot pull; derivatives grow by powers of ten in every frame."""
    chattering, calm = flags_of(["at_random_2", "at_random_4"], SymplecticEuler(), 100)
    assert Status.STEP_TOO_LONG in chattering
    assert Status.STEP_TOO_LONG not in calm
