"""What is observed during a run equals what is observed of the finished run, to rounding."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import knee, settled
from small_scene import small_scene

from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import SymplecticEuler
from pftwin.dynamics.observe import observe, observe_during_run
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.dynamics.status import Status


def selected(seen):
    return seen.patella, seen.center, seen.effects["contact"]["force"]


def both(scene, start, **options):
    """The selected observables and the status, from a program each."""

    @eqx.filter_jit
    def afterwards(scene):
        seen = observe(scene, frame_states(scene, start=start, **options))
        return selected(seen), seen.status

    @eqx.filter_jit
    def during_run(scene):
        found, status, _ = observe_during_run(scene, selected, start=start, **options)
        return found, status

    return afterwards(scene), during_run(scene)


def same(one, other) -> bool:
    """To rounding: they are two programs."""

    def close(a, b) -> bool:
        return np.allclose(a, b, rtol=1e-9, atol=1e-11 * np.nanmax(np.abs(a), initial=0.0), equal_nan=True)

    return jax.tree.all(jax.tree.map(close, one, other))


def test_it_equals_the_observation_of_a_finished_run():
    scene = small_scene(6)
    afterwards, during_run = both(scene, settled(scene), substeps=jnp.asarray(2), ledger=True)
    assert same(afterwards, during_run)
    assert len(during_run[1]) == scene.motion.n_frames


@pytest.mark.slow
def test_flags_of_unstable_explicit_steps_are_the_same():
    """Contact chatters, and makes energy; by steps much too long the motion is lost.

    That multiplies rounding, in which the two programs differ: they need not agree to the end.
    """
    scene = small_scene(10)
    start = settled(scene)

    def statuses(substeps):
        options = {"substeps": jnp.asarray(substeps), "ledger": True, "integrator": SymplecticEuler()}
        return [np.asarray(seen[1]) for seen in both(scene, start, **options)]

    afterwards, during_run = statuses(25)
    assert np.array_equal(afterwards, during_run)
    assert (during_run & int(Status.ENERGY_FROM_NOWHERE)).any()
    afterwards, during_run = statuses(1)
    assert np.array_equal(afterwards[:2], during_run[:2])
    assert during_run[1] & int(Status.STEP_TOO_LONG)
    assert afterwards[-1] == during_run[-1]
    assert during_run[-1] & int(Status.NOT_FINITE)


@pytest.mark.slow
def test_diagnostics_of_integrators_are_the_same():
    """Without inertia: snaps and residuals, of a knee whose femur moves."""
    scene = knee(16)
    afterwards, during_run = both(scene, settled(scene), substeps=jnp.asarray(2), integrator=QuasiStatic())
    assert same(afterwards, during_run)
