"""diffrax's solvers as integrators: another implementation of time stepping comes to the same motion."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    gravity,
    knee,
    march,
    order_of,
    settled,
    state_at,
    still_guide,
    still_guide_at,
    system,
    tendon,
)

from pftwin.base.errors import InputError
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.dynamics.integrators import Diffrax, Newmark, diffrax_solver
from pftwin.dynamics.observe import observe
from pftwin.dynamics.status import Status

J = jnp.asarray


@pytest.mark.parametrize("solver", [pytest.param("Heun", marks=pytest.mark.slow), "Bosh3", "Tsit5", "Kvaerno3"])
def test_declared_orders_in_steps_of_constant_length(solver):
    """A tumbling top, against a solver of order eight."""
    top = system(inertia=np.array([2e-5, 5e-5, 8e-5]))
    start = state_at(top, (0, 0, 0), spin=(3.0, 12.0, 2.0))

    def end(name, n):
        state = march(top, start, 0.5, n, Diffrax(name, rtol=1e-11, atol=1e-13, adaptive=False))
        return np.concatenate([state.spin.array(), state.orientation.array()])

    exact = end("Dopri8", 1000)
    errors = [np.linalg.norm(end(solver, n) - exact) for n in (80, 160)]
    assert order_of(errors)[-1] == pytest.approx(integrator_from_text(f"diffrax:{solver}").order, abs=0.2)


@pytest.fixture(scope="module")
def held():
    scene = knee(11)
    return scene, settled(scene)


@eqx.filter_jit
def looked_at(scene, start, substeps, integrator):
    path = frame_states(scene, integrator=integrator, substeps=substeps, start=start, ledger=True)
    return path, observe(scene, path)


@pytest.mark.slow
def test_it_comes_to_newmarks_motion_and_closes_the_budget(held):
    """Sliding on two facets: Runge-Kutta of order five and Newmark's method agree to 1e-4 mm."""
    scene, start = held
    path, seen = looked_at(scene, start, J(10), Diffrax("Tsit5"))
    other, _ = looked_at(scene, start, J(250), Newmark())
    apart = path.states.position.array() - other.states.position.array()
    assert 1e3 * float(jnp.abs(apart).max()) < 1e-4
    assert not np.asarray(path.states.solver_state.residual).any()
    whole = seen.kinetic_energy + sum(seen.potential_energy.values())
    left = whole[-1] - whole[0] - path.ledger.work[-1] + path.ledger.heat[-1]
    assert float(path.ledger.heat[-1]) > 1e-6
    assert abs(float(left)) < 1e-4 * abs(float(path.ledger.work[-1]))


@pytest.mark.slow
def test_derivatives_forward_and_reverse():
    """Of a fall on a tendon, by its stiffness; in steps of constant length, or differences see the choice of steps."""

    def height(k, adjoint):
        hanging = system(gravity(), tendon(k, 0.05, 0.5))
        chosen, step = integrator_from_text(f"diffrax:Tsit5:adaptive=0,adjoint={adjoint}"), J(2e-2)
        state = chosen.begin(hanging, start, still_guide(), step)
        return chosen.advance(hanging, state, still_guide_at, step, None)[0].position.z

    k, h = J(200.0), 1e-2
    start = state_at(system(gravity(), tendon(200.0, 0.05, 0.5)), (0, 0, 0.02))
    value = jax.jit(partial(height, adjoint="forward"))
    difference = (float(value(k + h)) - float(value(k - h))) / (2 * h)
    forward = jax.jit(lambda k: jax.jvp(partial(height, adjoint="forward"), (k,), (J(1.0),))[1])(k)
    reverse = jax.jit(jax.grad(partial(height, adjoint="recursive")))(k)
    assert float(forward) == pytest.approx(difference, rel=1e-6)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-10)
    assert abs(difference) > 1e-6


@pytest.mark.slow
def test_a_solver_that_gives_up_says_so(held, monkeypatch):
    scene, start = held
    monkeypatch.setattr(diffrax_solver, "MOST_STEPS", 2)
    stuck = eqx.filter_jit(lambda s: observe(s, frame_states(s, integrator=Diffrax("Tsit5"), substeps=1, start=start)))
    flags = np.asarray(stuck(scene).status)
    first = int(np.argmax((flags & int(Status.STEP_TOO_LONG)) > 0))
    assert first > 0
    assert (flags[first:] & int(Status.NOT_FINITE)).all()  # nothing is made up of where it had come to


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("diffrax", "no solver ''; expected: one of: Bosh3, Dopri5"),
        ("diffrax:Euler", "no solver 'Euler'"),
        ("diffrax:KenCarp4", "no solver 'KenCarp4'"),
        ("diffrax:Tsit5:rtol=0", "tolerances above 0"),
        ("diffrax:Tsit5:adaptive=2", "adaptive 1 or 0"),
        ("diffrax:Tsit5:adjoint=backward", "one of: forward, recursive, direct"),
        ("diffrax:Tsit5:dt=1", "name=value, of: rtol, atol, adaptive, adjoint"),
    ],
)
def test_names_and_options_that_cannot_be(name, words):
    with pytest.raises(InputError, match=words):
        integrator_from_text(name)
