"""What is seen while a motion goes on is what is seen of it afterwards, to the last bit."""

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
from pftwin.dynamics.observe import observe, observe_on_the_way
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.dynamics.status import Status


def kept(seen):
    return seen.patella, seen.center, seen.effects["contact"]["force"]


def both(scene, start, **options):
    """Of one program each: what is kept and the status."""

    @eqx.filter_jit
    def afterwards(scene):
        seen = observe(scene, frame_states(scene, start=start, **options))
        return kept(seen), seen.status

    @eqx.filter_jit
    def on_the_way(scene):
        found, status, _ = observe_on_the_way(scene, kept, start=start, **options)
        return found, status

    return afterwards(scene), on_the_way(scene)


def same(one, other) -> bool:
    """To rounding: they are two programs."""

    def close(a, b) -> bool:
        return np.allclose(a, b, rtol=1e-9, atol=1e-11 * np.nanmax(np.abs(a), initial=0.0), equal_nan=True)

    return jax.tree.all(jax.tree.map(close, one, other))


def test_it_is_what_is_seen_afterwards():
    scene = small_scene(6)
    afterwards, on_the_way = both(scene, settled(scene), substeps=jnp.asarray(2), ledger=True)
    assert same(afterwards, on_the_way)
    assert len(on_the_way[1]) == scene.motion.n_frames


@pytest.mark.slow
def test_what_explicit_steps_beyond_their_limit_do_is_told_alike():
    """Contact chatters, and makes energy; by steps much too long the motion is lost.

    That multiplies rounding, in which the two programs differ: how they get lost is not told alike to the end.
    """
    scene = small_scene(10)
    start = settled(scene)

    def statuses(substeps):
        options = {"substeps": jnp.asarray(substeps), "ledger": True, "integrator": SymplecticEuler()}
        return [np.asarray(seen[1]) for seen in both(scene, start, **options)]

    afterwards, on_the_way = statuses(25)
    assert np.array_equal(afterwards, on_the_way)
    assert (on_the_way & int(Status.ENERGY_FROM_NOWHERE)).any()
    afterwards, on_the_way = statuses(1)
    assert np.array_equal(afterwards[:2], on_the_way[:2])
    assert on_the_way[1] & int(Status.STEP_TOO_LONG)
    assert afterwards[-1] == on_the_way[-1]
    assert on_the_way[-1] & int(Status.NOT_FINITE)


@pytest.mark.slow
def test_what_an_integrator_carries_is_told_alike():
    """Without inertia: snaps and what is unsettled, of a knee whose femur moves."""
    scene = knee(16)
    afterwards, on_the_way = both(scene, settled(scene), substeps=jnp.asarray(2), integrator=QuasiStatic())
    assert same(afterwards, on_the_way)
